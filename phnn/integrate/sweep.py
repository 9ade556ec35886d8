"""Sweeps of the linearised steps: forward sensitivities with many right-hand sides, and the adjoint.

By the implicit function theorem the derivatives of an integration obey `phnn.integrate.recursion`.
`phnn.integrate.linearise` takes the local derivatives of the same steps that were integrated.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.errors import StructureViolated
from phnn.integrate.actions import action_derivatives, actions
from phnn.integrate.cache import loop_entry
from phnn.integrate.pattern import Pattern, Run, pattern_of
from phnn.integrate.perturbed import Derivatives, new_derivatives
from phnn.integrate.program import Program
from phnn.integrate.recursion import Asked, Pulled, Sensitivities, adjoint_steps, sensitivity_steps
from phnn.integrate.tables import (
    PLACE_4,
    PORTS,
    rows_of,
)

Array = NDArray[np.float64]

_sensitivities = loop_entry(sensitivity_steps)
_adjoint = loop_entry(adjoint_steps)


def carrier(program: Program, port: int) -> int:
    """An unused entry of theta in the padded row of a port's law.

    As an active parameter it changes only the actions, by the derivatives that `sensitivities` is given for it.
    """
    return int(rows_of(program.table, PORTS)[port, PLACE_4])


class Integrated(NamedTuple):
    """An integrated program; for the shapes see `phnn.integrate.kernel.march`."""

    program: Program
    theta: Array
    states: Array
    efforts: Array
    u: Array
    h: Array

    def first(self, steps: int | None) -> Integrated:
        """The same in the first steps; in all of them where ``steps`` is None."""
        nodes = None if steps is None else steps + 1
        return Integrated(
            self.program, self.theta, self.states[:nodes], self.efforts[:steps], self.u[:steps], self.h[:steps]
        )


class Perturbed(NamedTuple):
    """The perturbations of a forward sweep that last for all steps; those of initial states are given separately.

    Attributes:
        active: (K,) indices into theta.
        forces: (n, F) perturbations of the junction's force, one column each.
        varied: (W,) the active parameters that a signal perturbs; weights: (n, W) these signals.
        pushed: for active places that are a `carrier`, by their number among the active: (n, P) change of the actions.
    """

    active: NDArray[np.int64]
    forces: Array
    varied: NDArray[np.int64]
    weights: Array
    pushed: Mapping[int, Array]

    @property
    def columns(self) -> int:
        """Number of perturbations."""
        return self.active.size + self.forces.shape[1] + self.varied.size

    def first(self, steps: int | None) -> Perturbed:
        """The same in the first steps; in all of them where ``steps`` is None."""
        pushed = {k: action[:steps] for k, action in self.pushed.items()}
        return Perturbed(self.active, self.forces[:steps], self.varied, self.weights[:steps], pushed)


def by_parameters(active: NDArray[np.int64], steps: int) -> Perturbed:
    """Perturb only the parameters at some entries of theta."""
    none = np.zeros((steps, 0))
    return Perturbed(active, none, np.zeros(0, dtype=np.int64), none, {})


def _prepared(
    march: Integrated, active: NDArray[np.int64], pushed: Mapping[int, Array]
) -> tuple[Pattern, Run, Derivatives]:
    """The arguments of a program's sweeps: pattern, integrated steps and work arrays."""
    program, theta, states, efforts, u, h = march
    pattern = pattern_of(program, tuple(active.tolist()))
    in_laws = active[pattern.in_ports >= 0]
    by_port = action_derivatives(program, theta, u, in_laws)
    for k, action in pushed.items():
        by_port[pattern.in_ports[k]] = action
    run = Run(states, efforts, h, actions(program, theta, u), by_port)
    return pattern, run, new_derivatives(program.table, pattern, theta, run)


def sensitivities(
    march: Integrated,
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
        march: the integrated steps.
        perturbed: the perturbations.
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
    if perturbed.forces.shape[1] and not m:
        raise StructureViolated("no force acts in a network without a storage that others drive: ask for no forces")
    first_varied = first_force + perturbed.forces.shape[1]
    out = np.empty((nodes.size, first_varied + varied.size))
    known = np.zeros((states.shape[1] + m, out.shape[1]))
    known[: states.shape[1], : start.shape[1]] = start
    known[initial, active.size + np.arange(initial.size)] = 1.0
    junction, following = program.junctions.index(program.states[program.flow]) if m else 0, np.zeros_like(known)
    columns = (junction, first_force, first_varied, varied)
    asked = Asked(perturbed.forces, columns, perturbed.weights, nodes, program.output)
    _sensitivities(program.table, pattern, memory, run, asked, Sensitivities(known, following, np.zeros((m, m))), out)
    if end is not None:
        # The sweep swaps the two arrays after every step.
        end[:] = (following if march.h.size % 2 else known)[: states.shape[1]]
    return out


def adjoint(
    march: Integrated,
    active: NDArray[np.int64],
    cotangent: Array,
    multipliers: Array | None = None,
    carry: Array | None = None,
) -> tuple[Array, Array]:
    """Backward sweep of the linearised recursion.

    Args:
        march: the integrated steps, or a window of them.
        active: (K,) indices into theta.
        cotangent: (n+1, N) ``dL/dx`` at the nodes.
        multipliers: (n, N+m) filled with ``dL/dx⁺`` of every step and the multipliers of its ``F``.
        carry: (N,) the contribution of later windows to ``dL/dx`` at the last node.

    Returns:
        (K,) ``dL/dθ`` of the window, and (N,) ``dL/dx`` at its first node without the cotangent of that node.
    """
    pattern, run, memory = _prepared(march, active, {})
    m = len(march.program.junctions)
    w = np.zeros(march.states.shape[1]) if carry is None else carry.copy()
    gradient, pulled = np.zeros(active.size), np.zeros(pattern.slot.size)
    room = np.zeros((0, 0)) if multipliers is None else multipliers
    found = Pulled(w, gradient, room, pulled, np.zeros((m, 1)), np.zeros((m, m)))
    _adjoint(march.program.table, pattern, memory, run, cotangent, found)
    return gradient, w
