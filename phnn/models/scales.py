"""Typical magnitudes that make a black-box model dimensionless."""

from __future__ import annotations

from dataclasses import dataclass

from phnn.errors import InputRefused


@dataclass(frozen=True)
class Scales:
    """What one dimensionless unit is.

    Attributes:
        time: [s]; input: [V]; output: [m].

    Raises:
        InputRefused: one of them is not positive.
    """

    time: float
    input: float
    output: float

    def __post_init__(self) -> None:
        for name, value in (("time", self.time), ("input", self.input), ("output", self.output)):
            if not 0.0 < value < float("inf"):
                raise InputRefused(f"the scale of the {name} is {value:g}: give a positive typical magnitude in SI")
