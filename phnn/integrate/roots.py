"""The root of one increasing scalar equation within a bracket; every step is reduced to it.

The function need not increase everywhere: observed signs bound the root, so that a bracket always holds one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from phnn.integrate.cache import inline

TOLERANCE = 1e-14
# Multiple of the rounding error that terms may leave whose cancellation the equation's size does not show.
RELAXED = 1e-12
_STRICT = 12
# After a step that has left this share of the residual no kink is near, and the chord is as good as the derivative.
_SMOOTH = 0.1
# Halvings down to neighbouring floats; every other one follows a Newton step that did not help.
_ITERATIONS = 300
# A motion that dies away reaches subnormal numbers, where relative accuracy is lost.
NOTHING = 1e-200


@inline
def extrapolated(found: Any, n: Any, k: Any) -> Any:
    """Guess entry ``(n, k)``, ``n ≥ 1``, from the two rows before it."""
    return found[n - 1, k] if n == 1 else 2.0 * found[n - 1, k] - found[n - 2, k]


def make_root(value_at: Callable[..., Any], slope_at: Callable[..., Any]) -> Callable[..., Any]:
    """``root(guess, floor, slope, context) -> (y, slope)``, to be compiled with its two functions.

    ``floor > 0`` is a lower bound on the slope of an increasing equation: one step with this slope leads beyond the
    root. A positive ``slope`` replaces the derivative in the first step: where the equation is piecewise linear, the
    slope of the step before is often exact. The root is NaN if none was found.

    Args:
        value_at: ``(y, context) -> (value, size of the terms that cancel in it)``.
        slope_at: ``(y, context) -> derivative``.
    """

    def root(guess: Any, floor: Any, slope: Any, context: Any) -> Any:
        low, high, last, reach = -np.inf, np.inf, np.inf, 1.0
        y, at, before = guess, guess, 0.0
        exhausted = False
        for iteration in range(_ITERATIONS):
            value, size = value_at(y, context)
            if not np.isfinite(value):
                break
            if exhausted or abs(value) <= (TOLERANCE if iteration < _STRICT else RELAXED) * size + NOTHING:
                return y, slope
            if value > 0.0:
                high = y
            else:
                low = y
            borrowed = iteration == 0 and slope > 0.0
            if abs(value) <= _SMOOTH * abs(before):
                slope = (value - before) / (y - at)
            elif not borrowed:
                slope = slope_at(y, context)
            step, at, before = y - value / slope, y, value
            # The comparison also fails for values that are not finite. Newton's method may hop between two kinks: a
            # step that did not halve the residual is followed by a bisection. A falling branch would lead to a root
            # that is not connected.
            newton = low <= step <= high and slope > 0.0 and abs(value) <= 0.5 * last
            last = np.inf if borrowed else abs(value)
            if newton:
                y = step
            elif np.isfinite(high - low):
                y = 0.5 * (low + high)
                exhausted = y in (low, high)
            else:
                y -= reach * value / floor
                reach *= 2.0
        return np.nan, 0.0

    return root
