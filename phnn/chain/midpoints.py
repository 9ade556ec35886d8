"""What a smooth sampled signal is halfway between its samples."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


def midpoints(y: Array) -> Array:
    """(N−1, …) values halfway between samples (N, …), by the cubics through the four nearest samples.

    The error is ``3/128 Δt⁴ y⁗``; fewer than four samples are joined by straight lines.
    """
    if y.shape[0] < 4:
        return np.asarray(0.5 * (y[1:] + y[:-1]))
    inner = (9.0 * (y[1:-2] + y[2:-1]) - y[:-3] - y[3:]) / 16.0
    first = (5.0 * y[:1] + 15.0 * y[1:2] - 5.0 * y[2:3] + y[3:4]) / 16.0
    last = (5.0 * y[-1:] + 15.0 * y[-2:-1] - 5.0 * y[-3:-2] + y[-4:-3]) / 16.0
    return np.concatenate([first, inner, last])
