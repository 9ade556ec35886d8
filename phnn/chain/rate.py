"""Rates: that of the output (a tachometer, a geophone far above its resonance, a flow meter), and of an input that is a
displacement."""

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


def imposed_rate(fine: Array, h: Array, before: Any) -> Array:
    """``u̇`` within the steps: a motion that is imposed by its displacement, as the velocity that it is.

    Of the parabola through start, middle and end of every step, so that the mean over a step is the difference of the
    displacement over the step, ``Δu/h``, exactly: no noise of the samples is amplified beyond that.

    Args:
        fine: (n, 3) displacement at the start, middle and end of the steps; h: (n,) steps [s].
        before: displacement before them, at which it stood still.
    """
    start, middle = fine[:, 0], fine[:, 1]
    end = np.append(start[1:], fine[-1:, 2])
    fall, rise = (4.0 * (middle - start), 4.0 * (end - middle))
    mean = end - start
    return np.asarray(np.column_stack([fall - mean, mean, rise - mean]) * (1.0 / h)[:, None])
