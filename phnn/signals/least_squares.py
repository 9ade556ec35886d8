"""Least squares over more samples than a matrix of all of them should be kept for."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Rows of a matrix that is kept as a whole, and of a block of a longer one.
_WHOLE, _ROWS = 2**16, 2**13


def residual(y: Array, columns: Callable[[slice], Array]) -> Array:
    """(N,) what remains of ``y`` (N,) after the best combination of some columns, ``y − A A⁺ y``.

    Args:
        columns: the rows of ``A`` (N, K) in a slice; asked for blocks one by one, twice for each.

    Long columns are reduced by orthogonal transformations to as many rows as columns, block by block, which keeps
    every digit that the whole matrix would have given (Golub & Van Loan 2013, Matrix Computations, ch. 5.3).
    """
    weights = _weights(y, columns)
    left = np.empty(y.size)
    for rows in _blocks(y.size):
        left[rows] = y[rows] - columns(rows) @ weights
    return left


def _weights(y: Array, columns: Callable[[slice], Array]) -> Array:
    """(K,) weights of the columns. Columns that are nearly combinations of others count once."""
    if y.size <= _WHOLE:
        return np.asarray(np.linalg.lstsq(columns(slice(0, y.size)), y, rcond=None)[0])
    reduced: Array | None = None
    for rows in _blocks(y.size):
        block = np.column_stack([columns(rows), y[rows]])
        reduced = np.asarray(np.linalg.qr(block if reduced is None else np.vstack([reduced, block]), mode="r"))
    assert reduced is not None
    # What lapack's rounding leaves of a dependent column grows with the rows of the whole.
    cut = np.finfo(float).eps * y.size
    return np.asarray(np.linalg.lstsq(reduced[:, :-1], reduced[:, -1], rcond=cut)[0])


def _blocks(size: int) -> Iterator[slice]:
    for first in range(0, size, _ROWS):
        yield slice(first, min(first + _ROWS, size))
