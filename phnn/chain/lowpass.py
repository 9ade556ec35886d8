"""Amplifiers that are low-passes of first and of second order.

For an input that is linear between the points of the sub-steps both are exact. See `phnn.chain.amplifiers` for what a
block takes and gives.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.cache import entry
from phnn.laws.namespace import exp, real, shared, where

Array = NDArray[Any]

# Below this size of x the series of sin(√x)/√x has converged after its third term.
_SERIES = 1e-4


def lowpass(fine: Array, h: Array, before: float, tau: Any) -> Array:
    """``τ V̇ = u − V``."""
    return np.asarray(_first_order(fine + 0.0 * tau, *first_order_weights(h, tau), before + 0.0 * tau))


def first_order_weights(h: Array, tau: Any) -> tuple[Any, Any, Any]:
    """``a, b₀, b₁`` of `first_order_step` in steps ``h`` [s]."""
    z = 0.5 * h / tau
    a = exp(-z)
    mean = (1.0 - a) / z
    return a, mean - a, 1.0 - mean


def second_order_lowpass(fine: Array, h: Array, before: float, tau: Any, zeta: Any) -> Array:
    """``τ² V̈ + 2ζ τ V̇ + V = u``.

    With ``s`` the time in units of τ and the state ``(V, dV/ds)``, ``V = u − 2ζ u'``, ``dV/ds = u'`` solve the equation
    for an input of slope ``u'``; what differs from them decays as ``exp(A s)``, ``A = [[0, 1], [−1, −2ζ]]``.
    """
    s, *weights = second_order_weights(h, tau, zeta)
    decay = np.stack(weights, axis=1)
    zero = 0.0 * (tau + zeta)
    return np.asarray(_second_order(fine + zero, s + zero, decay + zero, zeta + zero, before + zero))


def second_order_weights(h: Array, tau: Any, zeta: Any) -> tuple[Any, Any, Any]:
    """Half a step in units of τ and the first row of ``exp(A s)`` for `second_order_step`, in steps ``h`` [s]."""
    s = 0.5 * h / tau
    even, odd = _decay(s, zeta)
    return s, even + zeta * odd, odd


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


@shared
def first_order_step(state: Any, start: Any, end: Any, a: Any, b0: Any, b1: Any) -> Any:
    """The output after half a step: ``a V + b₀ u₀ + b₁ u₁``."""
    return a * state + b0 * start + b1 * end


@shared
def second_order_step(off: Any, rate: Any, slope: Any, even: Any, odd: Any, zeta: Any) -> Any:
    """Output minus input, and the rate of the output, after half a step with an input of a slope.

    Args:
        even, odd: first row of ``exp(A s)``; the second is ``(−odd, even − 2ζ odd)``.
    """
    lag = 2.0 * zeta * slope
    start, start_rate = off + lag, rate - slope
    end, end_rate = even * start + odd * start_rate, (even - 2.0 * zeta * odd) * start_rate - odd * start
    return end - lag, slope + end_rate


def _first_order_loop(fine: Any, a: Any, b0: Any, b1: Any, state: Any) -> Any:
    out = np.empty_like(fine)
    for n in range(fine.shape[0]):
        out[n, 0] = state
        for i in range(1, 3):
            state = first_order_step(state, fine[n, i - 1], fine[n, i], a[n], b0[n], b1[n])
            out[n, i] = state
    return out


def _second_order_loop(fine: Any, s: Any, decay: Any, zeta: Any, state: Any) -> Any:
    out = np.empty_like(fine)
    rate = 0.0 * state
    for n in range(fine.shape[0]):
        out[n, 0] = state
        for i in range(1, 3):
            slope = (fine[n, i] - fine[n, i - 1]) / s[n]
            off, rate = second_order_step(state - fine[n, i - 1], rate, slope, decay[n, 0], decay[n, 1], zeta)
            state = fine[n, i] + off
            out[n, i] = state
    return out


_first_order = entry(_first_order_loop)
_second_order = entry(_second_order_loop)
