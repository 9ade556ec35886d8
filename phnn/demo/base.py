"""The actuator in which effects are concealed."""

from __future__ import annotations

import numpy as np

from phnn.demo.actuator import TABLE
from phnn.demo.concealed import quasi_static_peak

_SPREAD = 0.2  # each parameter of Table 1 moves by up to this part of itself


def draw_base(rng: np.random.Generator) -> dict[str, float]:
    """Table 1 with every parameter moved by up to ±20 %, such that each hysteron slips at the largest voltage.

    A hysteron that never slips is a capacitor in series: its slope and width would be in no recording.
    """
    while True:
        base = {name: value * float(rng.uniform(1.0 - _SPREAD, 1.0 + _SPREAD)) for name, value in TABLE.items()}
        charge = base["alpha"] * quasi_static_peak(base)
        if all(charge / base[f"C_{i}"] > 1.1 * 0.5 * base[f"d_{i}"] for i in (1, 2)):
            return base
