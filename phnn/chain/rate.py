"""A sensor of the rate of the output: a tachometer, a geophone far above its resonance, a flow meter."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


def rate(y: Array, t: Array) -> Array:
    """``dy/dt`` at the samples, the slope of the parabola through each and its neighbours: an error of second order."""
    shape = (-1,) + (1,) * (y.ndim - 1)
    h = np.diff(t.ravel()).reshape(shape)
    # Products, not quotients: those of complex numbers keep the real part to the last digit.
    slopes = np.diff(y, axis=0) * (1.0 / h)
    inner = (h[1:] * slopes[:-1] + h[:-1] * slopes[1:]) * (1.0 / (h[1:] + h[:-1]))
    first, last = 2.0 * slopes[:1] - inner[:1], 2.0 * slopes[-1:] - inner[-1:]
    return np.concatenate([first, inner, last])
