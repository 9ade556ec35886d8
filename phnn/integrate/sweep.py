"""Sweeps of the linearised march: forward sensitivities with many right-hand sides, and the adjoint.

By the implicit function theorem the derivatives of a march obey `phnn.integrate.recursion`, whose local derivatives are
taken of the very step that marched: by `phnn.integrate.linearise`, or by `phnn.integrate.pieces` where that one serves.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.integrate import linearise, pieces
from phnn.integrate.actions import action_derivatives, actions
from phnn.integrate.compiled import entry
from phnn.integrate.linearise import Pattern, Run, pattern_of
from phnn.integrate.program import Program
from phnn.integrate.recursion import make_adjoint, make_sensitivities

Array = NDArray[np.float64]

_general_sensitivities = make_sensitivities(linearise.new_derivatives, linearise.derivatives_at)
_general_adjoint = make_adjoint(linearise.new_derivatives, linearise.derivatives_at)
_quick_sensitivities = make_sensitivities(pieces.new_pieces, pieces.derivatives_at)
_quick_adjoint = make_adjoint(pieces.new_pieces, pieces.derivatives_at)


@entry
def general_sensitivities(*arguments: Any) -> None:
    """For every network."""
    _general_sensitivities(*arguments)


@entry
def general_adjoint(*arguments: Any) -> None:
    """For every network."""
    _general_adjoint(*arguments)


@entry
def quick_sensitivities(*arguments: Any) -> None:
    """For those of `phnn.integrate.quick`."""
    _quick_sensitivities(*arguments)


@entry
def quick_adjoint(*arguments: Any) -> None:
    """For those of `phnn.integrate.quick`."""
    _quick_adjoint(*arguments)


def _prepared(
    program: Program, theta: Array, active: NDArray[np.int64], states: Array, efforts: Array, u: Array, h: Array
) -> tuple[Pattern, Run]:
    pattern = pattern_of(program, tuple(active.tolist()))
    in_laws = active[pattern.in_ports >= 0]
    return pattern, Run(states, efforts, h, actions(program, theta, u), action_derivatives(program, theta, u, in_laws))


def sensitivities(
    program: Program, theta: Array, active: NDArray[np.int64], states: Array, efforts: Array, u: Array, h: Array,
    start: Array, initial: NDArray[np.int64], forces: Array, varied: NDArray[np.int64], weights: Array,
    nodes: NDArray[np.int64],
) -> Array:  # fmt: skip
    """Forward sweep of the linearised recursion with many right-hand sides.

    Columns are, in order: the active parameters, perturbed initial states, perturbed forces on the junction through
    which the output flows, and parameters perturbed by a signal instead of a constant.

    Args:
        active: (K,) places in theta.
        states, efforts, u, h: of the march.
        start: (N, K) derivative of the initial state by the active parameters.
        initial: (S,) state whose initial value column ``K + s`` perturbs.
        forces: (n, F) perturbations of the junction's force, one column each.
        varied: (W,) which active parameter is perturbed; weights: (n, W) by which signal.
        nodes: (M,) increasing step indices at which the output is wanted, the first 0.

    Returns:
        (M, K + S + F + W) the output's derivatives.
    """
    out = np.empty((nodes.size, active.size + initial.size + forces.shape[1] + varied.size))
    junction = program.junctions.index(program.states[program.flow]) if program.junctions else 0
    compiled = quick_sensitivities if program.quick else general_sensitivities
    pattern, run = _prepared(program, theta, active, states, efforts, u, h)
    compiled(
        program.table,
        pattern,
        theta,
        run,
        start,
        initial,
        forces,
        junction,
        varied,
        weights,
        nodes,
        program.output,
        out,
    )
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
    w = np.zeros(states.shape[1]) if carry is None else carry.copy()
    gradient = np.zeros(active.size)
    room = np.zeros((0, 0)) if multipliers is None else multipliers
    compiled = quick_adjoint if program.quick else general_adjoint
    pattern, run = _prepared(program, theta, active, states, efforts, u, h)
    compiled(program.table, pattern, theta, run, cotangent, w, gradient, room)
    return gradient, w
