"""The noise as a residual has it, and by how much it exceeds what is stated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Lag-one correlations below so many standard deviations are none; no memory is taken to be longer than this one's.
_SEEN, _LARGEST = 3.0, 0.95
# By what factor noise may exceed what is stated: an effect that leaves more stands out from any such noise.
_MOST = 2.0


def first_order_of(residual: Array) -> tuple[float, float]:
    """Mean square, and coefficient of first-order noise of the same lag-one correlation (zero where none is seen)."""
    squares = float(residual @ residual)
    a = float(residual[1:] @ residual[:-1]) / max(squares, 1e-300)
    return squares / residual.size, min(a, _LARGEST) if a > _SEEN / np.sqrt(residual.size) else 0.0


def doubt(left: Array, stated: Array) -> Array:
    """Factor on standard deviations from the variances as left and as stated, between 1 and 2."""
    return np.asarray(np.sqrt(np.clip(left / np.maximum(stated, 1e-300), 1.0, _MOST**2)))
