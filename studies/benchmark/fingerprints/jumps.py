"""Features of the residual after a jump of the drive: creep, lag and ringing have their time scales there."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Ends of the windows after a jump, s: three to a decade.
_ENDS = (0.0, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1, 3e-1, 1.0, 3.0)
# A change of the drive within one sample that is larger than this part of its range is a jump.
_JUMP = 0.2
_EDGES = ("up", "down")


def names() -> list[str]:
    """Names of the features of a recording with jumps, in their order."""
    each = [f"{edge}_{i}" for edge in _EDGES for i in range(len(_ENDS) - 1)]
    return ["level", "share", *each, "up_ringing", "down_ringing", "trend"]


def jumps(t: Array, u: Array, left: Array, sigma: float, total: float) -> dict[str, float]:
    """Means of the residual in windows after the first jump and after the last one, as shares of its size.

    Args:
        t: (N,) s; u: (N,) drive; left: (N,) residual, m.
        sigma: deviation of the noise; total: root mean square of the residual of all recordings, m.

    Returns:
        Features by name; those of a window without samples are NaN.
    """
    left = left - left.mean()
    rms = float(np.sqrt(np.mean(left**2)))
    values = dict.fromkeys(names(), math.nan)
    line = np.linspace(-1.0, 1.0, left.size)
    trend = float(line @ left / (line @ line))
    values |= {"level": math.log(rms / sigma), "share": math.log(rms / total), "trend": trend / (math.sqrt(3.0) * rms)}
    edges = np.flatnonzero(np.abs(np.diff(u)) > _JUMP * np.ptp(u))
    if edges.size == 0:
        return values
    chosen = {"up": int(edges[0]) + 1, "down": int(edges[-1]) + 1}
    for edge, first in chosen.items():
        end = chosen["down"] if edge == "up" and chosen["down"] > first else left.size
        since, own = t[first:end] - t[first], left[first:end]
        for i, (low, high) in enumerate(pairwise(_ENDS)):
            inside = (since >= low) & (since < high)
            if inside.any():
                values[f"{edge}_{i}"] = float(np.mean(own[inside])) / rms
        early = own[since < _ENDS[4]]
        values[f"{edge}_ringing"] = float(np.std(np.diff(early))) / rms if early.size > 1 else math.nan
    return values
