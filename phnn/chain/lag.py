"""A sensor that lags: a first-order filter of a sampled signal."""

from __future__ import annotations

from math import factorial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from phnn.chain.midpoints import midpoints

Array = NDArray[Any]

# Below this ratio of interval to time constant the closed forms cancel; the series has converged after these terms.
_SERIES, _TERMS = 0.5, 16


def lag(y: Array, t: Array, tau: Any) -> Array:
    """``τ ẏ' + y' = y``, exactly for a ``y`` that is a parabola through samples and midpoints; settled at the first."""
    zeroth, first, second = _moments((t.flat[1] - t.flat[0]) / tau)
    middle = midpoints(y)
    # Weights of the parabola's values at 0, ½ and 1.
    at_ends = (zeroth - 3.0 * first + 2.0 * second) * y[:-1] + (2.0 * second - first) * y[1:]
    driven = at_ends + 4.0 * (first - second) * middle
    keeps = 1.0 - zeroth
    rest, _ = lfilter([1.0], np.array([1.0, -keeps]), driven, axis=0, zi=keeps * y[:1])
    return np.concatenate([y[:1] + 0.0 * rest[:1], rest])


def _moments(z: Any) -> tuple[Any, Any, Any]:
    """``∫₀¹ z e^{−z(1−s)} sᵏ ds`` for k = 0, 1, 2."""
    if np.real(z) < _SERIES:
        found = [
            factorial(k) * sum((-1.0) ** j * z ** (j + 1) / factorial(k + j + 1) for j in range(_TERMS))
            for k in range(3)
        ]  # fmt: skip
        return found[0], found[1], found[2]
    zeroth = 1.0 - np.exp(-z)
    first = 1.0 - zeroth / z
    return zeroth, first, 1.0 - 2.0 * first / z
