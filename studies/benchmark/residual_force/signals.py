"""Operators on equally spaced samples: relaxation, resonance, play, limited slope, and a hysteron's response."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter, lfilter_zi

from phnn.integrate.cache import entry

Array = NDArray[np.float64]


def relaxed(x: Array, dt: float, tau: float, settled: bool = True) -> Array:
    """(N,) ``z`` of ``τ ż = x − z``, the input joined by straight lines.

    Args:
        dt, tau: interval and time constant [s].
        settled: begin in equilibrium with the first sample; from zero otherwise.
    """
    decay = math.exp(-dt / tau)
    mean = (1.0 - decay) * tau / dt
    b, a = np.array([1.0 - mean, mean - decay]), np.array([1.0, -decay])
    begun = lfilter_zi(b, a) * x[0] if settled else np.zeros(1)
    return np.asarray(lfilter(b, a, x, zi=begun)[0])


def resonant(x: Array, dt: float, frequency: float, damping: float) -> Array:
    """(N,) ``z`` of ``z̈ + 2ζω ż + ω² z = ω² x`` by the bilinear transform, its frequency kept, begun in equilibrium.

    Args:
        frequency: ``ω/2π`` [Hz], below the Nyquist frequency; damping: ``ζ``.
    """
    w = math.tan(math.pi * frequency * dt)
    a = np.array([1.0 + 2.0 * damping * w + w * w, 2.0 * (w * w - 1.0), 1.0 - 2.0 * damping * w + w * w])
    b = np.array([1.0, 2.0, 1.0]) * w * w / a[0]
    a = a / a[0]
    return np.asarray(lfilter(b, a, x, zi=lfilter_zi(b, a) * x[0])[0])


def rate_of(x: Array, dt: float) -> Array:
    """(N,) derivative by central differences."""
    return np.asarray(np.gradient(x, dt))


def delayed(x: Array, dt: float, tau: float) -> Array:
    """(N,) ``x(t − τ)``, straight between the samples and constant before the first one."""
    times = dt * np.arange(x.size)
    return np.asarray(np.interp(times - tau, times, x))


def played(x: Array, width: float) -> Array:
    """(N,) the play operator of a half-width, centred at the first sample (Brokate & Sprekels 1996, ch. 2)."""
    return np.asarray(_play(x, float(width)))


def slewed(x: Array, reach: float) -> Array:
    """(N,) what follows ``x`` and moves by at most ``reach`` between two samples."""
    return np.asarray(_slew(x, float(reach)))


def held_charge(current: Array, slips: Array, dt: float, capacitance: float, slope: float) -> Array:
    """(N,) change ``δe`` of a hysteron's voltage by a current ``w`` through it, its motion held.

        C δė = −ρ s(t) δe − w,   s = 1 where the hysteron slips, 0 where it sticks

    Backward Euler, for the time constant of slipping may be far below the interval.

    Args:
        current: (N,) ``w`` [A]; slips: (N,) ``s``; capacitance: ``C`` [F]; slope: ``ρ`` [S].
    """
    return np.asarray(_charge(current, slips, dt / capacitance, slope))


def _play_loop(x: Any, width: Any) -> Any:
    out = np.empty_like(x)
    state = x[0]
    for n in range(x.size):
        state = min(max(state, x[n] - width), x[n] + width)
        out[n] = state
    return out


def _slew_loop(x: Any, reach: Any) -> Any:
    out = np.empty_like(x)
    state = x[0]
    for n in range(x.size):
        state = state + min(max(x[n] - state, -reach), reach)
        out[n] = state
    return out


def _charge_loop(current: Any, slips: Any, share: Any, slope: Any) -> Any:
    out = np.empty_like(current)
    state = 0.0
    for n in range(current.size):
        state = (state - share * current[n]) / (1.0 + share * slope * slips[n])
        out[n] = state
    return out


_play, _slew, _charge = entry(_play_loop), entry(_slew_loop), entry(_charge_loop)
