"""The Bouc–Wen hysteresis as a block before a linear system."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.cache import entry
from phnn.laws.namespace import absolute, exp, log1p, real, shared, where

Array = NDArray[Any]


def bouc_wen(fine: Array, h: Array, before: float, a: Any, beta: Any, gamma: Any, weight: Any) -> Array:
    """``V − w h`` with ``ḣ = A V̇ − β|V̇|h − γ|h|V̇`` (eq. (19)), exact for an input monotone between points."""
    # All of them complex where one is, so that the loop is compiled for two types only.
    zero = 0.0 * (a + beta + gamma)
    state = _bouc_wen_state(fine + zero, before + zero, a + zero, beta + zero, gamma + zero)
    return np.asarray(fine - weight * state)


@shared
def bouc_wen_step(state: Any, rise: Any, a: Any, beta: Any, gamma: Any) -> Any:
    """The state ``h`` after the input has risen by ``rise``."""
    # With s = h·sign(V̇) both directions obey ds/d|V| = A − β s − γ|s|: one exponential a sign of s.
    side = where(real(rise) >= 0.0, 1.0, -1.0)
    length = absolute(rise)
    s = side * state
    if real(s) < 0.0:
        rate = beta - gamma
        # Length until s = 0; further than the step where it is not met at all.
        inside = real(1.0 - rate * s / a)
        straight = abs(real(rate * s / a)) < 1e-9
        meet = 2.0 * length + 1.0
        if straight:
            meet = -s / a
        elif inside > 0.0:
            meet = log1p(-rate * s / a) / rate
        if real(meet) < real(length):
            s = 0.0 * s
            length = length - meet
        else:
            s = _approach(s, a, rate, length)
            length = 0.0 * length
    s = _approach(s, a, beta + gamma, length)
    return side * s


def _bouc_wen_loop(fine: Any, last: Any, a: Any, beta: Any, gamma: Any) -> Any:
    out = np.empty_like(fine)
    state = 0.0 * last
    for n in range(fine.shape[0]):
        for i in range(3):
            state = bouc_wen_step(state, fine[n, i] - last, a, beta, gamma)
            last = fine[n, i]
            out[n, i] = state
    return out


@shared
def _approach(s: Any, a: Any, rate: Any, length: Any) -> Any:
    """``ds/dL = A − rate·s`` over a length."""
    z = rate * length
    factor = 1.0 - 0.5 * z
    if abs(real(z)) > 1e-6:
        factor = (1.0 - exp(-z)) / z
    return s + (a - rate * s) * length * factor


_bouc_wen_state = entry(_bouc_wen_loop)
