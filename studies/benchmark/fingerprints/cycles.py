"""The residual of a recording that swings: harmonics of the drive in a window of samples.

The drive has the phase φ(t): 2πft of a sine, the angle of the analytic signal of a sweep (Gabor 1946). A least-squares
fit splits the residual in mean, trend and harmonics,

    r(t) = c + s t + Re Σ R_n exp(i n (φ − ψ)) + rest,     n = 1 … 5

where the modelled displacement swings as cos(φ − ψ): the phase of each harmonic counts from the displacement, so that
``Im R₁`` is an error of the loop's area and ``Re R₁`` one of its slope. Sizes are shares of the residual's root mean
square; signs of many effects are drawn, so that angles are given modulo π, too.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import hilbert

Array = NDArray[np.float64]

_HARMONICS, _ANGLES = 5, 3
# Samples below which a window has no features.
_FEWEST = 60
# Sampling instants per period from which on a residual counts as fast, in multiples of the excitation.
_FAST = 12.0


def names() -> list[str]:
    """Names of the features of a window, in their order."""
    parts = [f"{part}_{n}" for n in range(1, _HARMONICS + 1) for part in ("re", "im", "size")]
    angles = [f"{part}2_{n}" for n in range(1, _ANGLES + 1) for part in ("cos", "sin")]
    return ["level", "share", *parts, *angles, "trend", "rest", "slow", "fast", "line", "line_Hz", "peaked", "repeat"]


def sine_phase(t: Array, u: Array, frequency: float) -> Array:
    """(N,) phase [rad] of a sine of known frequency [Hz] in ``u``."""
    angle = 2.0 * math.pi * frequency * t
    centred = u - u.mean()
    return angle + math.atan2(float(np.cos(angle) @ centred), float(np.sin(angle) @ centred)) - 0.5 * math.pi


def sweep_phase(u: Array) -> Array:
    """(N,) phase [rad] of a sweep: the angle of the analytic signal, which is bad at both ends."""
    return np.asarray(np.unwrap(np.angle(hilbert(u - u.mean()))))


def window(phase: Array, y: Array, left: Array, dt: float, sigma: float, total: float) -> dict[str, float]:
    """The features of a window.

    Args:
        phase: (N,) of the drive [rad]; y: (N,) modelled displacement; left: (N,) residual, m; dt: s.
        sigma: deviation of the noise; total: root mean square of the residual of all recordings, m.

    Returns:
        Features by name; NaN for all where the window is too short.
    """
    n = phase.size
    if n < _FEWEST:
        return dict.fromkeys(names(), math.nan)
    left = left - left.mean()
    rms = float(np.sqrt(np.mean(left**2)))
    line = np.linspace(-1.0, 1.0, n)
    order = np.arange(1, _HARMONICS + 1)
    turning = np.exp(1j * phase[:, None] * order)
    columns = np.column_stack([np.ones(n), line, turning.real, turning.imag])
    found = np.linalg.lstsq(columns, np.column_stack([left, y]), rcond=None)[0]
    both = found[2 : 2 + _HARMONICS] - 1j * found[2 + _HARMONICS :]
    turned = both[:, 0] * np.exp(-1j * order * np.angle(both[0, 1])) / (math.sqrt(2.0) * rms)
    rest = left - columns @ found[:, 0]
    values = {"level": math.log(rms / sigma), "share": math.log(rms / total)}
    for k, z in zip(order, turned, strict=True):
        values |= {f"re_{k}": float(z.real), f"im_{k}": float(z.imag), f"size_{k}": abs(z)}
        if k <= _ANGLES:
            square = (z / abs(z)) ** 2 if abs(z) > 0.0 else 0.0j
            values |= {f"cos2_{k}": float(square.real), f"sin2_{k}": float(square.imag)}
    # Noise is not taken off: the level says how much of it there is.
    values["trend"] = float(found[1, 0]) / (math.sqrt(3.0) * rms)
    values["rest"] = float(np.sqrt(np.mean(rest**2))) / rms
    values |= _lines(rest, dt, abs(phase[-1] - phase[0]) / (2.0 * math.pi * (n - 1) * dt), rms)
    values["peaked"] = float(np.mean(left**4)) / rms**4 - 3.0
    values["repeat"] = _repetition(phase, left)
    return {name: values[name] for name in names()}


def _lines(rest: Array, dt: float, excitation: float, rms: float) -> dict[str, float]:
    """Shares of what is slower and faster than the drive, and the strongest line of the rest."""
    amplitude = np.abs(np.fft.rfft(rest * np.hanning(rest.size))) / rest.size * math.sqrt(16.0 / 3.0) / rms
    frequency = np.fft.rfftfreq(rest.size, dt)
    slow, fast = frequency < 0.7 * excitation, frequency > _FAST * excitation
    top = 1 + int(np.argmax(amplitude[1:]))
    return {
        "slow": float(np.sqrt(np.sum(amplitude[slow] ** 2))),
        "fast": float(np.sqrt(np.sum(amplitude[fast] ** 2))),
        "line": float(amplitude[top]),
        "line_Hz": float(frequency[top]),
    }


def _repetition(phase: Array, left: Array) -> float:
    """Correlation of the last cycle with the one before it; NaN where there are no two."""
    turns = (phase - phase[-1]) / (2.0 * math.pi)
    last, before = turns > -1.0, (turns > -2.0) & (turns <= -1.0)
    if turns[0] > -2.0 + 0.05 or not before.any():
        return math.nan
    again = np.interp(turns[last], turns[before] + 1.0, left[before])
    first, second = left[last] - left[last].mean(), again - again.mean()
    size = float(np.linalg.norm(first) * np.linalg.norm(second))
    return float(first @ second) / size if size > 0.0 else math.nan
