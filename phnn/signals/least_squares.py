"""Least squares of long signals without a matrix of all samples, amplitudes of harmonics, and splines."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

Array = NDArray[np.float64]

# Rows of a matrix that is kept as a whole, and of a block of a longer one.
_WHOLE, _ROWS = 2**16, 2**13
# Rows of a block that is factored: enough to be reduced much, and few enough for the cache.
_LEAST_ROWS, _ROWS_PER_COLUMN = 256, 20


def residual(y: Array, columns: Callable[[slice], Array]) -> Array:
    """Return (N,) what remains of ``y`` (N,) after the best combination of some columns, ``y − A A⁺ y``.

    Args:
        columns: the rows of ``A`` (N, K) in a slice; asked for blocks one by one, twice for each.

    Long columns are reduced by orthogonal transformations to as many rows as columns, block by block, which keeps
    every digit that the whole matrix would have given (Golub & Van Loan 2013, Matrix Computations, ch. 5.3).
    """
    weights = _weights(y, columns)
    remainder = np.empty(y.size)
    for rows in _blocks(y.size):
        remainder[rows] = y[rows] - columns(rows) @ weights
    return remainder


def triangle(matrix: Array) -> Array:
    """Return (K, K) ``R`` of ``A = Q R`` for ``A`` (N, K), ``N ≥ K``, by way of blocks that fit into the cache."""
    size = max(_LEAST_ROWS, _ROWS_PER_COLUMN * matrix.shape[1])
    count = matrix.shape[0] // size
    blocks = matrix[: count * size].reshape(count, size, matrix.shape[1])
    reduced = np.asarray(np.linalg.qr(blocks, mode="r")).reshape(count * matrix.shape[1], matrix.shape[1])
    return np.asarray(np.linalg.qr(np.concatenate([reduced, matrix[count * size :]]), mode="r"))


def _weights(y: Array, columns: Callable[[slice], Array]) -> Array:
    """Return (K,) weights of the columns. Columns that are nearly combinations of others count once."""
    if y.size <= _WHOLE:
        return np.asarray(np.linalg.lstsq(columns(slice(0, y.size)), y, rcond=None)[0])
    reduced: Array | None = None
    for rows in _blocks(y.size):
        block = np.column_stack([columns(rows), y[rows]])
        reduced = np.asarray(np.linalg.qr(block if reduced is None else np.vstack([reduced, block]), mode="r"))
    assert reduced is not None
    # What lapack's rounding leaves of a dependent column grows with the rows of the whole.
    return np.asarray(np.linalg.lstsq(reduced[:, :-1], reduced[:, -1], rcond=np.finfo(float).eps * y.size)[0])


def _blocks(size: int) -> Iterator[slice]:
    for first in range(0, size, _ROWS):
        yield slice(first, min(first + _ROWS, size))


# Harmonics that are reported, the fundamental among them.
HARMONICS = 5
# Harmonics that are told apart where there are samples enough: what is not would leak into those reported.
_BASIS = 20


def harmonic_weights(t: Array, period: float) -> NDArray[np.complex128]:
    """Return (5, N) weights of the samples in the complex amplitudes ``Y_k`` of a periodic output, by least squares.

    ``y = Y_0 + Re Σ_k Y_k e^{ikωt}``; exact for as many harmonics as fit in, whole number of samples a period or not.
    """
    dt = (t[-1] - t[0]) / (t.size - 1)
    count = max(HARMONICS, min(_BASIS, int(0.5 * (period / dt - 1.0)) - 1))
    phase = 2.0 * np.pi * np.outer(t, np.arange(1, count + 1)) / period
    basis = np.hstack([np.ones((t.size, 1)), np.cos(phase), np.sin(phase)])
    rows = np.linalg.pinv(basis)
    cosines, sines = rows[1 : HARMONICS + 1], rows[count + 1 : count + HARMONICS + 1]
    return np.asarray(cosines - 1j * sines)


def deviation(weights: NDArray[np.complex128] | Array, correlation: Array) -> float:
    """Return the standard deviation of ``w·n`` for noise ``n`` of unit variance and the given autocorrelation."""
    total = float(np.vdot(weights, weights).real)
    for lag, shared in enumerate(correlation[1 : weights.size], start=1):
        total += 2.0 * float(shared * np.vdot(weights[lag:], weights[:-lag]).real)
    return float(np.sqrt(max(total, 0.0)))


def spline(x: np.ndarray) -> BSpline:
    """Return the not-a-knot cubic spline through (N,) samples at 0, 1, …; a line through fewer than four."""
    return make_interp_spline(np.arange(x.size), x, k=3 if x.size > 3 else 1)
