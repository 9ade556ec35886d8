"""Static maps with another slope beyond a level, or below one: compositions of them are monotone characteristics."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.laws.namespace import maximum, minimum, real, where

Array = NDArray[Any]


def kneed(u: Array, share: Any, level: Any) -> Array:
    """``u − a max(u − U, 0)`` for ``U ≥ 0`` and mirrored for ``U < 0``: the slope is ``1 − a`` beyond the level.

    Monotone for ``a ≤ 1``.
    """
    side = where(real(level) < 0.0, -1.0 + 0.0 * level, 1.0 + 0.0 * level)
    beyond = side * (u - level)
    return np.asarray(u - share * side * maximum(beyond, 0.0 * beyond))


def banded(u: Array, share: Any, level: Any) -> Array:
    """``u − a clip(u, ±U)``: the slope is ``1 − a`` below the level, a dead band for ``a = 1``, monotone up to it."""
    inside = 0.0 * u + level
    return np.asarray(u - share * maximum(minimum(u + 0.0 * inside, inside), -inside))


def bent(u: Array, square: Any, cube: Any, level: Any) -> Array:
    """``u + U (a₂ s² + a₃ s³)``, ``s = u/U``, continued by its tangents for ``|s| > 1``.

    Its slope is at least ``1 − 2|a₂| − 3|a₃|`` everywhere.
    """
    s = u * (1.0 / level)
    inner = maximum(minimum(s, 1.0 + 0.0 * s), -1.0 + 0.0 * s)
    slope = inner * (2.0 * square + 3.0 * cube * inner)
    return np.asarray(u + level * (inner * inner * (square + cube * inner) + slope * (s - inner)))
