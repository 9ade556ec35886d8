"""A sensor that lags: a first-order filter of a sampled signal."""

from __future__ import annotations

from math import factorial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.chain.midpoints import midpoints
from phnn.integrate.compiled import entry

Array = NDArray[Any]

# Below this ratio of interval to time constant the closed forms cancel; the series has converged after these terms.
_SERIES, _TERMS = 0.5, 16


def lag(y: Array, t: Array, tau: Any) -> Array:
    """``τ ẏ' + y' = y``, exact for parabolas through samples and midpoints; in equilibrium at the first sample."""
    times, columns = t.ravel(), y.reshape(y.shape[0], -1)
    zeroth, first, second = _moments(np.diff(times) / tau)
    # Weights of the parabola's values at 0, 1 and ½.
    weights = (zeroth - 3.0 * first + 2.0 * second, 2.0 * second - first, 4.0 * (first - second))
    parts = (columns[:-1], columns[1:], midpoints(columns, times))
    driven = weights[0][:, None] * parts[0] + weights[1][:, None] * parts[1] + weights[2][:, None] * parts[2]
    keeps = 1.0 - zeroth
    zero = 0.0 * (driven[0, 0] + keeps[0])
    return np.asarray(_lagging(driven + zero, keeps + zero, columns[0] + zero).reshape(y.shape))


def _lagging_loop(driven: Any, keeps: Any, start: Any) -> Any:
    out = np.empty((driven.shape[0] + 1, driven.shape[1]), driven.dtype)
    out[0] = start
    for n in range(driven.shape[0]):
        for k in range(driven.shape[1]):
            out[n + 1, k] = keeps[n] * out[n, k] + driven[n, k]
    return out


def _moments(z: Array) -> tuple[Array, ...]:
    """``∫₀¹ z e^{−z(1−s)} sᵏ ds`` for k = 0, 1, 2."""
    small = np.real(z) < _SERIES
    low, high = np.where(small, z, 0.0), np.where(small, 1.0, z)
    zeroth = 1.0 - np.exp(-high)
    first = 1.0 - zeroth / high
    closed = (zeroth, first, 1.0 - 2.0 * first / high)
    return tuple(np.where(small, _series(low, k), c) for k, c in enumerate(closed))


def _series(z: Array, k: int) -> Array:
    """The same by powers of a small ``z``, Horner's way."""
    total = 0.0 * z
    for j in reversed(range(_TERMS)):
        total = total * z + (-1.0) ** j * factorial(k) / factorial(k + j + 1)
    return np.asarray(total * z)


_lagging = entry(_lagging_loop)
