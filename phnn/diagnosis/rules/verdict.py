"""Rules of the verdict on identification recordings: ``named``, ``equivalent`` or ``unknown``."""

from __future__ import annotations

import math
from dataclasses import dataclass

from phnn.criteria import Selection
from phnn.diagnosis.rules import Applied


@dataclass(frozen=True)
class VerdictCase:
    """What the search has kept.

    Attributes:
        effects: how many; members: most that explain equally well as one of them.
        share: of the whole excess that they explain; chi2: mean square that they leave [noise²].
        misplaced: whether what they leave lies elsewhere than they do.
        excess: sum of squares above the noise that they leave; learned: that a learned element leaves in their place.
        new_in_held_out: whether held-out recordings bring a new amplitude or frequency.
        another_form: whether a name is that of an effect which a learned element stands for.
    """

    effects: int
    members: int
    share: float
    chi2: float
    misplaced: bool
    excess: float
    learned: float | None
    new_in_held_out: bool
    rule: Selection
    another_form: bool = False


def remainder_lies_elsewhere(case: VerdictCase) -> Applied | None:
    """What the effects leave exceeds the doubt about the noise, lies where none of them is, and is no small part."""
    if not case.effects:
        return None
    numbers = {"residual_over_noise": math.sqrt(case.chi2), "noise_doubt": case.rule.noise_doubt}
    numbers |= {"share": case.share, "nearly_all": case.rule.nearly_all}
    return Applied(case.misplaced and case.share < case.rule.nearly_all, "unknown", numbers)


def no_effect_explains_it(case: VerdictCase) -> Applied:
    """The search has kept nothing."""
    return Applied(case.effects == 0, "unknown", {"effects": case.effects})


def several_effects_confound(case: VerdictCase) -> Applied | None:
    """Several effects together leave more than a small residual and explain too little of the excess."""
    if case.effects < 2:
        return None
    numbers = {"share": case.share, "together": case.rule.together}
    numbers |= {"residual_over_noise": math.sqrt(case.chi2), "small_residual": case.rule.small_residual}
    applies = case.chi2 > case.rule.small_residual**2 and case.share < case.rule.together
    return Applied(applies, "unknown", numbers)


def learned_element_explains_better(case: VerdictCase) -> Applied | None:
    """A learned element leaves clearly less than the named effects do."""
    if case.learned is None:
        return None
    numbers = {"excess": case.excess, "learned_excess": case.learned, "learned_leaves": case.rule.learned_leaves}
    return Applied(case.learned < case.rule.learned_leaves * case.excess, "unknown", numbers)


def several_explain_equally_well(case: VerdictCase) -> Applied:
    """These recordings cannot tell an effect from another one."""
    return Applied(case.members > 1, "equivalent", {"members": case.members, "tie": case.rule.tie})


def another_form_is_named(case: VerdictCase) -> Applied:
    """A learned element is part of what has the name, or all of it: the law is not that of the catalogue."""
    return Applied(case.another_form, "equivalent", {})


def held_out_bring_nothing_new(case: VerdictCase) -> Applied:
    """Held-out recordings repeat what the identification recordings show."""
    return Applied(not case.new_in_held_out, "equivalent", {})


def one_explanation(case: VerdictCase) -> Applied:
    """Each effect is the only one that explains what it explains."""
    return Applied(True, "named", {"effects": case.effects, "share": case.share})


VERDICT = (
    remainder_lies_elsewhere,
    no_effect_explains_it,
    several_effects_confound,
    learned_element_explains_better,
    several_explain_equally_well,
    another_form_is_named,
    held_out_bring_nothing_new,
    one_explanation,
)
