"""The step of which recorded values are multiples."""

from __future__ import annotations

import numpy as np


def quantisation_step(y: np.ndarray) -> float:
    """The step of which all differences of ``y`` are multiples; 0 where there is none to be seen."""
    levels = np.unique(y)
    if levels.size < 2:
        return 0.0
    gaps = np.diff(levels)
    blur = 64.0 * float(np.spacing(np.abs(levels).max()))
    gaps = gaps[gaps > blur]
    if gaps.size == 0:
        return 0.0
    step = float(gaps[gaps < 1.5 * gaps.min()].mean())  # the mean evens out digits lost in printing
    if step < 1e3 * blur:
        return 0.0
    for part in range(1, 9):
        candidate = step / part
        counts = (levels - levels[0]) / candidate
        refined = candidate * _slope(np.round(counts), counts)
        misfit = np.abs((levels - levels[0]) / refined - np.round((levels - levels[0]) / refined))
        if misfit.max() < 0.02:
            return refined
    return 0.0


def _slope(whole: np.ndarray, counts: np.ndarray) -> float:
    """Least-squares factor between whole numbers and nearly whole counts."""
    return float(whole @ counts) / max(float(whole @ whole), 1e-300)
