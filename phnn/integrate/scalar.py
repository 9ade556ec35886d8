"""The unknown of a step with one junction: a bracketed scalar root; what its solution shares with several junctions."""

from __future__ import annotations

from typing import Any

import numpy as np

from phnn.integrate.cache import inline, plain, stay_outside
from phnn.integrate.constants import CAPACITY, fill_constants
from phnn.integrate.roots import make_root
from phnn.integrate.step import balance, inlined_balance
from phnn.integrate.table_access import count, is_linear
from phnn.integrate.tables import LEAVES
from phnn.integrate.terms import FORCE, SIZE, Step
from phnn.laws.namespace import TINY


@inline
def _value_at(y: Any, context: Any) -> Any:
    t, h, values, _ = context
    theta, c, g, a, x, ys, wj, wx = values
    ys[0] = y
    inlined_balance(t, Step(theta, c, g, a, x, ys, h, wj), wx)
    return wj[FORCE, 0], wj[SIZE, 0]


@plain
def _slope_at(y: Any, context: Any) -> Any:
    stay_outside()
    t, h, _, perturbed = context
    theta, c, g, a, x, ys, wj, wx = perturbed
    ys[0] = complex(y, TINY)
    balance(t, Step(theta, c, g, a, x, ys, h, wj), wx)
    return wj[FORCE, 0].imag / TINY


_root = inline(make_root(_value_at, _slope_at))


@plain
def prepare(t: Any, theta: Any, h: Any, c: Any, c_perturbed: Any) -> None:
    """The constants for steps of size ``h``, as floats and as complex numbers."""
    stay_outside()
    fill_constants(t, theta, h, c)
    for i in range(c.shape[0]):
        for k in range(c.shape[1]):
            c_perturbed[i, k] = c[i, k]


@inline
def inertia(t: Any, j: Any, c: Any) -> Any:
    """``d(z_j − p_j)/dy_j``: twice the mass of a linear junction, else one."""
    return 2.0 * c[count(t, LEAVES) + j, CAPACITY] if is_linear(t, j) else 1.0


@inline
def solve_one(t: Any, h: Any, slope: Any, values: Any, perturbed: Any) -> Any:
    """Solve for the one junction from the guess in ``y``; returns success and the slope at the root.

    Args:
        slope: slope of an earlier step as a first guess, or 0.
        values: (theta, c, g, a, x, y, wj, wx) as for `balance`; left at the root.
        perturbed: the same in complex numbers, without perturbations.
    """
    _, c, _, _, _, ys, _, _ = values
    y, slope = _root(ys[0], inertia(t, 0, c) / h, slope, (t, h, values, perturbed))
    ys[0] = y
    return np.isfinite(y), slope
