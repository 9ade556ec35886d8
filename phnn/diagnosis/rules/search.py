"""Rules of the search: whether to begin, to go on, and what to keep."""

from __future__ import annotations

import math
from dataclasses import dataclass

from phnn.criteria import Criteria, Selection
from phnn.diagnosis.rules import Applied

STOP, DISCARD = "stop", "discard and stop"


@dataclass(frozen=True)
class BaseCase:
    """The scores of a base model: their p-value."""

    p_value: float
    rule: Selection


def nothing_is_significant(case: BaseCase) -> Applied:
    """The base model leaves no more than chance."""
    return Applied(case.p_value >= case.rule.level, "none", {"p_value": case.p_value, "level": case.rule.level})


def something_is_significant(case: BaseCase) -> Applied:
    """The base model leaves more than chance."""
    return Applied(case.p_value < case.rule.level, "search", {"p_value": case.p_value, "level": case.rule.level})


@dataclass(frozen=True)
class StepCase:
    """A model with one more effect.

    Attributes:
        share: of the excess before it that the effect explains; chi2: mean square that the model leaves [noise²].
        significant: whether it leaves more than chance; None before it is scored.
        p_value: of what it leaves; None before it is scored.
        form: whether what it leaves looks like the same element in another form.
    """

    share: float
    chi2: float
    significant: bool | None
    p_value: float | None
    criteria: Criteria
    form: bool = False


def best_refit_explains_too_little(case: StepCase) -> Applied:
    """The residual is too large to be noise, and the best refit helps little: it is not worth scoring."""
    rule, most = case.criteria.selection, case.criteria.race.large_residual
    numbers = {"share": case.share, "explains_some": rule.explains_some}
    numbers |= {"residual_over_noise": math.sqrt(case.chi2), "large_residual": most}
    return Applied(not case.share >= rule.explains_some and case.chi2 > most**2, STOP, numbers)


def effect_explains_too_little(case: StepCase) -> Applied:
    """The model still leaves something significant, and the effect explains little."""
    least = case.criteria.selection.explains_some
    numbers = {"share": case.share, "explains_some": least, "p_value": case.p_value}
    return Applied(bool(case.significant) and case.share < least, DISCARD, numbers)


def model_leaves_nothing(case: StepCase) -> Applied:
    """The model leaves no more than chance."""
    return Applied(
        not case.significant, STOP, {"p_value": case.p_value, "level": case.criteria.selection.level}
    )  # fmt: skip


def model_leaves_little(case: StepCase) -> Applied:
    """What the model leaves is too small to be read."""
    most = case.criteria.selection.small_residual
    numbers = {"residual_over_noise": math.sqrt(case.chi2), "small_residual": most}
    return Applied(case.chi2 < most**2, STOP, numbers)


def effect_may_have_another_form(case: StepCase) -> Applied:
    """What is left looks like the same element by another law, and is small enough to be just that."""
    most = case.criteria.selection.one_form
    numbers = {"share": case.share, "explains_well": case.criteria.selection.explains_well}
    numbers |= {"residual_over_noise": math.sqrt(case.chi2), "one_form": most}
    return Applied(case.form and case.chi2 < most**2, STOP, numbers)


def effect_or_two_in_its_place(case: StepCase) -> Applied:
    """What is left looks like the same element by another law, or like a second one: that has to leave nothing."""
    most = case.criteria.selection.one_form
    numbers = {"residual_over_noise": math.sqrt(case.chi2), "one_form": most}
    return Applied(case.form and not case.chi2 < most**2, "go on", numbers)


@dataclass(frozen=True)
class KeepCase:
    """The last effect of a selection.

    Attributes:
        share: of the excess before it that the effect explains; chi2: mean square that the model leaves [noise²].
        remains: whether the model leaves something significant; first: whether it is the only effect.
        located: whether the remainder (of a first effect: that, or the whole mismatch) has a location.
        own: whether the remainder lies at the effect's own location.
    """

    share: float
    chi2: float
    remains: bool
    first: bool
    located: bool
    own: bool
    rule: Selection


def nothing_remains(case: KeepCase) -> Applied:
    """The model leaves no more than chance."""
    return Applied(not case.remains, "keep", {})


def remainder_is_within_noise_doubt(case: KeepCase) -> Applied:
    """The model leaves no more than the noise floor is known to."""
    numbers = {"residual_over_noise": math.sqrt(case.chi2), "noise_doubt": case.rule.noise_doubt}
    return Applied(case.chi2 < case.rule.noise_doubt**2, "keep", numbers)


def first_effect_explains_enough(case: KeepCase) -> Applied | None:
    """A single effect explains at least half; more where nothing has a location."""
    if not case.first:
        return None
    least = case.rule.explains if case.located else case.rule.explains_further
    return Applied(case.share >= least, "keep", {"share": case.share, "least": least})


def further_effect_explains_enough(case: KeepCase) -> Applied | None:
    """A further effect removes most of what was left, and leaves nothing that has a location elsewhere."""
    if case.first:
        return None
    enough = case.share >= case.rule.explains_further and (case.own or not case.located)
    return Applied(enough, "keep", {"share": case.share, "explains_further": case.rule.explains_further})


def effect_is_not_needed(case: KeepCase) -> Applied:
    """No rule keeps the effect."""
    return Applied(True, "withdraw", {"share": case.share, "residual_over_noise": math.sqrt(case.chi2)})


BASE = (nothing_is_significant, something_is_significant)
REFIT = (best_refit_explains_too_little,)
STEP = (effect_explains_too_little, model_leaves_nothing, model_leaves_little)
FORM = (effect_may_have_another_form, effect_or_two_in_its_place)
KEEP = (
    nothing_remains,
    remainder_is_within_noise_doubt,
    first_effect_explains_enough,
    further_effect_explains_enough,
    effect_is_not_needed,
)
