"""The compiled kernels that integrate a program, and the choice of the fastest one.

All kernels take the same steps (`phnn.integrate.step`) and differ in speed alone. `phnn.integrate.sweep` differentiates
these steps, whichever kernel has integrated them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.errors import InputRefused
from phnn.integrate import quick
from phnn.integrate.cache import inline, loop_entry
from phnn.integrate.program import Program, actions
from phnn.integrate.roots import extrapolated
from phnn.integrate.solve import Room, prepare, rest_guess, solve_many, solve_one
from phnn.integrate.step import CONSTANTS, EFFORT, NEXT, Step, advance, balance, fill_gains
from phnn.integrate.table_access import count, is_linear, junction_storage
from phnn.integrate.tables import JUNCTIONS, LEAVES, MODULATOR_STATES, rows_of

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


def march_any(program: Program, theta: Array, actions: Array, h: Array, states: Array, efforts: Array) -> int:
    """`Kernel.march` of every network: the steps are solved one after the other."""
    t = program.table
    n, m, leaves = states.shape[1], len(rows_of(t, JUNCTIONS)), len(rows_of(t, LEAVES))
    shapes = ((leaves + m, CONSTANTS), len(t), actions.shape[1], n, m, (4, m), (2, n))
    values = (theta, *(np.zeros(shape) for shape in shapes))
    perturbed = (theta.astype(np.complex128), *(np.zeros(shape, np.complex128) for shape in shapes))
    room = Room(np.zeros((m, m)), np.zeros((m, 1)), np.zeros((7 + m, m)), program.held)
    return int(_compiled(t, actions, h, states, efforts, (values, perturbed), room))


class Kernel(NamedTuple):
    """A compiled way to integrate some programs.

    Attributes:
        name: short name.
        serves: whether it integrates a program.
        march: ``(program, theta, actions, h, states, efforts) -> solved``: fills states and efforts from the initial
            state in ``states[0]`` under the actions (n, P) of the ports; returns the number of solved steps.
        work: of one step, in steps of the fastest kernel.
    """

    name: str
    serves: Callable[[Program], bool]
    march: Callable[[Program, Array, Array, Array, Array, Array], int]
    work: float = 1.0


# The fastest first.
KERNELS = {
    "single junction": Kernel("single junction", quick.serves, quick.march),
    "general": Kernel("general", lambda program: True, march_any, 4.0),
}


def kernel_for(program: Program, prefer: str | None = None) -> Kernel:
    """The fastest kernel that serves a program.

    Args:
        prefer: name of the kernel to use instead.

    Raises:
        InputRefused: no kernel has that name, or it does not serve the program.
    """
    if prefer is None:
        return next(kernel for kernel in KERNELS.values() if kernel.serves(program))
    if prefer not in KERNELS:
        raise InputRefused(f"kernel {prefer!r}: choose one of {', '.join(KERNELS)}")
    if not KERNELS[prefer].serves(program):
        raise InputRefused(f"kernel {prefer!r} does not serve this network: take the general one")
    return KERNELS[prefer]


def work_of(program: Program) -> float:
    """The work of a step and of its derivatives, in steps of the fastest kernel in which nothing is modulated."""
    following = sum(map(bool, program.sparsity.thresholds))
    return kernel_for(program).work + 0.25 * following + len(program.sparsity.modulators)


def march(program: Program, theta: Array, x0: Array, u: Array, h: Array, states: Array, efforts: Array) -> int:
    """Integrate ``n`` steps of a program by the fastest kernel; returns the number of solved steps.

    Args:
        theta: (M,) parameters, see `Program.theta`.
        x0: (N,) initial state, in the order of the network: storages, then modulator states.
        u: (n, P) mean inputs of the steps; h: (n,) their sizes [s].
        states: (n+1, N) filled; efforts: (n, N) filled with the mean efforts of the storages and the mean drives of the
            modulator states.
    """
    states[0] = x0
    return kernel_for(program).march(program, theta, actions(program, theta, u), h, states, efforts)
