"""Sensor blocks: from the network's output to the recorded output. Sources: inputs of further ports over time.

A block takes samples (N, …) of its input, their times (N,) or (N, 1) [s] and its parameters, and gives the samples of
its output. It acts on every column alike: with ``q + i·1e-140 q'`` in the columns come the directional derivatives.
"""

from __future__ import annotations

from math import factorial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from phnn.chain.amplifiers import SENSORS, SOURCES, kneed, rate, registers
from phnn.integrate.cache import entry
from phnn.laws.namespace import absolute, cos, maximum, minimum, real, sin
from phnn.parameters import ANY, NONNEGATIVE, POSITIVE

Array = NDArray[Any]


def midpoints(y: Array, t: Array) -> Array:
    """Return (N−1, …) values halfway between samples (N, …), by the cubics through the four nearest samples.

    The error is of fourth order in the intervals; fewer than four samples are joined by straight lines.

    Args:
        t: (N,) times of the samples, as far apart as they like.
    """
    n = y.shape[0]
    if n < 4:
        return np.asarray(0.5 * (y[1:] + y[:-1]))
    return np.asarray(_midpoints(y.reshape(n, -1), t).reshape(n - 1, *y.shape[1:]))


@entry
def _midpoints(y: Any, t: Any) -> Any:
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


# Below this ratio of interval to time constant the closed forms cancel; the series has converged after these terms.
_SERIES, _TERMS = 0.5, 16
# Coefficients of the series of the second moment, the last one first.
_POWERS = np.array([(-1.0) ** j * 2.0 / factorial(j + 3) for j in reversed(range(_TERMS))])


@registers(SENSORS, POSITIVE, remembers=True, linear=True)
def lag(y: Array, t: Array, tau: Any) -> Array:
    """Solve ``τ ẏ' + y' = y``, exact for parabolas through samples and midpoints; from equilibrium at the first one."""
    times, columns = t.ravel(), y.reshape(y.shape[0], -1)
    if np.iscomplexobj(tau):
        columns = columns.astype(complex)
    return np.asarray(_lagged(columns, midpoints(columns, times), times, tau, _POWERS).reshape(y.shape))


@entry
def _lagged(y: Any, middle: Any, t: Any, tau: Any, powers: Any) -> Any:
    """Return the filter, step by step; the weights follow from ``∫₀¹ z e^{−z(1−s)} sᵏ ds`` for k = 0, 1, 2."""
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


@registers(SENSORS, NONNEGATIVE, remembers=True)
def play(y: Array, t: Array, width: Any) -> Array:
    """Apply the play of half-width ``δ``: ``w`` rests while ``|y − w| < δ`` and is carried along at the edges.

    It starts centred at the first sample. A reversal between two samples is that of the parabola through them and
    their midpoint, or plateaus would come out too low.
    """
    columns = y.reshape(y.shape[0], -1)
    zero = 0.0 * (width + columns[0, 0])
    output = _played(columns + zero, midpoints(columns, t.ravel()) + zero, width + zero)
    return np.asarray(output.reshape(y.shape))


@entry
def _played(y: Any, middle: Any, width: Any) -> Any:
    out = np.empty_like(y)
    for k in range(y.shape[1]):
        state = y[0, k]
        out[0, k] = state
        for n in range(middle.shape[0]):
            linear = 4.0 * middle[n, k] - 3.0 * y[n, k] - y[n + 1, k]
            square = 2.0 * (y[n, k] + y[n + 1, k]) - 4.0 * middle[n, k]
            # The parabola has its vertex at −linear/(2 square), if that is inside the interval.
            if real(linear) * real(square) < 0.0 and abs(real(linear)) < 2.0 * abs(real(square)):
                turn = y[n, k] - 0.25 * linear * linear / square
                state = maximum(minimum(state, turn + width), turn - width)
            state = maximum(minimum(state, y[n + 1, k] + width), y[n + 1, k] - width)
            out[n + 1, k] = state
    return out


