"""Sweeps of the linearised march: forward sensitivities with many right-hand sides, and the adjoint.

By the implicit function theorem the derivatives of a march obey `phnn.integrate.recursion`, whose local derivatives are
taken of the very step that marched by `phnn.integrate.linearise`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.actions import action_derivatives, actions
from phnn.integrate.compiled import loop_entry
from phnn.integrate.linearise import derivatives_at
from phnn.integrate.pattern import Pattern, Run, pattern_of
from phnn.integrate.perturbed import Derivatives, new_derivatives
from phnn.integrate.program import Program
from phnn.integrate.recursion import make_adjoint, make_sensitivities
from phnn.integrate.tables import (
    PLACE_4,
    PORTS,
    rows_of,
)

Array = NDArray[np.float64]

_sensitivity_steps = make_sensitivities(derivatives_at)
_adjoint_steps = make_adjoint(derivatives_at)


# What is cached has to stand in a module, which a function that another one has made does not.
@loop_entry
def _sensitivities(*arguments: Any) -> None:
    _sensitivity_steps(*arguments)


@loop_entry
def _adjoint(*arguments: Any) -> None:
    _adjoint_steps(*arguments)


def carrier(program: Program, port: int) -> int:
    """A place in theta that stands in the law of a port, where its row is padded, and that nothing reads.

    As an active parameter it changes nothing but the actions that `sensitivities` is given for it.
    """
    return int(rows_of(program.table, PORTS)[port, PLACE_4])


class Marched(NamedTuple):
    """A program that has been integrated, for the shapes see `phnn.integrate.kernel.march`."""

    program: Program
    theta: Array
    states: Array
    efforts: Array
    u: Array
    h: Array

    def first(self, steps: int | None) -> Marched:
        """The same in the first steps; in all of them where ``steps`` is None."""
        nodes = None if steps is None else steps + 1
        return Marched(
            self.program, self.theta, self.states[:nodes], self.efforts[:steps], self.u[:steps], self.h[:steps]
        )


class Perturbed(NamedTuple):
    """What a forward sweep perturbs all along a march, beside initial states.

    Attributes:
        active: (K,) places in theta.
        forces: (n, F) perturbations of the junction's force, one column each.
        varied: (W,) which active parameter is perturbed by a signal; weights: (n, W) by which one.
        pushed: for active places that are a `carrier`, by their number among the active: (n, P) change of the actions.
    """

    active: NDArray[np.int64]
    forces: Array
    varied: NDArray[np.int64]
    weights: Array
    pushed: Mapping[int, Array]

    @property
    def columns(self) -> int:
        """How many perturbations there are."""
        return self.active.size + self.forces.shape[1] + self.varied.size

    def first(self, steps: int | None) -> Perturbed:
        """The same in the first steps; in all of them where ``steps`` is None."""
        pushed = {k: action[:steps] for k, action in self.pushed.items()}
        return Perturbed(self.active, self.forces[:steps], self.varied, self.weights[:steps], pushed)


def by_parameters(active: NDArray[np.int64], steps: int) -> Perturbed:
    """Perturb the parameters at some places in theta, and nothing else."""
    none = np.zeros((steps, 0))
    return Perturbed(active, none, np.zeros(0, dtype=np.int64), none, {})


def _prepared(
    march: Marched, active: NDArray[np.int64], pushed: Mapping[int, Array]
) -> tuple[Pattern, Run, Derivatives]:
    """What the sweeps of a program take: pattern, march and memory."""
    program, theta, states, efforts, u, h = march
    pattern = pattern_of(program, tuple(active.tolist()))
    in_laws = active[pattern.in_ports >= 0]
    by_port = action_derivatives(program, theta, u, in_laws)
    for k, action in pushed.items():
        by_port[pattern.in_ports[k]] = action
    run = Run(states, efforts, h, actions(program, theta, u), by_port)
    return pattern, run, new_derivatives(program.table, pattern, theta, run)


def sensitivities(
    march: Marched,
    perturbed: Perturbed,
    start: Array,
    initial: NDArray[np.int64],
    nodes: NDArray[np.int64],
    end: Array | None = None,
) -> Array:
    """Forward sweep of the linearised recursion with many right-hand sides.

    Columns are, in order: the active parameters, perturbed initial states, perturbed forces on the junction through
    which the output flows, and parameters perturbed by a signal instead of a constant.

    Args:
        march: what has been integrated.
        perturbed: what is perturbed.
        start: (N, C) derivative of the initial state by the first C columns; those of initial states are given below.
        initial: (S,) state whose initial value column ``K + s`` perturbs.
        nodes: (M,) increasing step indices at which the output is wanted, the first 0.
        end: (N, K + S + F + W) filled with the derivatives of the last state.

    Returns:
        (M, K + S + F + W) the output's derivatives.
    """
    program, states, active, varied = march.program, march.states, perturbed.active, perturbed.varied
    pattern, run, memory = _prepared(march, active, perturbed.pushed)
    m, first_force = len(program.junctions), active.size + initial.size
    first_varied = first_force + perturbed.forces.shape[1]
    out = np.empty((nodes.size, first_varied + varied.size))
    known = np.zeros((states.shape[1] + m, out.shape[1]))
    known[: states.shape[1], : start.shape[1]] = start
    known[initial, active.size + np.arange(initial.size)] = 1.0
    junction, following = program.junctions.index(program.states[program.flow]) if m else 0, np.zeros_like(known)
    columns = (junction, first_force, first_varied, varied)
    _sensitivities(
        program.table, pattern, memory, run, perturbed.forces, columns, perturbed.weights, nodes, program.output, known,
        following, np.zeros((m, m)), out,
    )  # fmt: skip
    if end is not None:
        # The sweep goes back and forth between the two.
        end[:] = (following if march.h.size % 2 else known)[: states.shape[1]]
    return out


def adjoint(
    march: Marched,
    active: NDArray[np.int64],
    cotangent: Array,
    multipliers: Array | None = None,
    carry: Array | None = None,
) -> tuple[Array, Array]:
    """Backward sweep of the linearised recursion.

    Args:
        march: what has been integrated, or a window of it.
        active: (K,) places in theta.
        cotangent: (n+1, N) ``dL/dx`` at the nodes.
        multipliers: (n, N+m) filled with ``dL/dx⁺`` of every step and the multipliers of its ``F``.
        carry: (N,) what later windows have passed back to the last node.

    Returns:
        (K,) ``dL/dθ`` of the window, and (N,) ``dL/dx`` at its first node but for that node's own cotangent.
    """
    pattern, run, memory = _prepared(march, active, {})
    m = len(march.program.junctions)
    w = np.zeros(march.states.shape[1]) if carry is None else carry.copy()
    gradient, pulled = np.zeros(active.size), np.zeros(pattern.slot.size)
    room = np.zeros((0, 0)) if multipliers is None else multipliers
    _adjoint(
        march.program.table, pattern, memory, run, cotangent, w, gradient, room, pulled, np.zeros((m, 1)),
        np.zeros((m, m)),
    )  # fmt: skip
    return gradient, w
