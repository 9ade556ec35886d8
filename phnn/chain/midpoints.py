"""Interpolation of a smooth sampled signal halfway between its samples."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.cache import entry

Array = NDArray[Any]


def midpoints(y: Array, t: Array) -> Array:
    """(N−1, …) values halfway between samples (N, …), by the cubics through the four nearest samples.

    The error is of fourth order in the intervals; fewer than four samples are joined by straight lines.

    Args:
        t: (N,) times of the samples, as far apart as they like.
    """
    n = y.shape[0]
    if n < 4:
        return np.asarray(0.5 * (y[1:] + y[:-1]))
    return np.asarray(_midpoints(y.reshape(n, -1), t).reshape(n - 1, *y.shape[1:]))


def _midpoints_loop(y: Any, t: Any) -> Any:
    n = y.shape[0]
    out = np.empty((n - 1, y.shape[1]), y.dtype)
    weights = np.empty(4)
    for i in range(n - 1):
        first = min(max(i - 1, 0), n - 4)
        middle = 0.5 * (t[i] + t[i + 1])
        for k in range(4):
            weights[k] = 1.0
            for j in range(4):
                if j != k:
                    weights[k] *= (middle - t[first + j]) / (t[first + k] - t[first + j])
        for c in range(y.shape[1]):
            out[i, c] = (
                weights[0] * y[first, c]
                + weights[1] * y[first + 1, c]
                + weights[2] * y[first + 2, c]
                + weights[3] * y[first + 3, c]
            )
    return out


_midpoints = entry(_midpoints_loop)
