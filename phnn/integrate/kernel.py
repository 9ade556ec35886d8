"""The compiled march: the steps of `phnn.integrate.step` solved one after the other."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.integrate import quick
from phnn.integrate.actions import actions
from phnn.integrate.compiled import entry, inline, loop
from phnn.integrate.constants import CONSTANTS, fill_gains
from phnn.integrate.lookups import count, is_linear, junction_storage
from phnn.integrate.program import Program
from phnn.integrate.solve import prepare, rest_guess, solve_many, solve_one
from phnn.integrate.step import EFFORT, NEXT, balance
from phnn.integrate.tables import JUNCTIONS, LEAVES

Array = NDArray[np.float64]


@inline
def _guess(t: Any, theta: Any, n: Any, states: Any, efforts: Any, y: Any) -> None:
    """The unknowns of step ``n`` extrapolated from the two before it; at the start nothing changes."""
    if n == 0:
        rest_guess(t, theta, states[0], y)
        return
    for j in range(y.shape[0]):
        k = junction_storage(t, j)
        if is_linear(t, j):
            y[j] = efforts[n - 1, k] if n == 1 else 2.0 * efforts[n - 1, k] - efforts[n - 2, k]
        else:
            y[j] = 2.0 * states[n, k] - states[n - 1, k]


@loop
def _march_steps(
    t: Any, actions: Any, h: Any, states: Any, efforts: Any, values: Any, perturbed: Any, jacobian: Any, step: Any,
    own: Any,
) -> Any:  # fmt: skip
    """The steps of `_march`, which owns all memory: without it, reference counts of arrays cost most of the time."""
    theta, c, g, a, x, y, wj, wx = values
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
            balance(t, theta, c, g, a, x, y, h[n], wj, wx)
        else:
            solved = solve_many(t, h[n], values, perturbed, jacobian, step, own)
        for k in range(x.shape[0]):
            states[n + 1, k] = wx[NEXT, k]
            efforts[n, k] = wx[EFFORT, k]
            solved = solved and np.isfinite(wx[NEXT, k]) and np.isfinite(wx[EFFORT, k])
        if not solved:
            return n
    return actions.shape[0]


def _march(t: Any, theta: Any, x0: Any, actions: Any, h: Any, states: Any, efforts: Any) -> Any:
    n, m = x0.shape[0], count(t, JUNCTIONS)
    rows, leaves, ports = t.shape[0], count(t, LEAVES), actions.shape[1]
    values = (
        theta, np.zeros((leaves + m, CONSTANTS)), np.zeros(rows), np.zeros(ports), np.zeros(n), np.zeros(m),
        np.zeros((4, m)), np.zeros((2, n)),
    )  # fmt: skip
    fill_gains(t, theta, values[2])
    perturbed = (
        theta.astype(np.complex128), np.zeros((leaves + m, CONSTANTS), np.complex128),
        values[2].astype(np.complex128), np.zeros(ports, np.complex128), np.zeros(n, np.complex128),
        np.zeros(m, np.complex128), np.zeros((4, m), np.complex128), np.zeros((2, n), np.complex128),
    )  # fmt: skip
    states[0] = x0
    return _march_steps(
        t, actions, h, states, efforts, values, perturbed, np.zeros((m, m)), np.zeros((m, 1)), np.zeros((7, m))
    )


general = entry(_march)


def march(program: Program, theta: Array, x0: Array, u: Array, h: Array, states: Array, efforts: Array) -> int:
    """March ``n`` steps of a program; returns how many were solved.

    Args:
        theta: (M,) parameters, see `Program.theta`.
        x0: (N,) initial state, in the order of the network.
        u: (n, P) mean inputs of the steps; h: (n,) their sizes [s].
        states: (n+1, N) filled; efforts: (n, N) filled with the mean efforts of the storages.
    """
    compiled = quick.march if program.quick else general
    return int(compiled(program.table, theta, x0, actions(program, theta, u), h, states, efforts))
