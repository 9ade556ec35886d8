"""Amplifiers that are low-passes of first and of second order.

For an input that is linear between the points of the sub-steps both are exact. See `phnn.chain.amplifiers` for what a
block takes and gives.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.compiled import entry
from phnn.laws.namespace import exp, real, where

Array = NDArray[Any]

# Below this size of x the series of sin(√x)/√x has converged after its third term.
_SERIES = 1e-4


def lowpass(fine: Array, h: Array, before: float, tau: Any) -> Array:
    """``τ V̇ = u − V``."""
    z = 0.5 * h / tau
    a = exp(-z)
    mean = (1.0 - a) / z
    return np.asarray(_first_order(fine + 0.0 * tau, a, mean - a, 1.0 - mean, before + 0.0 * tau))


def second_order_lowpass(fine: Array, h: Array, before: float, tau: Any, zeta: Any) -> Array:
    """``τ² V̈ + 2ζ τ V̇ + V = u``.

    With ``s`` the time in units of τ and the state ``(V, dV/ds)``, ``V = u − 2ζ u'``, ``dV/ds = u'`` solve the equation
    for an input of slope ``u'``; what differs from them decays as ``exp(A s)``, ``A = [[0, 1], [−1, −2ζ]]``.
    """
    s = 0.5 * h / tau
    even, odd = _decay(s, zeta)
    decay = np.stack([even + zeta * odd, odd, even - zeta * odd], axis=1)
    zero = 0.0 * (tau + zeta)
    return np.asarray(_second_order(fine + zero, s + zero, decay + zero, zeta + zero, before + zero))


def _decay(s: Array, zeta: Any) -> tuple[Array, Array]:
    """``e^{−ζs} cos √x`` and ``s e^{−ζs} sin √x / √x`` with ``x = (1 − ζ²) s²``, of either sign.

    Beyond critical damping they are sums of two falling exponentials, for the hyperbolic functions would overflow.
    """
    x = (1.0 - zeta * zeta) * s * s
    swings = real(x) > _SERIES
    falls = real(x) < -_SERIES
    root = np.sqrt(where(swings, x, 1.0))
    spread = np.sqrt(where(falls, -x, 1.0))
    slow, fast = exp(spread - zeta * s), exp(-spread - zeta * s)
    damped = exp(-zeta * s)
    even = where(swings, damped * np.cos(root), damped * (1.0 - x / 2.0 + x * x / 24.0))
    odd = where(swings, damped * np.sin(root) / root, damped * (1.0 - x / 6.0 + x * x / 120.0))
    return where(falls, 0.5 * (slow + fast), even), s * where(falls, 0.5 * (slow - fast) / spread, odd)


def _first_order_loop(fine: Any, a: Any, b0: Any, b1: Any, state: Any) -> Any:
    out = np.empty_like(fine)
    for n in range(fine.shape[0]):
        out[n, 0] = state
        state = a[n] * state + b0[n] * fine[n, 0] + b1[n] * fine[n, 1]
        out[n, 1] = state
        state = a[n] * state + b0[n] * fine[n, 1] + b1[n] * fine[n, 2]
        out[n, 2] = state
    return out


def _second_order_loop(fine: Any, s: Any, decay: Any, zeta: Any, state: Any) -> Any:
    out = np.empty_like(fine)
    rate = 0.0 * state
    for n in range(fine.shape[0]):
        out[n, 0] = state
        for i in range(1, 3):
            slope = (fine[n, i] - fine[n, i - 1]) / s[n]
            lags = 2.0 * zeta * slope
            off, off_rate = state - fine[n, i - 1] + lags, rate - slope
            state = fine[n, i] - lags + decay[n, 0] * off + decay[n, 1] * off_rate
            rate = slope - decay[n, 1] * off + decay[n, 2] * off_rate
            out[n, i] = state
    return out


_first_order = entry(_first_order_loop)
_second_order = entry(_second_order_loop)
