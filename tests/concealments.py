"""What every concealed effect owes: it moves the output, and less with its strength."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from phnn.demo.actuator import NEUTRAL, TABLE
from phnn.demo.concealed import Concealed, described
from phnn.demo.excitation import Excitation
from phnn.demo.strength import concealing


def moves_and_vanishes(effect: Concealed, plan: Sequence[Excitation], undisturbed: Sequence[np.ndarray]) -> None:
    """Its parameters are known, and the output's change is seen at its guess and gone with its strength."""
    assert set(effect.law(effect.guess)) <= set(NEUTRAL)
    # A seal is JSON, which has no infinity.
    assert all(np.isfinite(value) for value in described(effect, effect.guess).values())
    assert described(effect, effect.guess)

    def change(strength: float) -> float:
        moved = concealing(TABLE, plan, [(effect, strength)])
        return max(float(np.ptp(a - b)) for a, b in zip(moved, undisturbed, strict=True))

    assert change(effect.guess) > 1e-8
    assert change(effect.guess * 1e-3) < 0.05 * change(effect.guess)
