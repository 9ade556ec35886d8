"""Interpolation of a smooth sampled signal halfway between its samples."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

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
    first = np.clip(np.arange(n - 1) - 1, 0, n - 4)
    near = t[first[:, None] + np.arange(4)]
    away = 0.5 * (t[1:] + t[:-1])[:, None] - near
    total = np.zeros((n - 1, *y.shape[1:]), dtype=y.dtype)
    for k in range(4):
        others = [j for j in range(4) if j != k]
        weight = np.prod(away[:, others] / (near[:, [k]] - near[:, others]), axis=1)
        total += weight.reshape(-1, *(1,) * (y.ndim - 1)) * y[first + k]
    return total
