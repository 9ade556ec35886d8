"""Errors of a sensor before noise and rounding: play, curved and drifting scale."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numba import njit

from studies.generator.parameters import Array

GAIN_TIME = 3.0  # s, in which a slow change of the gain reaches κ_y


@njit(cache=True)
def play(q: Array, half: float) -> Array:
    """Output of a play of half-width ``half`` that starts in the middle, shape as ``q``."""
    y = np.empty_like(q)
    last = q[0]
    for i in range(q.size):
        last = min(max(last, q[i] - half), q[i] + half)
        y[i] = last
    return y


def scaled(q: Array, t: Array, values: Mapping[str, float]) -> Array:
    """``(1 + κ_y t/3 s) (q + a₂ q² + a₃ q³)``, shape as ``q``, m; ``t`` in s from the start of the recording."""
    curved = q + values["a_2"] * q**2 + values["a_3"] * q**3
    return curved * (1.0 + values["kappa_y"] * t / GAIN_TIME)
