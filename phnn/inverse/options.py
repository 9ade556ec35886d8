"""The options of an inverse."""

from __future__ import annotations

import math
from dataclasses import dataclass

from phnn.errors import InputRefused

HOLDS = ("cubic", "zero_order")


@dataclass(frozen=True)
class InverseOptions:
    """Attributes:
        smooth: corner [Hz] of the low-pass that the reference passes, without a phase, -6 dB there; None: no low-pass.
        limits: the lowest and the highest command [V]; None: no limits.
        slew: the largest rate of the command [V/s]; None: no limit.
        hold: the command between its samples: ``"cubic"``, as `Model.simulate` takes it, or ``"zero_order"``, as a
            converter holds it.
        lead_in: how long before the first sample the motion begins [s], see `phnn.inverse.reference.led_in`.
        tolerance: largest error of the output that counts as none [m]; None: a share of the reference's range.
        iterations: at most as many simulations of the complete model.

    Raises:
        InputRefused: a value out of its range; names it.
    """

    smooth: float | None = None
    limits: tuple[float, float] | None = None
    slew: float | None = None
    hold: str = "cubic"
    lead_in: float = 0.0
    tolerance: float | None = None
    iterations: int = 20

    def __post_init__(self) -> None:
        for name, unit in (("smooth", "Hz"), ("slew", "V/s"), ("tolerance", "m")):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise InputRefused(f"{name} = {value:g} {unit}: give a positive, finite number, or leave it out")
        if self.limits is not None:
            low, high = self.limits
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                raise InputRefused(f"limits = ({low:g}, {high:g}) V: give the lowest voltage, then the highest")
        if self.hold not in HOLDS:
            raise InputRefused(f"hold = {self.hold!r}: choose one of {', '.join(HOLDS)}")
        if not (math.isfinite(self.lead_in) and self.lead_in >= 0.0):
            raise InputRefused(f"lead_in = {self.lead_in:g} s: give zero or a positive, finite time")
        if self.iterations < 1:
            raise InputRefused(f"iterations = {self.iterations}: give 1 or more")
