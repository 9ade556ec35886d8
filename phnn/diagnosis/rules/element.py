"""Rules of the held-out recordings: what they say of each element."""

from __future__ import annotations

from dataclasses import dataclass

from phnn.criteria import Confirmation, Criteria
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
        proven_before: it was proven beside an element that held-out recordings have taken out since.
    """

    held_out: Gain | None
    identified: Gain
    rule: Confirmation
    drifts: bool = False
    proven_before: bool = False

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


def untested_and_proven_before(case: ElementCase) -> Applied | None:
    """Too few blocks for a test, and the held-out error falls materially by an element that was proven beside another
    one, before that was taken out."""
    found = case.held_out
    if found is None or found.falls is not None or not case.proven_before:
        return None
    numbers = _numbers(found, blocks=found.blocks, named_gain=case.rule.named_gain)
    falls = case.rule.falls(*_sizes(found)) and found.share_of_noise >= case.rule.named_gain
    return Applied(falls, "open", numbers)


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
class LeftCase:
    """An element that would have a name.

    Attributes:
        takes: mean square [noise²] that it takes from held-out recordings, from those identified where there are none.
        others: the most that another element takes; left: residual over noise that the whole model leaves there.
    """

    takes: float
    others: float
    left: float
    criteria: Criteria


def more_is_left(case: LeftCase) -> Applied:
    """Another element takes more, and the model leaves more beyond the noise than this one takes: it may be a part of
    what is left."""
    rest = case.criteria.selection.beyond_doubt(case.left**2)
    most = case.criteria.confirmation.left_over
    numbers = {"takes": case.takes, "others": case.others, "leaves": rest, "left_over": most}
    return Applied(case.takes < case.others and rest > most * case.takes, NO_NAME, numbers)


ELEMENT = (
    nothing_held_out_and_small,
    nothing_held_out_and_far,
    nothing_held_out,
    changes_too_little,
    untested_and_far,
    drift_is_within_the_noise,
    untested_and_proven_before,
    untested,
    error_falls,
    error_does_not_fall,
)
LEFT = (more_is_left,)
