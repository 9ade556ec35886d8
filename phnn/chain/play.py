"""Play between what moves and what is measured."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.chain.midpoints import midpoints
from phnn.integrate.cache import entry
from phnn.laws.namespace import maximum, minimum, real

Array = NDArray[Any]


def play(y: Array, t: Array, width: Any) -> Array:
    """The play operator of half-width ``δ``: ``w`` rests while ``|y − w| < δ`` and is carried along at the edges.

    It starts centred at the first sample. A reversal between two samples is that of the parabola through them and
    their midpoint, or plateaus would come out too low.
    """
    columns = y.reshape(y.shape[0], -1)
    zero = 0.0 * (width + columns[0, 0])
    found = _played(columns + zero, midpoints(columns, t.ravel()) + zero, width + zero)
    return np.asarray(found.reshape(y.shape))


def _play_loop(y: Any, middle: Any, width: Any) -> Any:
    out = np.empty_like(y)
    for k in range(y.shape[1]):
        state = y[0, k]
        out[0, k] = state
        for n in range(middle.shape[0]):
            linear = 4.0 * middle[n, k] - 3.0 * y[n, k] - y[n + 1, k]
            square = 2.0 * (y[n, k] + y[n + 1, k]) - 4.0 * middle[n, k]
            # The parabola has its vertex at −linear/(2 square), if that is inside the interval.
            if real(linear) * real(square) < 0.0 and abs(real(linear)) < 2.0 * abs(real(square)):
                turn = y[n, k] - 0.25 * linear * linear / square
                state = maximum(minimum(state, turn + width), turn - width)
            state = maximum(minimum(state, y[n + 1, k] + width), y[n + 1, k] - width)
            out[n + 1, k] = state
    return out


_played = entry(_play_loop)
