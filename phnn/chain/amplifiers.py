"""Amplifier blocks: from the command within the sub-steps to the voltage there.

A block takes ``fine`` (n, 3), its input at the start, middle and end of every step, the steps ``h`` (n,) [s], its input
before the first of them [V] and its parameters, and gives its output at the same points. The end of one row and the
start of the next differ where the input jumps.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.chain.bouc_wen import bouc_wen
from phnn.chain.delay import delay
from phnn.chain.knee import banded, kneed
from phnn.chain.lowpass import lowpass, second_order_lowpass
from phnn.chain.rate import imposed_rate
from phnn.integrate.cache import entry
from phnn.laws.namespace import absolute, exp, log1p, maximum, minimum, real, shared, where

Array = NDArray[Any]

# A ratio whose powers vanish, while its logarithm exists.
_LEAST = 1e-100


def saturation(fine: Array, h: Array, before: float, limit: Any) -> Array:
    """``V = clip(u, ±V_max)``."""
    return np.asarray(where(absolute(real(fine)) > real(limit), np.sign(real(fine)) * limit, fine + 0.0 * limit))


def soft_saturation(fine: Array, h: Array, before: float, limit: Any, sharpness: Any) -> Array:
    """``V = u/(1 + |u/V_max|ⁿ)^{1/n}`` (Rapp 1991); the larger of ``1`` and ``|u/V_max|`` is drawn out of the root."""
    size = absolute(fine + 0.0 * limit) / limit
    large = maximum(size, 1.0 + 0.0 * size)
    ratio = maximum(minimum(size, 1.0 + 0.0 * size) / large, _LEAST + 0.0 * size)
    return np.asarray(fine / large * exp(-log1p(exp(sharpness * np.log(ratio))) / sharpness))


def slew_limit(fine: Array, h: Array, before: Any, limit: Any) -> Array:
    """``|V̇| ≤ S``: ``V`` follows ``u`` where it can and approaches it at the rate ``S`` where it cannot.

    Exact at the points of the sub-steps for an input that is linear between them.
    """
    reach = 0.5 * h * limit
    zero = 0.0 * (limit + fine[0, 0])
    return np.asarray(_limited(fine + zero, reach + zero, before + zero))


@shared
def slew_step(state: Any, u: Any, reach: Any) -> Any:
    """The output after half a step, in which it moves by ``reach`` at most."""
    return state + maximum(minimum(u - state, reach), -reach)


def _limited_loop(fine: Any, reach: Any, state: Any) -> Any:
    out = np.empty_like(fine)
    for n in range(fine.shape[0]):
        out[n, 0] = state
        for i in range(1, 3):
            state = slew_step(state, fine[n, i], reach[n])
            out[n, i] = state
    return out


def offset(fine: Array, h: Array, before: Any, voltage: Any) -> Array:
    """``V = u + V₀``."""
    return np.asarray(fine + voltage)


def gain(fine: Array, h: Array, before: Any, factor: Any) -> Array:
    """``V = γ u``: a drive of unknown gain."""
    return np.asarray(factor * fine)


def knee(fine: Array, h: Array, before: Any, share: Any, level: Any) -> Array:
    """`phnn.chain.knee.kneed`: less gain beyond a level on one side."""
    return kneed(fine, share, level)


def dead_band(fine: Array, h: Array, before: Any, share: Any, level: Any) -> Array:
    """`phnn.chain.knee.banded`: less gain below a level on both sides."""
    return banded(fine, share, level)


_limited = entry(_limited_loop)

AMPLIFIERS: dict[str, Callable[..., Array]] = {
    "lowpass": lowpass,
    "second_order_lowpass": second_order_lowpass,
    "saturation": saturation,
    "soft_saturation": soft_saturation,
    "bouc_wen": bouc_wen,
    "delay": delay,
    "slew_limit": slew_limit,
    "gain": gain,
    "offset": offset,
    "knee": knee,
    "dead_band": dead_band,
    "rate": imposed_rate,
}
