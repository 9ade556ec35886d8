"""The conditions of a case besides its effect and its noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phnn.errors import InputRefused
from studies.generator.other_base import BASES, HYSTERONS

MOST = 4  # hysterons of a base
ANCHOR = 0.01  # standard deviation of the weighed mass over the mass

Rng = np.random.Generator


@dataclass(frozen=True)
class Conditions:
    """How a case departs from a base of two hysterons that the manifest states rightly and beside which nothing acts.

    Attributes:
        background: a little creep and hysteresis asymmetry act in every recording, see `studies.generator.background`.
        hysterons: of the actuator, 1 to 4; 0 draws their number.
        wrong_order: the manifest states one hysteron more or less than there are.
        anchor_error: the stated mass is drawn from a normal distribution about the true one, with the stated deviation.
        base: hysteresis of the actuator, one of `studies.generator.other_base.BASES`. Where it is not one of hysterons,
            ``hysterons`` is what the manifest states all the same.

    Raises:
        InputRefused: no number of hysterons from 0 to 4, an unknown base, or a wrong order where no order is right.
    """

    background: bool = False
    hysterons: int = 2
    wrong_order: bool = False
    anchor_error: bool = False
    base: str = HYSTERONS

    def __post_init__(self) -> None:
        if not 0 <= self.hysterons <= MOST:
            raise InputRefused(f"hysterons = {self.hysterons}: give 1 to {MOST}, or 0 to draw their number")
        if self.base not in BASES:
            raise InputRefused(f"base = {self.base!r}: take one of {', '.join(BASES)}")
        if self.wrong_order and self.base != HYSTERONS:
            raise InputRefused(
                f"wrong_order: {self.base} has no number of hysterons to state wrongly: set base=hysterons"
            )

    def drawn_number(self, rng: Rng) -> int:
        """Hysterons of the actuator."""
        return self.hysterons or int(rng.integers(1, MOST + 1))

    def stated_number(self, hysterons: int, rng: Rng) -> int:
        """Hysterons that the manifest states; one hysteron cannot become none, nor four five."""
        if not self.wrong_order:
            return hysterons
        others = [n for n in (hysterons - 1, hysterons + 1) if 1 <= n <= MOST]
        return int(rng.choice(others))

    def stated_mass(self, mass: float, rng: Rng) -> float:
        """Mass that the manifest states, kg."""
        return float(mass * (1.0 + ANCHOR * rng.standard_normal())) if self.anchor_error else mass


PLAIN = Conditions()
