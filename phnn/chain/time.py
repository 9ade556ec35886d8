"""Sensors that change with the time of the recording: a clock that runs fast, a gain that drifts."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

Array = NDArray[Any]


def clock(y: Array, t: Array, change: Any, scale: Any) -> Array:
    """``y((1 − c s) t)``, ``y`` the cubic spline through the samples: a sensor whose clock runs fast for ``c s > 0``.

    A slow clock asks for what comes after the last sample. The spline goes on for one interval, and is held from there.
    Both numbers may take a complex step, and so may the samples.
    """
    times = t.reshape(t.shape[0])
    if times.size < 2:
        return np.asarray(y + 0.0 * change * scale)
    late = times * (change * scale)
    last = 2.0 * times[-1] - times[-2]
    wanted, spline = times - np.real(late), CubicSpline(times, np.real(y))
    at, follows = np.minimum(wanted, last), wanted <= last
    found = spline(at)
    if np.iscomplexobj(y):
        # A spline of its own, so that the real part is the same with a complex step and without.
        found = found + 1j * CubicSpline(times, np.imag(y))(at)
    if np.iscomplexobj(late):
        found = found - 1j * (follows * np.imag(late)).reshape(-1, *[1] * (y.ndim - 1)) * spline(at, 1)
    return np.asarray(found)


def drifting_gain(y: Array, t: Array, slope: Any, bend: Any, duration: Any) -> Array:
    """``y (1 + a₁ s + a₂ s²)``, ``s = min(t/T, 1)``: nothing says how a gain goes on drifting after the time T."""
    s = np.minimum(t / duration, 1.0).reshape(-1, *[1] * (y.ndim - 1))
    return np.asarray(y * (1.0 + s * (slope + s * bend)))
