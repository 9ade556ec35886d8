"""The sweep of the linearised steps: forward sensitivities with many right-hand sides.

By the implicit function theorem the derivatives of an integration obey

    0 = F_x δx + F_y δy + F_θ δθ − δf,     δx_l⁺ = X_x δx + X_y δy + X_θ δθ,     δp⁺ = δp + Z_x δx + Z_y δy + Z_θ δθ

`phnn.integrate.linearise` takes the local derivatives of the same steps that were integrated. Modulator states are
advanced like reducible storages, but may depend on all inputs of a step.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.errors import StructureViolated
from phnn.integrate.cache import inline, loop_entry
from phnn.integrate.linearise import derivatives_at
from phnn.integrate.pattern import Pattern, Run, eliminate, pattern_of
from phnn.integrate.perturbed import Derivatives, new_derivatives
from phnn.integrate.program import Program, action_derivatives, actions
from phnn.integrate.table_access import junction_storage
from phnn.integrate.tables import LEAVES, OWN_STORAGE, PLACE_5, PORTS, rows_of

# It is compiled where Python calls it: as a function of a compiled caller it would be optimised twice.


class Asked(NamedTuple):
    """Perturbations of a forward sweep, and the nodes at which the output is wanted.

    Attributes:
        forces: (n, F); columns: the number of the junction that they act on, the first column of these perturbations
            and that of the parameters perturbed by a signal, the numbers of these parameters; weights: (n, W) signals.
        nodes: (M,) step indices; output: number of the state that is wanted.
    """

    forces: Any
    columns: Any
    weights: Any
    nodes: Any
    output: Any


class Sensitivities(NamedTuple):
    """Derivatives in a forward sweep.

    Attributes:
        known: (N+m, C) of the states, and of the unknowns, which are filled in; following: (N+m, C) its states are
            filled, then both change places.
        matrix: (m, m) work array.
    """

    known: Any
    following: Any
    matrix: Any


@inline
def _add(out: Any, weight: Any, row: Any) -> None:
    if weight != 0.0:
        for c in range(out.shape[0]):
            out[c] += weight * row[c]


@inline
def _set(out: Any, a: Any, x: Any, b: Any, y: Any) -> None:
    """A sum of two rows in one pass: most reducible storages depend on their own state and one flow."""
    for c in range(out.shape[0]):
        out[c] = a * x[c] + b * y[c]


@inline
def _solve_unknowns(p: Any, d: Any, force: Any, columns: Any, known: Any, matrix: Any) -> None:
    """Fill the rows of the unknowns from those of the states."""
    junction, first_force, first_varied, varied, weight_of = columns
    m, k_active = matrix.shape[0], p.active.shape[0]
    n = known.shape[0] - m
    for j in range(m):
        row, by = known[n + j], d.by_force[j]
        _set(row, -by[0], known[0], -by[n - 1] if n > 1 else 0.0, known[n - 1])
        for s in range(1, n - 1):
            _add(row, -by[s], known[s])
        for k in range(k_active):
            row[k] -= by[n + m + k]
        for w in range(varied.shape[0]):
            row[first_varied + w] -= by[n + m + varied[w]] * weight_of[w]
        for i in range(m):
            matrix[j, i] = by[n + i]
    for f in range(force.shape[0]):
        known[n + junction, first_force + f] += force[f]
    if m == 1:
        inverse, row = 1.0 / matrix[0, 0], known[n]
        for c in range(row.shape[0]):
            row[c] *= inverse
    else:
        eliminate(matrix, known[n:])


@inline
def _propagate(t: Any, p: Any, d: Any, force: Any, columns: Any, found: Sensitivities) -> None:
    """One step of the recursion for all columns.

    Args:
        force: (F,) perturbations of one junction's force.
        columns: as of `Asked`, and the signals at this step.
    """
    _, _, first_varied, varied, weight_of = columns
    known, following, matrix = found
    m = matrix.shape[0]
    n = known.shape[0] - m
    _solve_unknowns(p, d, force, columns, known, matrix)
    for j in range(m):
        end = junction_storage(t, j)
        out, by = following[end], d.by_change[j]
        _set(out, 1.0 + by[end], known[end], by[n + j], known[n + j])
        for i in range(n + m):
            if i not in (end, n + j):
                _add(out, by[i], known[i])
        for k in range(p.active.shape[0]):
            out[k] += by[n + m + k]
        for w in range(varied.shape[0]):
            out[first_varied + w] += by[n + m + varied[w]] * weight_of[w]
    for leaf in range(p.first.shape[0] - 1):
        out = following[t[t[0, LEAVES] + leaf, OWN_STORAGE]]
        first, last = p.first[leaf], p.first[leaf + 1]
        # Inputs increase: the storage's own state is among them, and mostly one flow.
        one, two = p.input[first], p.input[first + 1] if first + 1 < last else 0
        paired = first + 1 < last and two < n + m
        _set(out, d.by_leaf[first], known[one], d.by_leaf[first + 1] if paired else 0.0, known[two if paired else one])
        for pair in range(first + (2 if paired else 1), last):
            i = p.input[pair]
            if i < n + m:
                _add(out, d.by_leaf[pair], known[i])
            else:
                out[i - n - m] += d.by_leaf[pair]
                for w in range(varied.shape[0]):
                    if varied[w] == i - n - m:
                        out[first_varied + w] += d.by_leaf[pair] * weight_of[w]
    _modulator_rows(d, columns, known, following, n + m)


@inline
def _modulator_rows(d: Any, columns: Any, known: Any, following: Any, inputs: Any) -> None:
    """Fill the rows of the modulator states; ``inputs`` counts states and unknowns."""
    _, _, first_varied, varied, weight_of = columns
    memories = d.by_modulator.shape[0]
    for k in range(memories):
        # Modulator states are the last states.
        out, by = following[inputs - d.by_force.shape[0] - memories + k], d.by_modulator[k]
        _set(out, by[0], known[0], 0.0, known[0])
        for i in range(1, inputs):
            _add(out, by[i], known[i])
        for i in range(inputs, by.shape[0]):
            out[i - inputs] += by[i]
        for w in range(varied.shape[0]):
            out[first_varied + w] += by[inputs + varied[w]] * weight_of[w]


def sensitivity_steps(
    t: Any, p: Any, d: Any, run: Any, asked: Asked, start: Sensitivities, out: Any
) -> None:  # fmt: skip
    """The forward sweep of `phnn.integrate.sweep.sensitivities`, from the derivatives at its start."""
    junction, first_force, first_varied, varied = asked.columns
    nodes, output = asked.nodes, asked.output
    known, following, matrix = start
    for c in range(out.shape[1]):
        out[0, c] = known[output, c]
    node = 1
    for n in range(run.h.shape[0]):
        derivatives_at(t, p, d, n, run, n == 0 or run.h[n] != run.h[n - 1])
        here = (junction, first_force, first_varied, varied, asked.weights[n])
        _propagate(t, p, d, asked.forces[n], here, Sensitivities(known, following, matrix))
        known, following = following, known
        if node < nodes.shape[0] and nodes[node] == n + 1:
            for c in range(out.shape[1]):
                out[node, c] = known[output, c]
            node += 1


Array = NDArray[np.float64]

_sensitivities = loop_entry(sensitivity_steps)


def carrier(program: Program, port: int) -> int:
    """An unused entry of theta in the padded row of a port's law.

    As an active parameter it changes only the actions, by the derivatives that `sensitivities` is given for it.
    """
    return int(rows_of(program.table, PORTS)[port, PLACE_5])


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
