"""The F-test of nested linear models, on samples whose noise is made white before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter
from scipy.stats import f as fisher

from phnn.errors import InputRefused

Array = NDArray[np.float64]

# Singular values below this share of the largest are no direction.
_RANK = 1e-10


@dataclass(frozen=True)
class FTest:
    """Attributes:
    statistic: ``F = ((S₀ − S₁)/q) / (S₁/(N − p))``, sums of squares of the smaller and the larger model.
    p_value: probability of as large an F where the smaller model is true.
    q, left: directions that the larger model has more, and degrees of freedom that it leaves.
    """

    statistic: float
    p_value: float
    q: int
    left: int


def f_test(r: Array, smaller: Array, more: Array) -> FTest:
    """Test whether further columns explain more of a vector than chance gives (Seber & Lee 2003, Sec. 4.3).

    Exact where the noise is white and normal, whatever its size.

    Args:
        r: (N,) vector; smaller: (N, p) columns of the smaller model; more: (N, q) those that the larger one has beside.

    Raises:
        InputRefused: the columns leave no degree of freedom.
    """
    base = _span(smaller)
    further = _span(more - base @ (base.T @ more), np.linalg.norm(more, axis=0))
    q, left = further.shape[1], r.size - base.shape[1] - further.shape[1]
    if left < 1:
        raise InputRefused(f"f_test: {r.size} samples for {r.size - left} columns: give more samples")
    rest = r - base @ (base.T @ r)
    explained = float(np.sum((further.T @ rest) ** 2))
    within = max(float(rest @ rest) - explained, 0.0)
    if q == 0:
        return FTest(0.0, 1.0, 0, left)
    statistic = (explained / q) / (within / left) if within > 0.0 else np.inf
    return FTest(float(statistic), float(fisher.sf(statistic, q, left)), q, left)


def _span(columns: Array, sizes: Array | None = None) -> Array:
    """Orthonormal basis of columns, each counted in units of its size."""
    sizes = np.linalg.norm(columns, axis=0) if sizes is None else sizes
    used = sizes > 0.0
    if not used.any():
        return np.zeros((columns.shape[0], 0))
    left, singular, _ = np.linalg.svd(columns[:, used] / sizes[used], full_matrices=False)
    return np.asarray(left[:, singular > _RANK * max(1.0, singular[0])])


def autoregression(residual: Array, rows: Sequence[slice], order: int = 4) -> Array:
    """(order + 1,) filter ``[1, −a₁, …]`` that makes residuals white, by Yule and Walker over all recordings.

    Args:
        residual: (N,) stacked residuals; rows: of each recording.
    """
    total = np.zeros(order + 1)
    for chosen in rows:
        x = residual[chosen] - residual[chosen].mean()
        total += [float(x[lag:] @ x[: x.size - lag]) for lag in range(order + 1)]
    if not total[0] > 0.0:
        return np.append(1.0, np.zeros(order))
    # Solvable also where the residual repeats itself: a millionth of white noise beside it.
    first = np.append(total[0] * (1.0 + 1e-6), total[1:-1])
    return np.append(1.0, -solve_toeplitz(first, total[1:]))


def filtered(columns: Array, rows: Sequence[slice], taps: Array) -> Array:
    """(N, …) columns, each recording filtered on its own."""
    return np.concatenate([lfilter(taps, [1.0], columns[chosen], axis=0) for chosen in rows])
