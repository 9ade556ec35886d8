"""The exact interval of a difference of two shares of the same cases.

Of ``n`` cases ``b`` are right with the first tool alone and ``c`` with the second alone: multinomial with probabilities
``q + Δ`` and ``q``. The interval holds every difference ``Δ`` that two one-sided tests do not reject, with the score
statistic of Tango (1998, Statistics in Medicine 17, 891),

    T(b, c; Δ) = (b − c − n Δ) / √(n (2 q̂ + Δ (1 − Δ))),

``q̂`` the likeliest ``q`` for this ``Δ``. A test's p-value is the largest over all ``q`` of the exact probability of a
statistic that is as extreme (Tang, Tang & Chan 2003, Statistics in Medicine 22, 1217): the interval holds the true
difference at least as often as it says, however few cases there are.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, xlogy

Array = NDArray[np.float64]

_LEVEL = 0.025  # of each side
_NUISANCE = 101  # values of q
_COARSE, _HALVINGS = 0.02, 8  # of the differences that are tried
_ROUNDING = 1e-9


@cache
def paired_interval(cases: int, gained: int, lost: int) -> tuple[float, float]:
    """Exact 95 % interval of the share of right answers of the first tool less that of the second.

    Args:
        cases: how many; gained: right with the first alone; lost: right with the second alone.

    Raises:
        ValueError: more cases differ than there are.
    """
    if min(gained, lost) < 0 or gained + lost > cases:
        raise ValueError(f"{gained} + {lost} of {cases} cases cannot differ")
    if not cases:
        return -1.0, 1.0
    return _lower(cases, gained, lost), -_lower(cases, lost, gained)


def _lower(n: int, b: int, c: int) -> float:
    """The least difference that is not too small for what was counted."""
    at, share = -1.0, (b - c) / n
    while at + _COARSE < share and _too_small(n, b, c, at + _COARSE):
        at += _COARSE
    low, high = at, min(at + _COARSE, share)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _too_small(n, b, c, middle) else (low, middle)
    return low


def _too_small(n: int, b: int, c: int, delta: float) -> bool:
    """Whether a difference makes a statistic as large as that of the counts improbable, whatever ``q``."""
    if delta <= -1.0:
        return False
    ways, all_b, all_c = _tables(n)
    extreme = _statistic(n, all_b, all_c, delta) >= _statistic(n, np.array([b]), np.array([c]), delta) - _ROUNDING
    q = np.linspace(max(0.0, -delta), 0.5 * (1.0 - delta), _NUISANCE)[:, None]
    some_b, some_c = all_b[extreme], all_c[extreme]
    chance = xlogy(some_b, q + delta) + xlogy(some_c, q)
    chance = chance + xlogy(n - some_b - some_c, np.maximum(1.0 - 2.0 * q - delta, 0.0))
    return bool(np.exp(ways[extreme] + chance).sum(axis=1).max() <= _LEVEL)


@cache
def _tables(n: int) -> tuple[Array, Array, Array]:
    """Logarithms of the number of ways to each pair of counts, and the counts."""
    b, c = (counts[np.add.outer(range(n + 1), range(n + 1)) <= n].astype(float) for counts in np.indices((n + 1,) * 2))
    return gammaln(n + 1) - gammaln(b + 1) - gammaln(c + 1) - gammaln(n - b - c + 1), b, c


def _statistic(n: int, b: Array, c: Array, delta: float) -> Array:
    """Tango's score statistic; zero over zero is zero."""
    linear = (2.0 * n - b + c) * delta - b - c
    product = -c * delta * (1.0 - delta)
    q = (np.sqrt(np.maximum(linear**2 - 8.0 * n * product, 0.0)) - linear) / (4.0 * n)
    spread = np.sqrt(np.maximum(n * (2.0 * q + delta * (1.0 - delta)), 0.0))
    off = b - c - n * delta
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(np.abs(off) < _ROUNDING, 0.0, off / spread)