@registers(SENSORS, ANY, POSITIVE, remembers=True, linear=True)
def clock(y: Array, t: Array, change: Any, scale: Any) -> Array:
    """Return ``y((1 − c s) t)``, ``y`` the cubic spline through the samples: the clock runs fast for ``c s > 0``.

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
    shifted = spline(at)
    if np.iscomplexobj(y):
        # A spline of its own, so that the real part is the same with a complex step and without.
        shifted = shifted + 1j * CubicSpline(times, np.imag(y))(at)
    if np.iscomplexobj(late):
        shifted = shifted - 1j * (follows * np.imag(late)).reshape(-1, *[1] * (y.ndim - 1)) * spline(at, 1)
    return np.asarray(shifted)


# A drift that follows the logarithm of time has half of its size after a seventeenth of the time.
_EARLY = 300.0


@registers(SENSORS, ANY, ANY, ANY, POSITIVE, linear=True)
def drifting_gain(y: Array, t: Array, slope: Any, bend: Any, early: Any, duration: Any) -> Array:
    """Return ``y (1 + a₁ s + a₂ s² + a₃ ln(1 + 300 s)/ln 301)``, ``s = min(t/T, 1)``: warming bends, ageing is early.

    Nothing says how a gain goes on drifting after the time T.
    """
    s = np.minimum(t / duration, 1.0).reshape(-1, *[1] * (y.ndim - 1))
    return np.asarray(y * (1.0 + s * (slope + s * bend) + early * np.log1p(_EARLY * s) / np.log1p(_EARLY)))


@registers(SENSORS, ANY)
def drift(y: Array, t: Array, rate: Any) -> Array:
    """Return ``y + r t``: a sensor that drifts at a constant rate."""
    return np.asarray(y + rate * t)


@registers(SENSORS, ANY, ANY)
def polynomial(y: Array, t: Array, square: Any, cube: Any) -> Array:
    """Return ``y + a₂ y² + a₃ y³``: a static characteristic that is not straight."""
    return np.asarray(y * (1.0 + y * (square + y * cube)))


@registers(SENSORS, ANY)
def zero(y: Array, t: Array, offset: Any) -> Array:
    """Return ``y + y₀``: a sensor whose zero is the same in all recordings."""
    return np.asarray(y + offset)


@registers(SENSORS)
def rectification(y: Array, t: Array) -> Array:
    """Return ``|y|``: a sensor that knows no sign."""
    return np.asarray(absolute(y))


@registers(SENSORS, ANY, ANY)
def knee(y: Array, t: Array, share: Any, level: Any) -> Array:
    """Apply `phnn.chain.amplifiers.kneed`: less gain beyond a level on one side."""
    return kneed(y, share, level)


@registers(SENSORS, ANY, ANY, POSITIVE)
def cubic(y: Array, t: Array, square: Any, cube: Any, level: Any) -> Array:
    """Return ``y + U (a₂ s² + a₃ s³)``, ``s = y/U``, continued by its tangents for ``|s| > 1``.

    Its slope is at least ``1 − 2|a₂| − 3|a₃|`` everywhere.
    """
    s = y * (1.0 / level)
    inner = maximum(minimum(s, 1.0 + 0.0 * s), -1.0 + 0.0 * s)
    slope = inner * (2.0 * square + 3.0 * cube * inner)
    return np.asarray(y + level * (inner * inner * (square + cube * inner) + slope * (s - inner)))


@registers(SENSORS, ANY, ANY, POSITIVE)
def wave(y: Array, t: Array, sine: Any, cosine: Any, length: Any) -> Array:
    """Return ``y + λ/2π (s sin κy + c (1 − cos κy))``, ``κ = 2π/λ``, a periodic error; monotone for ``s² + c² ≤ 1``."""
    turn = 2.0 * np.pi / length
    return np.asarray(y + (1.0 / turn) * (sine * sin(turn * y) + cosine * (1.0 - cos(turn * y))))


# The rate of a displacement, as the amplifier's blocks take it.
registers(SENSORS, remembers=True, linear=True)(rate)


@registers(SOURCES, ANY, ANY, NONNEGATIVE)
def tone(t: Array, cosine: Any, sine: Any, frequency: Any) -> Array:
    """Return ``A_c cos 2πft + A_s sin 2πft``."""
    phase = 2.0 * np.pi * frequency * t
    return np.asarray(cosine * np.cos(phase) + sine * np.sin(phase))
