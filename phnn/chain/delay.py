"""A pure delay of a signal that is given at the points of the sub-steps."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.cache import entry
from phnn.laws.namespace import real, shared

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
    zero = 0.0 * (tau + before + fine[0, 0])
    fine, before = fine + zero, before + zero
    nodes = np.concatenate([[0.0], np.cumsum(h)])
    gaps = np.real(fine[:, 0] - np.concatenate([[before], fine[:-1, 2]]))
    jumps = np.cumsum(np.abs(gaps) > _JUMP * np.abs(np.real(fine)).max())
    area = np.concatenate([[zero], np.cumsum(h * (fine[:, 0] + 4.0 * fine[:, 1] + fine[:, 2]) / 6.0)])
    return np.asarray(_delayed(fine, h, before, tau + zero, nodes, jumps, area))


def _delay_loop(fine: Any, h: Any, before: Any, tau: Any, nodes: Any, jumps: Any, area: Any) -> Any:
    out = np.empty_like(fine)
    # Of the start, middle and end of a step: where it comes from, and the signal's integral up to there.
    rows, areas = np.full(3, -1), np.empty(3, fine.dtype)
    for n in range(fine.shape[0]):
        for i in range(3):
            t = nodes[n] + 0.5 * i * h[n] - tau
            row = rows[i]
            while row + 1 < h.shape[0] and nodes[row + 1] <= real(t) + (1 - i) * _INSIDE * h[n]:
                row += 1
            rows[i] = row
            if row < 0:
                out[n, i], areas[i] = before, before * t
            else:
                s = (t - nodes[row]) / h[row]
                out[n, i], part = parabola(fine[row, 0], fine[row, 1], fine[row, 2], s)
                areas[i] = area[row] + h[row] * part
        first, last = rows[0], rows[2]
        if last >= 0 and jumps[last] > (jumps[first] if first >= 0 else 0):
            mean = (areas[2] - areas[0]) / h[n]
            out[n, 1] = 1.5 * mean - 0.25 * (out[n, 0] + out[n, 2])
    return out


@shared
def parabola(first: Any, middle: Any, last: Any, s: Any) -> Any:
    """The parabola through values at 0, ½ and 1, at ``s``, and its integral from 0 to there."""
    linear, square = 4.0 * middle - 3.0 * first - last, 2.0 * (first + last) - 4.0 * middle
    return first + s * (linear + s * square), s * (first + s * (0.5 * linear + s * square / 3.0))


_delayed = entry(_delay_loop)
