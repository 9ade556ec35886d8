"""What every concealed effect owes: it moves the output, and less with its strength."""

from __future__ import annotations

from functools import cache

import numpy as np

from studies.generator.effects import Concealed, described
from studies.generator.make import concealing
from studies.generator.plans import Excitation
from studies.generator.world import NEUTRAL, TABLE, simulate_all


@cache
def undisturbed(plan: tuple[Excitation, ...]) -> tuple[np.ndarray, ...]:
    """The outputs of the actuator in which nothing is concealed."""
    return tuple(simulate_all(TABLE, plan))


def moves_and_vanishes(effect: Concealed, plan: tuple[Excitation, ...]) -> None:
    """Its parameters are known, and the output's change is seen at its guess and gone with its strength."""
    assert set(effect.law(effect.guess)) <= set(NEUTRAL)
    # A seal is JSON, which has no infinity.
    assert all(np.isfinite(value) for value in described(effect, effect.guess).values())
    assert described(effect, effect.guess)

    def change(strength: float) -> float:
        moved = concealing(TABLE, plan, [(effect, strength)])
        return max(float(np.ptp(a - b)) for a, b in zip(moved, undisturbed(plan), strict=True))

    seen = change(effect.guess)
    assert seen > 1e-8
    assert change(effect.guess * 1e-3) < 0.05 * seen
