"""A cubic spline through equally spaced samples, however many."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Samples whose spline is made at once, and samples beyond them that have a part in it: the influence of a sample falls
# by 2 − √3 with each that lies between, to 1e-36 over these.
_AT_ONCE, _BESIDE = 2**17, 64


def spline(x: np.ndarray) -> Callable[[np.ndarray], Array]:
    """The cubic spline (not-a-knot) through samples ``x`` (N,) at 0, 1, …, N − 1, as a function of the place.

    For long signals only the slopes at the samples are kept, one number for each instead of some twenty while the
    equations of all are solved.
    """
    from scipy.interpolate import CubicSpline

    if x.size <= _AT_ONCE:
        return CubicSpline(np.arange(x.size), x)
    slopes = np.empty(x.size)
    for first in range(0, x.size, _AT_ONCE):
        begin, end = max(first - _BESIDE, 0), min(first + _AT_ONCE + _BESIDE, x.size)
        last = min(first + _AT_ONCE, x.size)
        # Too few samples at the end for a spline of their own have the others before them.
        part = CubicSpline(np.arange(begin, end), x[begin:end])
        slopes[first:last] = part(np.arange(first, last), 1)

    def between(places: np.ndarray) -> Array:
        """Hermite's cubic from values and slopes on both sides."""
        i = np.clip(np.floor(places).astype(np.int64), 0, x.size - 2)
        s = places - i
        rest = 1.0 - s
        values = rest * rest * (1.0 + 2.0 * s) * x[i] + s * s * (1.0 + 2.0 * rest) * x[i + 1]
        return np.asarray(values + s * rest * (rest * slopes[i] - s * slopes[i + 1]))

    return between
