"""A pure delay of a signal that is given at the points of the sub-steps."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

# Share of a step by which a point counts as inside it: the node of a jump is hit to rounding only.
_INSIDE = 1e-6
_JUMP = 1e-9


def delay(fine: Array, h: Array, before: Any, tau: Any) -> Array:
    """``V(t) = u(t − τ)``, ``u`` the parabola through the three points of every step.

    Jumps of ``u`` keep their one-sided values where they fall between two steps. Where one falls into a step, the
    middle value is chosen such that the mean over the step by Simpson's rule is that of the delayed signal: what the
    network feels, and its derivative by ``τ``, are exact then.
    """
    nodes = np.concatenate([[0.0], np.cumsum(h)])
    shifted = nodes[:-1, None] + h[:, None] * np.array([0.0, 0.5, 1.0]) - tau
    sides = np.real(shifted) + h[:, None] * np.array([_INSIDE, 0.0, -_INSIDE])
    rows = np.searchsorted(nodes, sides, side="right") - 1
    earlier, rows = rows < 0, np.clip(rows, 0, h.size - 1)
    s = (shifted - nodes[rows]) / h[rows]
    out = np.where(earlier, before + 0.0 * s, _parabola(fine[rows], s))
    gaps = fine[:, 0] - np.concatenate([[before], fine[:-1, 2]])
    jumps = nodes[:-1][np.abs(np.real(gaps)) > _JUMP * np.abs(np.real(fine)).max()]
    split = np.searchsorted(jumps, sides[:, 2]) > np.searchsorted(jumps, sides[:, 0])
    if split.any():
        total = np.concatenate([[0.0], np.cumsum(h * (fine[:, 0] + 4.0 * fine[:, 1] + fine[:, 2]) / 6.0)])
        ends = [
            np.where(earlier[split, i], before * shifted[split, i],
                     total[rows[split, i]] + h[rows[split, i]] * _area(fine[rows[split, i]], s[split, i]))
            for i in (0, 2)
        ]  # fmt: skip
        mean = (ends[1] - ends[0]) / h[split]
        out[split, 1] = (6.0 * mean - out[split, 0] - out[split, 2]) / 4.0
    return np.asarray(out)


def _parabola(points: Array, s: Array) -> Array:
    """The parabola through values (…, 3) at 0, ½ and 1, at ``s``."""
    first, middle, last = points[..., 0], points[..., 1], points[..., 2]
    return np.asarray(first + s * (4.0 * middle - 3.0 * first - last + s * (2.0 * (first + last) - 4.0 * middle)))


def _area(points: Array, s: Array) -> Array:
    """Its integral from 0 to ``s``."""
    first, middle, last = points[..., 0], points[..., 1], points[..., 2]
    linear, square = 4.0 * middle - 3.0 * first - last, 2.0 * (first + last) - 4.0 * middle
    return np.asarray(s * (first + s * (0.5 * linear + s * square / 3.0)))
