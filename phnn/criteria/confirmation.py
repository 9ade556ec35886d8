"""Criteria for confirmation by held-out recordings."""

from __future__ import annotations

from dataclasses import dataclass

from phnn.criteria.criterion import criterion


@dataclass(frozen=True)
class Confirmation:
    """When held-out recordings confirm an element."""

    material: float = criterion(
        0.1,
        "noise rms",
        "Smallest contribution of an element to held-out recordings that is material.",
        "Calculation: a hundredth of the noise power, less than the uncertainty of the noise floor.",
    )
    material_share: float = criterion(
        0.01,
        "share of the error",
        "Smallest fall of the held-out error that is material.",
        "Argument: three digits in a report show no smaller fall: 1.01 → 1.01.",
    )
    named_gain: float = criterion(
        0.25,
        "noise rms",
        "An element that explains less of the held-out recordings has no name, unless it explains `real_gain` of the "
        "identification recordings.",
        "Calculation: 3 % of the residual, two standard errors of a noise floor from 2,500 samples.",
    )
    real_gain: float = criterion(
        0.5,
        "noise rms",
        "An element that explains more of the identification recordings is real, whatever held-out recordings show.",
        "Calculation: the base model leaves 1.12 × noise or more without it.",
    )
    untested_fall: float = criterion(
        0.9,
        "share of the excess",
        "If no test is possible, the held-out excess must fall by this much for a name, unless the element was proven "
        "before another one was taken out.",
        "Measured: where a step came a tenth to a half of a sample late, a slew limit in its place took 44, 81 and "
        "93 % of one held-out sine; the effects of the demonstrations take 97 % or more.",
    )
    untested_rise: float = criterion(
        0.25,
        "share of the error",
        "If no test is possible, an element that raises the held-out error by less stays in the model, provided that "
        "it lowers the identification error by a larger factor.",
        "Calculation: a true element whose response is a fifth of one coherent residual changes its error by factors "
        "of 0.83 to 1.25, and up as often as down.",
    )
    left_over: float = criterion(
        1.0,
        "share of what it takes",
        "An element that takes less than another one has no name if the whole model leaves more excess over the noise "
        "than this element takes.",
        "Argument: what is left has no explanation, and a lesser element may be a part of it; of the largest one "
        "`explains` decides.",
    )
    held_out_level: float = criterion(
        0.01,
        "probability",
        "A fall of the held-out error is significant below this p-value.",
        "Calculation: the level of the search; each element passes on its own, so that no correction is due.",
    )
    held_out_blocks: int = criterion(
        8,
        "blocks",
        "Fewest nearly independent blocks of time for a p-value.",
        "Calculation: with eight, Student's 1 % quantile is 3.0; for many it is 2.3.",
    )

    def falls(self, before: float, after: float, share_of_noise: float) -> bool:
        """Whether an error falls materially."""
        return share_of_noise > self.material and before - after > self.material_share * before

    def falls_far(self, before: float, after: float, share_of_noise: float) -> bool:
        """Whether an error falls materially, and by so much that no test is needed."""
        excess = max(before**2 - 1.0, 0.0)
        falls = self.falls(before, after, share_of_noise)
        return falls and before**2 - after**2 >= self.untested_fall * excess

    def rises(self, before: float, after: float, share_of_noise: float) -> bool:
        """Whether an error rises materially."""
        return share_of_noise < -self.material and after - before > self.material_share * before


CONFIRMATION = Confirmation()
