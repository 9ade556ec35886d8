"""The inverse of a static characteristic that rises, for many values at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# The bracket begins at this share of the largest target and doubles, up to this many times that target: a
# characteristic that needs ten times its input to reach a value is taken to end before it.
_FIRST, _FURTHEST = 1e-3, 10.0
# Halvings of the bracket: after 60 it is as narrow as rounding.
_HALVINGS = 60


class Solved(NamedTuple):
    """Attributes:
    x: (N,) arguments; at values out of reach, where the characteristic comes closest.
    missed: (N,) by how much the characteristic falls short of the value; zero where it is reached.
    """

    x: Array
    missed: Array


def solve_rising(function: Callable[[Array], Array], target: Array) -> Solved:
    """Solve ``f(x) = target`` elementwise for an ``f`` that rises, or rests, from zero on to both sides.

    Args:
        function: (N,) values of (N,) arguments, elementwise.
        target: (N,) values that are wanted.
    """
    at_zero = function(np.zeros_like(target))
    reach = max(float(np.abs(target).max(initial=0.0)), float(np.abs(at_zero).max(initial=0.0)), np.finfo(float).tiny)
    upwards = target >= at_zero
    side = np.where(upwards, 1.0, -1.0)
    near, far = np.zeros_like(target), np.full_like(target, _FIRST * reach)
    short = _short(function, side, far, target)
    while short.any() and float(far.max()) < _FURTHEST * reach:
        near, far = np.where(short, far, near), np.where(short, np.minimum(2.0 * far, _FURTHEST * reach), far)
        short = _short(function, side, far, target)
    # A characteristic that ends gives what it has, with the least argument that gives it.
    wanted = np.where(short, function(side * far), target)
    missed = np.where(short, target - wanted, 0.0)
    near = np.where(short, 0.0, near)
    for _ in range(_HALVINGS):
        middle = 0.5 * (near + far)
        below = _short(function, side, middle, wanted)
        near, far = np.where(below, middle, near), np.where(below, far, middle)
    return Solved(side * far, missed)


def _short(function: Callable[[Array], Array], side: Array, size: Array, target: Array) -> NDArray[np.bool_]:
    """Where the characteristic has not yet come as far as the target."""
    return np.asarray(side * (function(side * size) - target) < 0.0)
