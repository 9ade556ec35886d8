"""The compiled integration of any network: it solves the steps of `phnn.integrate.step` one after the other."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.cache import inline, loop_entry
from phnn.integrate.constants import CONSTANTS, fill_gains
from phnn.integrate.modulator_states import advance
from phnn.integrate.program import Program
from phnn.integrate.roots import extrapolated
from phnn.integrate.scalar import prepare, solve_one
from phnn.integrate.solve import Room, rest_guess, solve_many
from phnn.integrate.step import balance
from phnn.integrate.table_access import count, is_linear, junction_storage
from phnn.integrate.tables import JUNCTIONS, LEAVES, MODULATOR_STATES, rows_of
from phnn.integrate.terms import EFFORT, NEXT, Step

Array = NDArray[np.float64]


@inline
def _guess(t: Any, theta: Any, n: Any, states: Any, efforts: Any, y: Any) -> None:
    """Extrapolate the unknowns of step ``n`` from the two steps before it; the first step keeps its initial values."""
    if n == 0:
        rest_guess(t, theta, states[0], y)
        return
    for j in range(y.shape[0]):
        k = junction_storage(t, j)
        y[j] = extrapolated(efforts, n, k) if is_linear(t, j) else extrapolated(states, n + 1, k)


def _steps(
    t: Any, actions: Any, h: Any, states: Any, efforts: Any, both: Any, room: Room
) -> Any:  # fmt: skip
    """Integrate; ``both`` are the values of a step in floats and in complex numbers."""
    values, perturbed = both
    theta, c, g, a, x, y, wj, wx = values
    fill_gains(t, theta, g)
    for r in range(g.shape[0]):
        perturbed[2][r] = g[r]
    c_c, a_c, x_c = perturbed[1], perturbed[3], perturbed[4]
    m = y.shape[0]
    slope = 0.0
    for n in range(actions.shape[0]):
        for k in range(x.shape[0]):
            x[k] = states[n, k]
            x_c[k] = states[n, k]
        _guess(t, theta, n, states, efforts, y)
        if n == 0 or h[n] != h[n - 1]:
            slope = 0.0
            prepare(t, theta, h[n], c, c_c)
        for p in range(a.shape[0]):
            a[p] = actions[n, p]
            a_c[p] = actions[n, p]
        solved = True
        if m == 1:
            solved, slope = solve_one(t, h[n], slope, values, perturbed)
        elif m == 0:
            balance(t, Step(theta, c, g, a, x, y, h[n], wj), wx)
        else:
            solved = solve_many(t, h[n], values, perturbed, room)
        if count(t, MODULATOR_STATES) > 0:
            advance(t, Step(theta, c, g, a, x, y, h[n], wj), wx)
        for k in range(x.shape[0]):
            states[n + 1, k] = wx[NEXT, k]
            efforts[n, k] = wx[EFFORT, k]
            solved = solved and np.isfinite(wx[NEXT, k]) and np.isfinite(wx[EFFORT, k])
        if not solved:
            return n
    return actions.shape[0]


_compiled = loop_entry(_steps)


def march(program: Program, theta: Array, actions: Array, h: Array, states: Array, efforts: Array) -> int:
    """`phnn.integrate.kernel.Kernel.march` of every network."""
    t = program.table
    n, m, leaves = states.shape[1], len(rows_of(t, JUNCTIONS)), len(rows_of(t, LEAVES))
    shapes = ((leaves + m, CONSTANTS), len(t), actions.shape[1], n, m, (4, m), (2, n))
    values = (theta, *(np.zeros(shape) for shape in shapes))
    perturbed = (theta.astype(np.complex128), *(np.zeros(shape, np.complex128) for shape in shapes))
    room = Room(np.zeros((m, m)), np.zeros((m, 1)), np.zeros((7 + m, m)))
    return int(_compiled(t, actions, h, states, efforts, (values, perturbed), room))
