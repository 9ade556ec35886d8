"""A sensor that lags: a first-order filter of a sampled signal."""

from __future__ import annotations

from math import factorial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.chain.midpoints import midpoints
from phnn.integrate.cache import entry

Array = NDArray[Any]

# Below this ratio of interval to time constant the closed forms cancel; the series has converged after these terms.
_SERIES, _TERMS = 0.5, 16
# Coefficients of the series of the second moment, the last one first.
_POWERS = np.array([(-1.0) ** j * 2.0 / factorial(j + 3) for j in reversed(range(_TERMS))])


def lag(y: Array, t: Array, tau: Any) -> Array:
    """``τ ẏ' + y' = y``, exact for parabolas through samples and midpoints; in equilibrium at the first sample."""
    times, columns = t.ravel(), y.reshape(y.shape[0], -1)
    if np.iscomplexobj(tau):
        columns = columns.astype(complex)
    return np.asarray(_lagged(columns, midpoints(columns, times), times, tau, _POWERS).reshape(y.shape))


def _lagged_loop(y: Any, middle: Any, t: Any, tau: Any, powers: Any) -> Any:
    """The filter, step by step; the weights follow from ``∫₀¹ z e^{−z(1−s)} sᵏ ds`` for k = 0, 1, 2."""
    out = np.empty(y.shape, y.dtype)
    out[0] = y[0]
    for n in range(y.shape[0] - 1):
        z = (t[n + 1] - t[n]) / tau
        if z.real < _SERIES:
            second = 0.0 * z
            for power in powers:
                second = second * z + power
            second = second * z
            first = 0.5 * z * (1.0 - second)
            zeroth = z * (1.0 - first)
        else:
            zeroth = 1.0 - np.exp(-z)
            first = 1.0 - zeroth / z
            second = 1.0 - 2.0 * first / z
        # Of the parabola's values at 0, ½ and 1.
        before, between, after = zeroth - 3.0 * first + 2.0 * second, 4.0 * (first - second), 2.0 * second - first
        for k in range(y.shape[1]):
            driven = before * y[n, k] + between * middle[n, k] + after * y[n + 1, k]
            out[n + 1, k] = (1.0 - zeroth) * out[n, k] + driven
    return out


_lagged = entry(_lagged_loop)
