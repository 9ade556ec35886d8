"""Rules of the held-out recordings: what they say of the model and of the verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass

from phnn.criteria import Criteria, Selection
from phnn.diagnosis.rules import Applied


@dataclass(frozen=True)
class NamelessCase:
    """A model that leaves something.

    Attributes:
        share: of the noise that the strongest score explains; chi2: mean square that the model leaves [noise²].
        proven: whether something that would be added to it is; gains: the largest share of the noise that such an
            element explains of recordings it was not found on.
    """

    share: float
    chi2: float
    criteria: Criteria
    proven: bool = False
    gains: float = 0.0


@dataclass(frozen=True)
class ModelCase:
    """All elements that were tested.

    Attributes:
        proven, open_, immaterial: how many have this outcome; size: how many there are.
        share: of the whole excess that the model explains; remains: whether it leaves something significant.
        base: what the base model leaves; held_out: its residual over noise on held-out recordings, NaN without any.
        form_is_gone: another form alone kept the verdict from ``named``, and what made it another form is gone.
    """

    proven: int
    open_: int
    immaterial: int
    size: int
    share: float
    remains: bool
    base: NamelessCase
    held_out: float
    criteria: Criteria
    form_is_gone: bool = False


def all_are_immaterial(case: ModelCase) -> Applied:
    """Nothing that the model adds matters, nor does what the base model leaves where it was fitted, or where it was
    not."""
    small = _small_mismatch(case.base) or case.held_out < case.criteria.selection.small_residual
    numbers = {"elements": case.size, "immaterial": case.immaterial, **_small_numbers(case.base)}
    numbers["held_out"] = None if math.isnan(case.held_out) else case.held_out
    return Applied(case.immaterial == case.size and small, "none", numbers)


def none_is_confirmed(case: ModelCase) -> Applied:
    """Held-out recordings support no element."""
    numbers = {"elements": case.size, "proven": case.proven, "open": case.open_}
    return Applied(case.proven + case.open_ == 0, "unknown", numbers)


def confirmed_explain_too_little(case: ModelCase) -> Applied:
    """The elements that are left explain less than half of what there was."""
    least = case.criteria.selection.explains
    return Applied(case.remains and case.share < least, "unknown", {"share": case.share, "explains": least})


def not_all_are_proven(case: ModelCase) -> Applied:
    """Held-out recordings leave open whether an element is real."""
    return Applied(case.proven < case.size, "equivalent", {"elements": case.size, "proven": case.proven})


def catalogue_form_is_left(case: ModelCase) -> Applied:
    """Held-out recordings have taken out the learned elements that made the effect another form of itself."""
    return Applied(case.form_is_gone, "named", {"elements": case.size, "proven": case.proven})


def all_are_proven(case: ModelCase) -> Applied:
    """Held-out recordings confirm every element: the verdict of the search stands."""
    return Applied(True, "kept", {"elements": case.size, "proven": case.proven})


def mismatch_is_immaterial(case: NamelessCase) -> Applied:
    """What is significant explains less of the noise than matters, or the residual as a whole is hardly above it; and
    nothing that is proven, or gains much, predicts recordings better."""
    least, real = case.criteria.selection.small_residual, case.criteria.confirmation.real_gain
    small = _small_mismatch(case) and not case.proven and case.gains < real
    numbers = {**_small_numbers(case), "small_residual": least, "gains": case.gains, "real_gain": real}
    return Applied(small, "none", numbers)


def remainder_is_immaterial(case: NamelessCase) -> Applied:
    """The same of what the final model leaves."""
    return Applied(_small(case), "immaterial", _small_numbers(case))


def _small_mismatch(case: NamelessCase) -> bool:
    return _small(case) or case.chi2 < case.criteria.selection.small_residual**2


def _small(case: NamelessCase) -> bool:
    beyond, material = case.criteria.selection.beyond_doubt(case.chi2), case.criteria.confirmation.material
    return not max(case.share**2, beyond) >= material**2


def _small_numbers(case: NamelessCase) -> dict[str, float | None]:
    rule = case.criteria
    return {
        "share_of_noise": case.share,
        "material": rule.confirmation.material,
        "residual_over_noise": math.sqrt(case.chi2),
        "noise_doubt": rule.selection.noise_doubt,
    }


@dataclass(frozen=True)
class NumericsCase:
    """A named verdict: the largest score [noise standard deviations] of the numerical error alone, and the least of the
    largest scores by which its elements were found."""

    score: float
    statistic: float
    criteria: Criteria


def numerical_limit(statistic: float, rule: Selection) -> float:
    """The largest score that the numerical error alone may have, beside the largest score of all."""
    return max(rule.numerical_score, rule.numerical_share * statistic)


def numerical_error_may_confound(case: NumericsCase) -> Applied:
    """The numerical error alone scores too much for a proof."""
    most = numerical_limit(case.statistic, case.criteria.selection)
    return Applied(case.score > most, "equivalent", {"numerical_score": case.score, "most": most})


MODEL = (
    all_are_immaterial,
    none_is_confirmed,
    confirmed_explain_too_little,
    not_all_are_proven,
    catalogue_form_is_left,
    all_are_proven,
)
NAMELESS = (mismatch_is_immaterial,)
REMAINDER = (remainder_is_immaterial,)
NUMERICS = (numerical_error_may_confound,)
