"""The sweep of the linearised steps: forward sensitivities with many right-hand sides, and the steady cycle.

By the implicit function theorem the derivatives of an integration obey

    0 = F_x δx + F_y δy + F_θ δθ − δf,     δx_l⁺ = X_x δx + X_y δy + X_θ δθ,     δp⁺ = δp + Z_x δx + Z_y δy + Z_θ δθ

`phnn.integrate.linearise` takes the local derivatives of the same steps that were integrated. Modulator states are
advanced like reducible storages, but may depend on all inputs of a step.

The steady cycle under a periodic input is found by Newton's method on the period map:

    x = P(x, θ),     (I − M) δx = ∂P/∂θ δθ,     M = ∂P/∂x

A passive network forgets its initial state. Where a resonance is sharp or a modulator state is slow, this takes so many
periods that integrating them all would be too expensive. Neutral directions (monodromy eigenvalue 1), such as a charge
within its dead zone, have no steady value of their own. They keep the value after the run-in (least squares, least
change); their sensitivity is zero.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.errors import SolverFailed, StructureViolated
from phnn.integrate import kernel
from phnn.integrate.cache import inline, loop_entry
from phnn.integrate.kernel import eliminate
from phnn.integrate.linearise import derivatives_at
from phnn.integrate.perturbed import Run, new_derivatives, pattern_of
from phnn.integrate.program import PLACE_5, PORTS, Program, action_derivatives, actions, rows_of
from phnn.integrate.step import junction_storage, leaf_storage

Array = NDArray[np.float64]


class Asked(NamedTuple):
    """Perturbations of a forward sweep, and the nodes at which the output is wanted.

    Attributes:
        forces: (n, F) perturbations of the force on a junction; junction: its number; first_force: their first column.
        varied: (W,) numbers of the parameters that a signal perturbs; weights: (n, W) the signals; first_varied: their
            first column.
        nodes: (M,) step indices; output: number of the state that is wanted.
    """

    forces: Any
    junction: Any
    first_force: Any
    varied: Any
    weights: Any
    first_varied: Any
    nodes: Any
    output: Any


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
def _combine(out: Any, factor: Any, sign: Any, by: Any, known: Any, rows: Any, pair: Any, n: Any, asked: Asked) -> None:
    """Set a row to the chain rule of a block of step ``n``, with a sign, and a multiple of a row.

    Args:
        by: (I,) derivatives by states, unknowns and parameters; known: (N+m, C) rows of states and unknowns.
        rows: number of the rows that count; pair: two of them, taken in one pass; factor: multiple of the first.
    """
    one, two = pair
    inputs = known.shape[0]
    _set(out, factor + sign * by[one], known[one], sign * by[two] if two != one else 0.0, known[two])
    for i in range(rows):
        if i not in (one, two):
            _add(out, sign * by[i], known[i])
    for k in range(by.shape[0] - inputs):
        out[k] += sign * by[inputs + k]
    for w in range(asked.varied.shape[0]):
        out[asked.first_varied + w] += sign * by[inputs + asked.varied[w]] * asked.weights[n, w]


@inline
def _solve_unknowns(d: Any, n: Any, asked: Asked, known: Any, matrix: Any) -> None:
    """Fill the rows of the unknowns from those of the states."""
    m = matrix.shape[0]
    states = known.shape[0] - m
    for j in range(m):
        _combine(known[states + j], 0.0, -1.0, d.by_force[j], known, states, (0, states - 1), n, asked)
        for i in range(m):
            matrix[j, i] = d.by_force[j, states + i]
    for f in range(asked.forces.shape[1]):
        known[states + asked.junction, asked.first_force + f] += asked.forces[n, f]
    if m == 1:
        inverse, row = 1.0 / matrix[0, 0], known[states]
        for c in range(row.shape[0]):
            row[c] *= inverse
    else:
        eliminate(matrix, known[states:])


@inline
def _propagate(t: Any, p: Any, d: Any, n: Any, asked: Asked, known: Any, following: Any) -> None:
    """Fill the rows of the states at the end of step ``n`` from those of states and unknowns."""
    inputs, m, slow = known.shape[0], d.by_force.shape[0], d.by_modulator.shape[0]
    for j in range(m):
        end = junction_storage(t, j)
        _combine(following[end], 1.0, 1.0, d.by_change[j], known, inputs, (end, inputs - m + j), n, asked)
    for leaf in range(p.first.shape[0] - 1):
        out = following[leaf_storage(t, leaf)]
        first, last = p.first[leaf], p.first[leaf + 1]
        # Inputs increase: the storage's own state is among them, and mostly one flow.
        one, two = p.input[first], p.input[first + 1] if first + 1 < last else 0
        paired = first + 1 < last and two < inputs
        _set(out, d.by_leaf[first], known[one], d.by_leaf[first + 1] if paired else 0.0, known[two if paired else one])
        for pair in range(first + (2 if paired else 1), last):
            i = p.input[pair]
            if i < inputs:
                _add(out, d.by_leaf[pair], known[i])
            else:
                out[i - inputs] += d.by_leaf[pair]
                for w in range(asked.varied.shape[0]):
                    if asked.varied[w] == i - inputs:
                        out[asked.first_varied + w] += d.by_leaf[pair] * asked.weights[n, w]
    for k in range(slow):
        # Modulator states are the last states.
        out = following[inputs - m - slow + k]
        _combine(out, 0.0, 1.0, d.by_modulator[k], known, inputs, (0, inputs - 1), n, asked)


@loop_entry
def sensitivity_steps(
    t: Any, p: Any, d: Any, run: Any, asked: Asked, known: Any, following: Any, matrix: Any, out: Any
) -> None:
    """The forward sweep of `sensitivities`.

    Args:
        known: (N+m, C) derivatives of the states at its start, and of the unknowns, which are filled in.
        following: (N+m, C) its states are filled, then both change places; matrix: (m, m) work array.
        out: (M, C) filled.
    """
    for c in range(out.shape[1]):
        out[0, c] = known[asked.output, c]
    node = 1
    for n in range(run.h.shape[0]):
        derivatives_at(t, p, d, n, run, n == 0 or run.h[n] != run.h[n - 1])
        _solve_unknowns(d, n, asked, known, matrix)
        _propagate(t, p, d, n, asked, known, following)
        known, following = following, known
        if node < asked.nodes.shape[0] and asked.nodes[node] == n + 1:
            for c in range(out.shape[1]):
                out[node, c] = known[asked.output, c]
            node += 1


def carrier(program: Program, port: int) -> int:
    """Return an unused entry of theta in the padded row of a port's law.

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

    def first(self, steps: int) -> Integrated:
        """Return the same in the first steps."""
        return Integrated(
            self.program, self.theta, self.states[: steps + 1], self.efforts[:steps], self.u[:steps], self.h[:steps]
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
        """Return the number of perturbations."""
        return self.active.size + self.forces.shape[1] + self.varied.size

    def first(self, steps: int) -> Perturbed:
        """Return the same in the first steps."""
        pushed = {k: action[:steps] for k, action in self.pushed.items()}
        return Perturbed(self.active, self.forces[:steps], self.varied, self.weights[:steps], pushed)


def by_parameters(active: NDArray[np.int64], steps: int) -> Perturbed:
    """Perturb only the parameters at some entries of theta."""
    none = np.zeros((steps, 0))
    return Perturbed(active, none, np.zeros(0, dtype=np.int64), none, {})


def sensitivities(
    march: Integrated,
    perturbed: Perturbed,
    start: Array,
    initial: NDArray[np.int64],
    nodes: NDArray[np.int64],
    end: Array | None = None,
) -> Array:
    """Return the forward sweep of the linearised recursion with many right-hand sides.

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
    (program, theta, states, efforts, u, h), active, varied = march, perturbed.active, perturbed.varied
    pattern = pattern_of(program.sparsity, tuple(active.tolist()))
    by_port = action_derivatives(program, theta, u, active[pattern.in_ports >= 0])
    for k, action in perturbed.pushed.items():
        by_port[pattern.in_ports[k]] = action
    run = Run(states, efforts, h, actions(program, theta, u), by_port)
    memory = new_derivatives(program.table, pattern, theta, run)
    m, first_force = len(program.junctions), active.size + initial.size
    if perturbed.forces.shape[1] and not m:
        raise StructureViolated("no force acts in a network without a storage that others drive: ask for no forces")
    first_varied = first_force + perturbed.forces.shape[1]
    out = np.empty((nodes.size, first_varied + varied.size))
    known = np.zeros((states.shape[1] + m, out.shape[1]))
    known[: states.shape[1], : start.shape[1]] = start
    known[initial, active.size + np.arange(initial.size)] = 1.0
    junction, following = program.junctions.index(program.states[program.flow]) if m else 0, np.zeros_like(known)
    asked = Asked(
        perturbed.forces, junction, first_force, varied, perturbed.weights, first_varied, nodes, program.output
    )
    sensitivity_steps(program.table, pattern, memory, run, asked, known, following, np.zeros((m, m)), out)
    if end is not None:
        # The sweep swaps the two arrays after every step.
        end[:] = (following if h.size % 2 else known)[: states.shape[1]]
    return out


# Periods integrated before the first Newton step, so that every hysteron has gone round its loop.
_RUN_IN = 2
_ITERATIONS = 40
# Largest change within a period relative to the range of each state: the target; the limit for rounding errors; the
# limit where a hysteron that just begins to slide makes every Newton step small.
_STEADY, _NEARLY, _TOLERABLE = 1e-12, 1e-9, 1e-5
# A search within the last limit ends after so many iterations that leave more than this share of the smallest change.
_PATIENCE, _SLOW = 2, 0.9
# Singular values of the scaled ``I − M`` below this count as zero. A range below this share of a state is rounding.
_NEUTRAL = 1e-9
# The share of a change that a Newton step may leave, and the shares of the step that are tried. If none of them
# suffices, one more period is integrated.
_PROGRESS, _DAMPED = 0.5, (1.0, 0.25)


def steady_cycle(program: Program, theta: Array, x: Array, u: Array, h: Array) -> Array:
    """Return (N,) the state in which a period begins and ends; arguments and errors as of `closed_cycle`.

    Args:
        u: (n, P) mean inputs and h: (n,) steps [s] of one period.
    """
    states, efforts = np.empty((h.size + 1, x.size)), np.empty((h.size, x.size))

    def period(start: Array) -> Array:
        done = kernel.march(program, theta, start, u, h, states, efforts)
        if done < h.size:
            raise SolverFailed(f"no solution of the step at t = {h[:done].sum():.6g} s of a period")
        return states

    def monodromy(states: Array) -> Array:
        end, first = np.empty((x.size, x.size)), np.zeros(1, dtype=np.int64)
        march, by = Integrated(program, theta, states, efforts, u, h), by_parameters(first[:0], h.size)
        sensitivities(march, by, np.zeros((x.size, 0)), np.arange(x.size), first, end)
        return without_impulse(program, end, 0)

    # The impulse of a mean force grows without bound, but nothing depends on it.
    return closed_cycle(period, monodromy, x, program.states, program.output if program.travel >= 0 else None)


def closed_cycle(
    period: Callable[[Array], Array],
    monodromy: Callable[[Array], Array],
    x: Array,
    names: Sequence[str],
    free: int | None = None,
) -> Array:
    """Return (N,) the state in which a period begins and ends, by Newton's method.

    Args:
        period: (n+1, N) states of a period from its initial state.
        monodromy: (N, N) ``M`` from the states of the latest period.
        x: (N,) initial guess; names: of the states.
        free: number of a state that need not return.

    Raises:
        SolverFailed: no root of a step was found, or there is no steady cycle; names the states that drift.
    """

    def integrated(start: Array) -> tuple[Array, Array, Array]:
        """Return the states of a period, and the change and the range of each."""
        states = period(start)
        change = states[-1] - start
        if free is not None:
            change[free] = 0.0
        return states, change, reach_of(states)

    for _ in range(_RUN_IN):
        x = x + integrated(x)[1]
    states, change, reach = integrated(x)
    before, best, waited = np.inf, (np.inf, x), 0
    for _ in range(_ITERATIONS):
        size = float(np.abs(change / reach).max())
        if size <= _STEADY or _NEARLY >= size >= _PROGRESS * before:
            return x
        waited = 0 if size < _SLOW * best[0] else waited + 1
        best = min(best, (size, x), key=lambda b: b[0])
        if waited >= _PATIENCE and best[0] <= _TOLERABLE:
            return best[1]
        step = steady_change(monodromy(states), change[:, None], reach)[:, 0]
        following, before = x + change, size
        for target in (*(x + share * step for share in _DAMPED), following):
            states, change, reach = integrated(target)
            # The Newton step may leave the region where the linearised period map is accurate.
            if np.abs(change / reach).max() <= _PROGRESS * size:
                break
        x = target
    shares = np.abs(change / reach)
    best = min(best, (float(shares.max()), x), key=lambda b: b[0])
    if best[0] <= _TOLERABLE:
        return best[1]
    raise SolverFailed(
        f"no steady cycle: {names[int(shares.argmax())]} still changes by {shares.max():.2g} of its range in a "
        f"period; set `start: unknown`, or correct the cause of the drift"
    )


def reach_of(states: Array) -> Array:
    """Return (N,) range of each state within a period; one for a state that does not move."""
    # State by state in memory: across rows of a few numbers the reduction takes sixteen times as long.
    by_state = np.ascontiguousarray(states.T)
    least, most = by_state.min(axis=1), by_state.max(axis=1)
    reach = np.maximum(most - least, _NEUTRAL * np.maximum(most, -least))
    return np.where(reach > 0.0, reach, 1.0)


def cycle_derivative(end: Array, first: int, states: Array) -> Array:
    """(N, C) derivatives of the state in which a steady cycle begins, by quantities that change alike in every period.

    Args:
        end: (N, C + N) derivatives of the state at the end of one period whose initial state is fixed, followed from
            column ``first`` by N columns of derivatives by the initial state.
        states: (n+1, N) of the period.
    """
    inside = np.arange(first, first + states.shape[1])
    return steady_change(end[:, inside], np.delete(end, inside, axis=1), reach_of(states))


def steady_change(monodromy: Array, change: Array, reach: Array) -> Array:
    """Return (N, C) ``(I − M)⁻¹ δ`` of changes (N, C) within a period; zero along neutral directions."""
    matrix = np.eye(reach.size) - monodromy * reach / reach[:, None]
    return np.asarray(reach[:, None] * np.linalg.lstsq(matrix, change / reach[:, None], rcond=_NEUTRAL)[0])


def without_impulse(program: Program, end: Array, first: int) -> Array:
    """Return the derivatives (N, C) of the state at the end of a period, with zero derivatives of the impulse of an
    imposed motion.

    Args:
        first: first of the columns by the initial states of the period.
    """
    if program.travel >= 0:
        end[program.output] = 0.0
        end[program.output, first + program.output] = 1.0
    return end
