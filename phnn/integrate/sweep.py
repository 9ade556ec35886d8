"""Sweeps of the linearised march: forward sensitivities with many right-hand sides, and the adjoint.

By the implicit function theorem the derivatives of a march obey `phnn.integrate.recursion`, whose local derivatives are
taken of the very step that marched: by `phnn.integrate.linearise`, or by `phnn.integrate.pieces` where that one serves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.integrate import linearise, pieces, quick
from phnn.integrate.actions import action_derivatives, actions
from phnn.integrate.compiled import loop_entry
from phnn.integrate.linearise import Pattern, Run, pattern_of
from phnn.integrate.program import Program
from phnn.integrate.recursion import make_adjoint, make_sensitivities
from phnn.integrate.tables import PORTS, Integers, rows_of

Array = NDArray[np.float64]

_general_sensitivities = make_sensitivities(linearise.derivatives_at)
_general_adjoint = make_adjoint(linearise.derivatives_at)
_quick_sensitivities = make_sensitivities(pieces.derivatives_at)
_quick_adjoint = make_adjoint(pieces.derivatives_at)


# What is cached has to stand in a module, which a function that another one has made does not.
@loop_entry
def _every_sensitivities(*arguments: Any) -> None:
    _general_sensitivities(*arguments)


@loop_entry
def _every_adjoint(*arguments: Any) -> None:
    _general_adjoint(*arguments)


@loop_entry
def _some_sensitivities(*arguments: Any) -> None:
    _quick_sensitivities(*arguments)


@loop_entry
def _some_adjoint(*arguments: Any) -> None:
    _quick_adjoint(*arguments)


class _Sweeps(NamedTuple):
    """The sweeps by one way to differentiate a step, and the memory for it."""

    sensitivities: Callable[..., None]
    adjoint: Callable[..., None]
    memory: Callable[[Integers, Pattern, Array, Run], Any]


_GENERAL = _Sweeps(_every_sensitivities, _every_adjoint, linearise.new_derivatives)
_QUICK = _Sweeps(_some_sensitivities, _some_adjoint, pieces.new_pieces)


def carrier(program: Program, port: int) -> int:
    """A place in theta that stands in the law of a port, where its row is padded, and that nothing reads.

    As an active parameter it changes nothing but the actions that `sensitivities` is given for it.
    """
    return int(rows_of(program.table, PORTS)[port, 4])


def _prepared(
    program: Program, theta: Array, active: NDArray[np.int64], states: Array, efforts: Array, u: Array, h: Array,
    pushed: Mapping[int, Array],
) -> tuple[_Sweeps, Pattern, Run, Any]:  # fmt: skip
    """The sweeps of a program with what they take: pattern, march and memory."""
    sweeps = _QUICK if quick.serves(program) else _GENERAL
    pattern = pattern_of(program, tuple(active.tolist()))
    in_laws = active[pattern.in_ports >= 0]
    by_port = action_derivatives(program, theta, u, in_laws)
    for k, action in pushed.items():
        by_port[pattern.in_ports[k]] = action
    run = Run(states, efforts, h, actions(program, theta, u), by_port)
    return sweeps, pattern, run, sweeps.memory(program.table, pattern, theta, run)


def sensitivities(
    program: Program, theta: Array, active: NDArray[np.int64], states: Array, efforts: Array, u: Array, h: Array,
    start: Array, initial: NDArray[np.int64], forces: Array, varied: NDArray[np.int64], weights: Array,
    nodes: NDArray[np.int64], pushed: Mapping[int, Array] | None = None, end: Array | None = None,
) -> Array:  # fmt: skip
    """Forward sweep of the linearised recursion with many right-hand sides.

    Columns are, in order: the active parameters, perturbed initial states, perturbed forces on the junction through
    which the output flows, and parameters perturbed by a signal instead of a constant.

    Args:
        active: (K,) places in theta.
        states, efforts, u, h: of the march.
        start: (N, C) derivative of the initial state by the first C columns; those of initial states are given below.
        initial: (S,) state whose initial value column ``K + s`` perturbs.
        forces: (n, F) perturbations of the junction's force, one column each.
        varied: (W,) which active parameter is perturbed; weights: (n, W) by which signal.
        nodes: (M,) increasing step indices at which the output is wanted, the first 0.
        pushed: for active places that are a `carrier`, by their number among the active: (n, P) change of the actions.
        end: (N, K + S + F + W) filled with the derivatives of the last state.

    Returns:
        (M, K + S + F + W) the output's derivatives.
    """
    sweeps, pattern, run, memory = _prepared(program, theta, active, states, efforts, u, h, pushed or {})
    m, first_force = len(program.junctions), active.size + initial.size
    first_varied = first_force + forces.shape[1]
    out = np.empty((nodes.size, first_varied + varied.size))
    known = np.zeros((states.shape[1] + m, out.shape[1]))
    known[: states.shape[1], : start.shape[1]] = start
    known[initial, active.size + np.arange(initial.size)] = 1.0
    junction, following = program.junctions.index(program.states[program.flow]) if m else 0, np.zeros_like(known)
    sweeps.sensitivities(
        program.table, pattern, memory, run, forces, (junction, first_force, first_varied, varied), weights, nodes,
        program.output, known, following, np.zeros((m, m)), out,
    )  # fmt: skip
    if end is not None:
        # The sweep goes back and forth between the two.
        end[:] = (following if h.size % 2 else known)[: states.shape[1]]
    return out


def adjoint(
    program: Program, theta: Array, active: NDArray[np.int64], states: Array, efforts: Array, u: Array, h: Array,
    cotangent: Array, multipliers: Array | None = None, carry: Array | None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """Backward sweep of the linearised recursion.

    Args:
        active: (K,) places in theta.
        states, efforts, u, h: of the march, or of a window of it.
        cotangent: (n+1, N) ``dL/dx`` at the nodes.
        multipliers: (n, N+m) filled with ``dL/dx⁺`` of every step and the multipliers of its ``F``.
        carry: (N,) what later windows have passed back to the last node.

    Returns:
        (K,) ``dL/dθ`` of the window, and (N,) ``dL/dx`` at its first node but for that node's own cotangent.
    """
    sweeps, pattern, run, memory = _prepared(program, theta, active, states, efforts, u, h, {})
    m = len(program.junctions)
    w = np.zeros(states.shape[1]) if carry is None else carry.copy()
    gradient, pulled = np.zeros(active.size), np.zeros(pattern.in_junctions.size)
    room = np.zeros((0, 0)) if multipliers is None else multipliers
    sweeps.adjoint(
        program.table, pattern, memory, run, cotangent, w, gradient, room, pulled, np.zeros((m, 1)), np.zeros((m, m))
    )
    return gradient, w
