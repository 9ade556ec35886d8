"""Arrays of samples that a caller hands over: their shape, their time axis, their values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.errors import InputRefused

# By how much of an interval the steps of a time axis may differ from each other.
_UNIFORM = 1e-3


def series(name: str, values: Any) -> NDArray[np.float64]:
    """Return (N,) values as float64. Raises InputRefused where they are no numbers, or do not stand in one row."""
    try:
        row = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputRefused(f"{name}: {error}: give an array of numbers") from error
    if row.ndim != 1:
        raise InputRefused(f"{name} has shape {row.shape}: give one value per sample, shape (N,)")
    return row


def check_samples(t: NDArray[np.float64], signals: Mapping[str, NDArray[np.float64]]) -> None:
    """Refuse a time axis (N,) and signals (N,) that are no equally spaced samples. Raises InputRefused, which names the
    array and what is wrong with it."""
    if t.size < 2:
        raise InputRefused(f"t has {t.size} samples: give at least 2")
    for name, values in {"t": t, **signals}.items():
        if values.size != t.size:
            raise InputRefused(f"{name} has {values.size} samples and t has {t.size}: give as many")
        if not np.isfinite(values).all():
            raise InputRefused(f"{name}[{int(np.argmin(np.isfinite(values)))}] is not finite: leave such samples out")
    steps, mean = np.diff(t), (t[-1] - t[0]) / (t.size - 1)
    if not (mean > 0.0 and np.abs(steps - mean).max() <= _UNIFORM * mean):
        raise InputRefused(
            f"t increases by {steps.min():.6g} to {steps.max():.6g} s: give equal steps, for example np.linspace"
        )


def quantisation_step(y: np.ndarray) -> float:
    """Return the step of which all differences of ``y`` are multiples; 0 where there is none to be seen."""
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
        whole = np.round(counts)
        # The least-squares factor between whole numbers and nearly whole counts.
        refined = candidate * (float(whole @ counts) / max(float(whole @ whole), 1e-300))
        misfit = np.abs((levels - levels[0]) / refined - np.round((levels - levels[0]) / refined))
        if misfit.max() < 0.02:
            return refined
    return 0.0


def runs(mask: NDArray[np.bool_]) -> list[slice]:
    """Return the stretches of true values."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False)).tolist()
    return [slice(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def longest_run(mask: NDArray[np.bool_]) -> slice:
    """Return the longest stretch of true values, the first of several; an empty one where there is none."""
    return max(runs(mask), key=lambda run: run.stop - run.start, default=slice(0, 0))
