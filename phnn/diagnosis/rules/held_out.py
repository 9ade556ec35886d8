"""Rules of the held-out recordings: what they say of each element, and of the verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass

from phnn.criteria import Confirmation, Criteria, Selection
from phnn.diagnosis.rules import Applied
from phnn.diagnosis.rules.composition import NO_NAME
from phnn.identification.gain import Gain


@dataclass(frozen=True)
class ElementCase:
    """What one element gains.

    Attributes:
        held_out: on held-out recordings; None where there are none.
        identified: on those identified.
        rule: the criteria.
        drifts: every recording has drift coefficients of its own, so that the element predicts no recording.
    """

    held_out: Gain | None
    identified: Gain
    rule: Confirmation
    drifts: bool = False

    @property
    def shown(self) -> Gain:
        """The gain on held-out recordings, on those identified where there are none."""
        return self.held_out or self.identified

    @property
    def rises(self) -> bool:
        """Whether held-out recordings are predicted materially worse with the element."""
        return self.held_out is not None and self.rule.rises(*_sizes(self.held_out))


def _sizes(found: Gain) -> tuple[float, float, float]:
    return found.before, found.after, found.share_of_noise


def _numbers(found: Gain, **others: float | None) -> dict[str, float | None]:
    return {"before": found.before, "after": found.after, "share_of_noise": found.share_of_noise, **others}


def nothing_held_out_and_small(case: ElementCase) -> Applied | None:
    """Nothing is held out, and the identification error falls by less than a name needs."""
    if case.held_out is not None:
        return None
    found, rule = case.identified, case.rule
    small = not rule.falls(*_sizes(found)) or found.share_of_noise < rule.named_gain
    return Applied(small, "immaterial", _numbers(found, material=rule.material, named_gain=rule.named_gain))


def nothing_held_out_and_far(case: ElementCase) -> Applied | None:
    """Nothing is held out, and the element takes nearly all of the identification excess."""
    if case.held_out is not None:
        return None
    far = case.rule.falls_far(*_sizes(case.identified))
    return Applied(far, "open", _numbers(case.identified, untested_fall=case.rule.untested_fall))


def nothing_held_out(case: ElementCase) -> Applied | None:
    """Nothing is held out, and the element takes some of the identification excess only."""
    return None if case.held_out is not None else Applied(True, "refuted", _numbers(case.identified))


def untested_and_far(case: ElementCase) -> Applied | None:
    """Too few blocks for a test, and the element takes nearly all of the held-out excess."""
    found = case.held_out
    if found is None or found.falls is not None:
        return None
    far = case.rule.falls_far(*_sizes(found))
    return Applied(far, "open", _numbers(found, blocks=found.blocks, untested_fall=case.rule.untested_fall))


def changes_too_little(case: ElementCase) -> Applied | None:
    """The held-out error does not rise materially and falls by less than a name needs, and where the element was found
    the gain was small as well."""
    found, rule = case.held_out, case.rule
    if found is None:
        return None
    noticed = rule.falls(*_sizes(found)) and found.share_of_noise >= rule.named_gain
    changes = noticed or case.rises
    identified = case.identified.share_of_noise
    numbers = _numbers(found, material=rule.material, named_gain=rule.named_gain, identified_share=identified)
    numbers["real_gain"] = rule.real_gain
    return Applied(not changes and identified < rule.real_gain, "immaterial", numbers)


def drift_is_within_the_noise(case: ElementCase) -> Applied | None:
    """A drift that differs in every recording is smaller than a real gain: the low end of the noise spectrum can
    look the same."""
    found = case.held_out
    if found is None or not case.drifts:
        return None
    small = found.share_of_noise < case.rule.real_gain
    return Applied(small, "immaterial", _numbers(found, real_gain=case.rule.real_gain))


def untested(case: ElementCase) -> Applied | None:
    """Too few blocks to confirm or refute the element."""
    found = case.held_out
    if found is None:
        return None
    numbers = _numbers(found, blocks=found.blocks, held_out_blocks=case.rule.held_out_blocks)
    return Applied(found.falls is None, "provisional", numbers)


def error_falls(case: ElementCase) -> Applied | None:
    """The held-out error falls by more than matters and more than chance."""
    found, rule = case.held_out, case.rule
    if found is None or found.falls is None:
        return None
    falls = rule.falls(*_sizes(found)) and found.falls < rule.held_out_level
    return Applied(falls, "proven", _numbers(found, p_value=found.falls, held_out_level=rule.held_out_level))


def error_does_not_fall(case: ElementCase) -> Applied | None:
    """The held-out recordings do not confirm a gain that is real where the element was found."""
    found = case.held_out
    return None if found is None else Applied(True, "refuted", _numbers(found, p_value=found.falls))


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
class LeftCase:
    """An element that would have a name.

    Attributes:
        takes: mean square [noise²] that it takes from held-out recordings, from those identified where there are none.
        left: residual over noise that the whole model leaves there.
    """

    takes: float
    left: float
    criteria: Criteria


def more_is_left(case: LeftCase) -> Applied:
    """The model leaves more beyond the noise than the element takes: the element may be a part of what is left."""
    rest = case.criteria.selection.beyond_doubt(case.left**2)
    most = case.criteria.confirmation.left_over
    return Applied(rest > most * case.takes, NO_NAME, {"takes": case.takes, "leaves": rest, "left_over": most})


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


ELEMENT = (
    nothing_held_out_and_small,
    nothing_held_out_and_far,
    nothing_held_out,
    changes_too_little,
    untested_and_far,
    drift_is_within_the_noise,
    untested,
    error_falls,
    error_does_not_fall,
)
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
LEFT = (more_is_left,)
NUMERICS = (numerical_error_may_confound,)
