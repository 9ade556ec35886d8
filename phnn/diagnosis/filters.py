"""Small causal operators on sampled signals: low-pass, resonator, play, rate limit, integrals, differences."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.cache import entry

Array = NDArray[np.float64]


def _low_pass_loop(x: Any, h: Any, tau: Any, state: Any) -> Any:
    out = np.empty_like(x)
    for n in range(x.size):
        state += (x[n] - state) * (1.0 - np.exp(-h[n] / tau))
        out[n] = state
    return out


def _play_loop(x: Any, radius: Any) -> Any:
    out = np.empty_like(x)
    state = 0.0
    for n in range(x.size):
        state = min(max(state, x[n] - radius), x[n] + radius)
        out[n] = state
    return out


def _rate_limit_loop(x: Any, h: Any, limit: Any, state: Any) -> Any:
    out = np.empty_like(x)
    for n in range(x.size):
        state += min(max(x[n] - state, -limit * h[n]), limit * h[n])
        out[n] = state
    return out


def _let_go_loop(x: Any, h: Any, limit: Any) -> Any:
    out = np.empty_like(x)
    state = 0.0
    for n in range(x.size):
        state = state + h[n] * x[n] if abs(x[n]) < limit else 0.0
        out[n] = state
    return out


_low_pass = entry(_low_pass_loop)
_rate_limit = entry(_rate_limit_loop)
_play = entry(_play_loop)
_let_go = entry(_let_go_loop)


def low_pass(x: Array, h: Array, tau: float, before: float) -> Array:
    """First-order low-pass with time constant ``tau`` and steps ``h``, in equilibrium at ``before`` when it begins."""
    return np.asarray(_low_pass(x, h, tau, before))


def resonator(x: Array, h: Array, frequency: float, ratio: float) -> Array:
    """(N, 2) the two states of an oscillator that a signal drives, in phase and in quadrature, from rest.

    ``ż = λ (z − x)``, ``λ = ω (−ζ + i √(1 − ζ²))``: real and imaginary part of ``z``.

    Args:
        frequency: undamped, ``ω / 2π``; ratio: of damping, ``ζ``.
    """
    tau = (ratio + 1j * np.sqrt(1.0 - ratio**2)) / (2.0 * np.pi * frequency)
    z = _low_pass(x.astype(np.complex128), h, tau, 0j)
    return np.column_stack([z.real, z.imag])


def rate_limited(x: Array, h: Array, limit: float, before: float) -> Array:
    """``x`` followed at a rate of at most ``limit``, with steps ``h``, from ``before``."""
    return np.asarray(_rate_limit(x, h, limit, before))


def integral_while_within(x: Array, h: Array, limit: float) -> Array:
    """Integral of ``x`` since its magnitude last reached a limit."""
    return np.asarray(_let_go(x, h, limit))


def stop_operator(x: Array, radius: float) -> Array:
    """``x`` minus its play of half-width ``radius``: saturates at ``±radius``."""
    return x - np.asarray(_play(x, radius))


def play_operator(x: Array, radius: float) -> Array:
    """Play (backlash) of half-width ``radius`` from the virgin state."""
    return np.asarray(_play(x, radius))


def rate(x: Array, h: Array) -> Array:
    """Derivative of a signal known at the mid-points of the steps."""
    middle = np.concatenate([[0.0], np.cumsum(h)])
    middle = 0.5 * (middle[1:] + middle[:-1])
    return np.gradient(x, middle) if x.size > 2 else np.zeros_like(x)
