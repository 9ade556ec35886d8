"""The drawn part of a long trace: its envelope, and the stretch that shows most. Never used for a spectrum."""

from __future__ import annotations

import numpy as np


def envelope(
    y: np.ndarray,  # (N,)
    bins: int = 1500,
) -> np.ndarray:
    """Indices of the smallest and the largest sample of each of ``bins`` stretches, in order of time.

    A line through them covers the same pixels as the whole trace: no spike is lost, nothing aliases.
    Samples that are not finite are passed over. A trace of at most ``2 bins`` samples is kept as it is.
    """
    count = len(y)
    if count <= 2 * bins:
        return np.arange(count)
    width = -(-count // bins)
    rows = -(-count // width)
    padded = np.full(rows * width, np.nan)
    padded[:count] = y
    blocks = padded.reshape(rows, width)
    bad = ~np.isfinite(blocks)
    start = np.arange(rows) * width
    low = start + np.argmin(np.where(bad, np.inf, blocks), axis=1)
    high = start + np.argmax(np.where(bad, -np.inf, blocks), axis=1)
    return np.unique(np.concatenate(([0], low, high, [count - 1])))


def cycles(u: np.ndarray) -> float:
    """Number of cycles in an input, counted by crossings of its mid-range with 5 % hysteresis."""
    finite = u[np.isfinite(u)]
    if finite.size < 2 or np.ptp(finite) == 0.0:
        return 0.0
    middle = 0.5 * (finite.max() + finite.min())
    margin = 0.05 * np.ptp(finite)
    sides = np.where(finite > middle + margin, 1, np.where(finite < middle - margin, -1, 0))
    sides = sides[sides != 0]
    return 0.5 * float(np.count_nonzero(np.diff(sides)))


def telling_stretch(
    u: np.ndarray,  # (N,) input
    error: np.ndarray,  # (N,) residual of the base model
    scored: np.ndarray,  # (N,) bool
    shown: float = 4.0,
) -> slice:
    """About ``shown`` cycles where the error is largest, or the whole trace where it has no more than twice that."""
    count = len(u)
    number = cycles(u)
    if number <= 2.0 * shown or count < 100:
        return slice(0, count)
    width = min(count, max(50, round(shown * count / number)))
    square = np.where(scored & np.isfinite(error), error, 0.0) ** 2
    running = np.concatenate(([0.0], np.cumsum(square)))
    first = int(np.argmax(running[width:] - running[:-width]))
    return slice(first, first + width)
