"""Blocks of a step, differentiated by complex steps through the functions of the integration itself.

A step maps inputs — states, unknowns, parameters — to the end states of reducible storages and modulator states, the
changes of junction states and the balance ``F``. Every reducible storage is a block, and so is every term of the
junctions that is not linear. `phnn.integrate.program` lists the inputs of each block, so that a block is perturbed by
these alone.

While a reducible storage rests in its dead zone, or slides beyond one threshold ``τ``, its end state and mean effort
are affine,

    x⁺ = A₀ x + A₁ i + A₂ τ,     ē = B₀ x + B₁ i + B₂ τ.

The coefficients and their derivatives by every parameter hold for all steps of one size. If ``τ`` is modulated, they
also depend on the slope of the resistor. A step is differentiated in full if the storage meets a threshold, has a
nonlinear law, or has a resistor whose slope changes.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.cache import inline
from phnn.integrate.program import (
    FACTORS,
    FIRST_INLET,
    FIRST_LINK,
    FROM_PORT,
    JUNCTIONS,
    LAST_INLET,
    LAST_LINK,
    LEAVES,
    MODULATOR_STATES,
    PLACE_1,
    PLACE_5,
    PORTS,
    RATIO,
    RATIO_PLACE,
    READ,
    SIGN,
    TO_JUNCTION,
    Integers,
    Program,
    rows_of,
)
from phnn.integrate.step import (
    CONSTANTS,
    FORCE,
    Step,
    count,
    factor,
    is_closed,
    is_linear,
    junction_flows,
    junction_storage,
    junction_term,
    leaf_closed,
    leaf_moved,
    leaf_search,
    mean_effort,
    read,
)
from phnn.laws.leaf import slides_on
from phnn.laws.namespace import TINY

Array = NDArray[np.float64]


class Run(NamedTuple):
    """An integrated program, and how its ports' actions follow the parameters in their laws.

    Attributes:
        states: (n+1, N); efforts: (n, N); h: (n,) sizes of the steps [s].
        actions: (n, P); by_port: (S, n, P) their derivatives.
    """

    states: Array
    efforts: Array
    h: Array
    actions: Array
    by_port: Array


class Pattern(NamedTuple):
    """The nonzero derivatives of a step by states, unknowns and some parameters; inputs are numbered in that order.

    A reducible storage and an input that its equations contain are a *pair*. Pairs are listed storage by storage,
    inputs increasing. Every other list is cut in the same way: entries ``first[k]`` to ``first[k+1]`` belong to element
    ``k``.

    Attributes:
        active: (K,) indices into theta.
        in_ports: (K,) number of a parameter among those in port laws, −1 for the others.
        first, input: of the pairs.
        shifts: (pairs,) whether an input changes the storage's current, except for unknowns of junctions at a constant
            ratio; follows: (pairs,) whether it changes the modulated thresholds of the storage.
        affine, varies: (L,) see `phnn.integrate.program`; reads: (L,) whether thresholds are modulated.
        plain: (R,) rows of the junctions' linear terms; terms: (T,) rows of the others, and their inputs.
        slots: (G,) inputs that change a ratio, the first −1 for none; slot: (I,) the place of an input among them.
        scaled: rows with a modulated ratio.
        memory, source: inputs of the law of every modulator state and of every source.
    """

    active: Integers
    in_ports: Integers
    first: Integers
    input: Integers
    shifts: NDArray[np.bool_]
    follows: NDArray[np.bool_]
    affine: NDArray[np.bool_]
    varies: NDArray[np.bool_]
    reads: NDArray[np.bool_]
    plain: Integers
    terms: Integers
    term_first: Integers
    term_input: Integers
    slots: Integers
    slot: Integers
    scaled: Integers
    memory_first: Integers
    memory_input: Integers
    source_first: Integers
    source_input: Integers


@lru_cache(maxsize=256)
def pattern_of(program: Program, active: tuple[int, ...]) -> Pattern:
    """Return the pattern of a program for the parameters at some entries of theta."""
    table, sparsity, known = program.table, program.sparsity, len(program.states) + len(program.junctions)
    inputs = [*range(known), *(known + place for place in active)]
    in_ports = np.isin(active, rows_of(table, PORTS)[:, PLACE_1 : PLACE_5 + 1])
    first, given = _listed(sparsity.leaves, inputs)
    leaf = np.repeat(np.arange(len(sparsity.leaves)), np.diff(first))
    names = np.array(inputs, dtype=np.int64)[given]
    by_current = [
        (name >= known or sparsity.varies[k]) and name in sparsity.currents[k]
        for k, name in zip(leaf, names, strict=True)
    ]
    by_threshold = [name in sparsity.thresholds[k] for k, name in zip(leaf, names, strict=True)]
    ratios = {known + int(place) for place in table[1:, RATIO] if place >= 0}
    slots = [i for i, name in enumerate(inputs) if name in ratios or name in sparsity.gains]
    slot = np.zeros(len(inputs), dtype=np.int64)
    slot[slots] = 1 + np.arange(len(slots))
    return Pattern(
        np.asarray(active, dtype=np.int64),
        np.where(in_ports, np.cumsum(in_ports) - 1, -1),
        first,
        given,
        np.array(by_current, dtype=np.bool_),
        np.array(by_threshold, dtype=np.bool_),
        np.array(sparsity.affine, dtype=np.bool_),
        np.array(sparsity.varies, dtype=np.bool_),
        np.array([bool(found) for found in sparsity.thresholds], dtype=np.bool_),
        np.array(sparsity.plain, dtype=np.int64),
        np.array(list(sparsity.others), dtype=np.int64),
        *_listed(sparsity.others.values(), inputs),
        np.array([-1, *slots], dtype=np.int64),
        slot,
        np.array(sparsity.scaled, dtype=np.int64),
        *_listed(sparsity.modulators, inputs),
        *_listed(sparsity.sources, inputs),
    )


def _listed(sets: Iterable[frozenset[int]], inputs: list[int]) -> tuple[Integers, Integers]:
    """Return the start of every set's list, and all lists one after the other: numbers of the inputs in each set."""
    lists = [[i for i, name in enumerate(inputs) if name in found] for found in sets]
    first = np.cumsum([0, *map(len, lists)])
    return first.astype(np.int64), np.array([i for found in lists for i in found], dtype=np.int64)


# Of state, current and threshold, for the end state and for the mean effort.
COEFFICIENTS = 6
# The affine piece on which a reducible storage spends a step; CROSSING if it meets a threshold.
RESTING, ABOVE, BELOW, CROSSING = range(4)
_PIECES = 3
# How a reducible storage is differentiated: always in full; by pieces where it meets no threshold; by one piece without
# thresholds; as a lossless storage with a nonlinear law; by pieces with modulated thresholds.
WHOLE, PIECEWISE, ONE_PIECE, CURVED, FOLLOWING = range(5)
# Columns of ``kinds`` and of ``values``.
STORAGE, KIND, ONLY_LINK, SHIFTS = range(4)
STIFF, LEAKS, LOWER, UPPER, TIMES = range(5)


class Derivatives(NamedTuple):
    """Work arrays for the derivatives of one step by I inputs, K of them parameters.

    Attributes:
        theta, x, y: as of `phnn.integrate.step`, complex; wj: (4, m).
        a: (1+S, P) actions, first unperturbed, then perturbed by each parameter of a port law.
        c: (K+1, L+m, 9) constants, perturbed by one parameter each; the last ones are unperturbed.
        g: (G, rows) ratios, first unperturbed, then perturbed by each input that changes one.
        found: (L, 4) solutions of the storages without a closed form.
        whole: (K+1, L, 3, 6) derivatives of the coefficients of every piece by each parameter; last, their values.
        affine: (pairs, 3, 8) derivatives of end state and mean effort for each pair, as coefficients of the state, of
            the flow through the only link (or of the current if there are others), of the threshold and of 1.
        slope: (L,) slope of a modulated resistor for which the pieces were prepared, NaN for none; slopes: (pairs,) its
            derivatives; thresholds: (pairs,) derivatives of the threshold in this step.
        kinds: (L, 4) of a reducible storage: its number, how it is differentiated, the junction of its only link (−1
            with other links, with inlets or a modulated ratio), whether an input shifts its current; values: (L, 5) its
            stiffness, leak and thresholds, and the ratio of that link.
        by_ratio: (pairs,) the derivatives of that ratio; by_current: (pairs,) the other derivatives of the current.
        junction: (m, m+1, I) the derivatives of the linear terms of ``F`` as functions of flows and 1; change: (m, I)
            those of ``z − p`` by parameters as multiples of the junction's own flow.
        flows: (m,) mean efforts of the junctions; todo: (L,) reducible storages to be differentiated in full.
        by_leaf, by_mean: (pairs,) of the end states and mean efforts of the reducible storages, as listed by the
            pattern.
        by_force, by_change: (m, I) of ``F`` and of ``z − p``; by_modulator: (M, I) of the modulator states' end states;
            by_drive: (I,) of the drive of one modulator state.
    """

    theta: Any
    x: Any
    y: Any
    wj: Any
    a: Any
    c: Any
    g: Any
    found: Any
    whole: Any
    affine: Any
    slope: Any
    slopes: Any
    thresholds: Any
    kinds: Any
    values: Any
    by_ratio: Any
    by_current: Any
    junction: Any
    change: Any
    flows: Any
    todo: Any
    by_leaf: Any
    by_mean: Any
    by_force: Any
    by_change: Any
    by_modulator: Any
    by_drive: Any


def new_derivatives(t: Integers, p: Pattern, theta: Array, run: Run) -> Derivatives:
    """Allocate the work arrays for a network and a pattern."""
    m, leaves, pairs, inputs = len(rows_of(t, JUNCTIONS)), len(rows_of(t, LEAVES)), p.input.size, p.slot.size
    with_none, states = p.active.size + 1, run.states.shape[1]
    return Derivatives(
        theta.astype(np.complex128),
        np.zeros(states, np.complex128),
        np.zeros(m, np.complex128),
        np.zeros((4, m), np.complex128),
        np.zeros((1 + run.by_port.shape[0], run.actions.shape[1]), np.complex128),
        np.zeros((with_none, leaves + m, CONSTANTS), np.complex128),
        np.zeros((p.slots.size, t.shape[0]), np.complex128),
        np.zeros((leaves, 4)),
        np.zeros((with_none, leaves, _PIECES, COEFFICIENTS)),
        np.zeros((pairs, _PIECES, COEFFICIENTS + 2)),
        np.full(leaves, np.nan),
        np.zeros(pairs),
        np.zeros(pairs),
        np.zeros((leaves, 4), np.int64),
        np.zeros((leaves, 5)),
        np.zeros(pairs),
        np.zeros(pairs),
        np.zeros((m, m + 1, inputs)),
        np.zeros((m, inputs)),
        np.zeros(m),
        np.zeros(leaves, np.bool_),
        np.zeros(pairs),
        np.zeros(pairs),
        np.zeros((m, inputs)),
        np.zeros((m, inputs)),
        np.zeros((len(rows_of(t, MODULATOR_STATES)), inputs)),
        np.zeros(inputs),
    )


@inline
def parameter(d: Any, i: Any) -> Any:
    """Return the number of the parameter that input ``i`` is; negative if it is a state or an unknown."""
    return i - d.x.shape[0] - d.y.shape[0]


@inline
def perturb(p: Any, d: Any, i: Any, by: Any) -> None:
    """Give input ``i`` an imaginary part; 0 removes it again."""
    k = parameter(d, i)
    if k >= 0:
        d.theta[p.active[k]] = complex(d.theta[p.active[k]].real, by)
    elif i < d.x.shape[0]:
        d.x[i] = complex(d.x[i].real, by)
    else:
        d.y[i - d.x.shape[0]] = complex(d.y[i - d.x.shape[0]].real, by)


@inline
def places_of(p: Any, d: Any, i: Any) -> Any:
    """Return the rows of constants, ratios and actions that belong to the perturbation of input ``i``."""
    k = parameter(d, i)
    return (k, p.slot[i], 1 + p.in_ports[k]) if k >= 0 else (p.active.shape[0], p.slot[i], 0)


@inline
def step_of(d: Any, which: Any, slot: Any, act: Any, h: Any) -> Step:
    """Return the step with the constants, ratios and actions in some rows, see `places_of`."""
    return Step(d.theta, d.c[which], d.g[slot], d.a[act], d.x, d.y, h, d.wj)


@inline
def perturbed_step(t: Any, p: Any, d: Any, i: Any, h: Any) -> Step:
    """Return the step with input ``i`` perturbed, with its flows; `perturb` takes the perturbation away again."""
    which, slot, act = places_of(p, d, i)
    perturb(p, d, i, TINY)
    junction_flows(t, d.theta, d.x, d.y, d.wj)
    return step_of(d, which, slot, act, h)


@inline
def load_actions(d: Any, n: Any, run: Any) -> None:
    """Load the actions of a step; only those by parameters of port laws are perturbed."""
    for port in range(d.a.shape[1]):
        d.a[0, port] = complex(run.actions[n, port], 0.0)
        for s in range(run.by_port.shape[0]):
            d.a[1 + s, port] = complex(run.actions[n, port], TINY * run.by_port[s, n, port])


@inline
def load(t: Any, d: Any, n: Any, run: Any) -> None:
    """Load state and unknowns of a step."""
    for k in range(d.x.shape[0]):
        d.x[k] = complex(run.states[n, k], 0.0)
    for j in range(d.y.shape[0]):
        k = junction_storage(t, j)
        d.y[j] = complex(run.efforts[n, k] if is_linear(t, j) else run.states[n + 1, k], 0.0)


@inline
def scale(t: Any, p: Any, d: Any, h: Any) -> None:
    """Set the modulated ratios to their values in this step, see `phnn.integrate.step.modulate`."""
    for s in range(p.slots.shape[0]):
        i, g = p.slots[s], d.g[s]
        which, act = p.active.shape[0], 0
        if i >= 0:
            which, _, act = places_of(p, d, i)
            perturb(p, d, i, TINY)
        junction_flows(t, d.theta, d.x, d.y, d.wj)
        for place in range(p.scaled.shape[0]):
            r = p.scaled[place]
            g[r] = t[r, SIGN] * d.theta[t[r, RATIO]]
        for f in range(t[0, FACTORS], t[0, FACTORS + 1]):
            by = factor(t, f, read(t, t[f, READ], step_of(d, which, s, act, h)), d.theta)
            for place in range(p.scaled.shape[0]):
                r = p.scaled[place]
                if t[r, RATIO] == t[f, RATIO_PLACE]:
                    g[r] *= by
        if i >= 0:
            perturb(p, d, i, 0.0)


@inline
def terms_in_full(t: Any, p: Any, d: Any, h: Any) -> None:
    """Add the derivatives of the junctions' terms that are not linear."""
    for term in range(p.terms.shape[0]):
        for place in range(p.term_first[term], p.term_first[term + 1]):
            i = p.term_input[place]
            step = perturbed_step(t, p, d, i, h)
            for j in range(d.y.shape[0]):
                d.wj[FORCE, j] = 0.0
            junction_term(t, p.terms[term], step)
            for j in range(d.y.shape[0]):
                d.by_force[j, i] += d.wj[FORCE, j].imag / TINY
            perturb(p, d, i, 0.0)


@inline
def leaf_in_full(t: Any, p: Any, d: Any, leaf: Any, h: Any) -> None:
    """Fill the derivatives of a reducible storage."""
    none, row = p.active.shape[0], t[0, LEAVES] + leaf
    closed = is_closed(t, leaf)
    found = (0.0, 0.0, 0.0, 0.0)
    if not closed:
        # Solved once, for all derivatives of the step.
        junction_flows(t, d.theta, d.x, d.y, d.wj)
        found = leaf_search(t, leaf, step_of(d, none, 0, 0, h))
    for pair in range(p.first[leaf], p.first[leaf + 1]):
        i = p.input[pair]
        step = perturbed_step(t, p, d, i, h)
        if closed:
            end, mean = leaf_closed(t, leaf, step)
        else:
            end, mean = leaf_moved(t, leaf, step, found)
        perturb(p, d, i, 0.0)
        d.by_leaf[pair] = end.imag / TINY
        d.by_mean[pair] = mean.imag / TINY
        for r in range(t[row, FIRST_LINK], t[row, LAST_LINK]):
            d.by_force[t[r, TO_JUNCTION], i] += (step.g[r] * mean).imag / TINY


@inline
def in_full(t: Any, p: Any, d: Any, n: Any, run: Any) -> None:
    """Differentiate the blocks of step ``n`` that lie within no affine piece."""
    terms_in_full(t, p, d, run.h[n])
    for leaf in range(count(t, LEAVES)):
        if d.todo[leaf]:
            leaf_in_full(t, p, d, leaf, run.h[n])


@inline
def piece_of(of: Any, own: Any, low: Any, high: Any, x: Any, current: Any) -> Any:
    """Return the affine piece on which a reducible storage spends a step, by the rules of `phnn.laws.leaf.rc_flow`.

    Args:
        of: (3, 6) coefficients of its pieces; own: its values.
    """
    stiffness = own[STIFF]
    effort = stiffness * x
    # Without a dead zone, no state rests in it.
    above = effort > high or (effort == high and low == high)
    if above or effort < low:
        piece, threshold = (ABOVE, high) if above else (BELOW, low)
        end = stiffness * (of[piece, 0] * x + of[piece, 1] * current + of[piece, 2] * threshold)
        return piece if slides_on(effort, end, above, threshold, current, own[LEAKS]) else CROSSING
    end = stiffness * (of[RESTING, 0] * x + of[RESTING, 1] * current)
    return RESTING if low <= end <= high else CROSSING


@inline
def _shift(t: Any, p: Any, d: Any, row: Any, i: Any) -> Any:
    """Return the derivative of the current into the reducible storage in a row by an input."""
    _, slot, act = places_of(p, d, i)
    total = 0.0
    for r in range(t[row, FIRST_LINK], t[row, LAST_LINK]):
        total += d.g[slot, r].imag / TINY * d.flows[t[r, TO_JUNCTION]]
        if i == d.x.shape[0] + t[r, TO_JUNCTION]:
            total += d.g[slot, r].real
    for r in range(t[row, FIRST_INLET], t[row, LAST_INLET]):
        total += (d.g[slot, r] * d.a[act, t[r, FROM_PORT]]).imag / TINY
    return total


@inline
def exert(t: Any, p: Any, d: Any, leaf: Any, exerted: Any) -> None:
    """Add the force of a reducible storage on its junctions; ``exerted`` is its mean effort."""
    row, only = t[0, LEAVES] + leaf, d.kinds[leaf, ONLY_LINK]
    if only >= 0:
        force, ratio = d.by_force[only], d.values[leaf, TIMES]
        for pair in range(p.first[leaf], p.first[leaf + 1]):
            force[p.input[pair]] += ratio * d.by_mean[pair] + d.by_ratio[pair] * exerted
    else:
        for r in range(t[row, FIRST_LINK], t[row, LAST_LINK]):
            for pair in range(p.first[leaf], p.first[leaf + 1]):
                d.by_force[t[r, TO_JUNCTION], p.input[pair]] += d.g[0, r].real * d.by_mean[pair]
    if d.kinds[leaf, SHIFTS] > 0:
        for pair in range(p.first[leaf], p.first[leaf + 1]):
            for r in range(t[row, FIRST_LINK], t[row, LAST_LINK] if p.shifts[pair] else t[row, FIRST_LINK]):
                d.by_force[t[r, TO_JUNCTION], p.input[pair]] += d.g[p.slot[p.input[pair]], r].imag / TINY * exerted


@inline
def _shifted(t: Any, p: Any, d: Any, leaf: Any, end: Any, mean: Any) -> None:
    """Add the effect of inputs on the current; ``end`` and ``mean`` are the derivatives by the current."""
    for pair in range(p.first[leaf], p.first[leaf + 1]):
        if p.shifts[pair]:
            d.by_current[pair] = _shift(t, p, d, t[0, LEAVES] + leaf, p.input[pair])
            d.by_leaf[pair] += end * d.by_current[pair]
            d.by_mean[pair] += mean * d.by_current[pair]


@inline
def fill(t: Any, p: Any, d: Any, leaf: Any, piece: Any, at: Any) -> None:
    """Fill the derivatives of a reducible storage within a piece, without its force on the junctions.

    Args:
        at: state, current and threshold.
    """
    x, current, threshold = at
    of, only = d.whole[p.active.shape[0], leaf, piece], d.kinds[leaf, ONLY_LINK]
    flow = d.flows[only] if only >= 0 else current
    for pair in range(p.first[leaf], p.first[leaf + 1]):
        q = d.affine[pair, piece]
        d.by_leaf[pair] = q[0] * x + q[1] * flow + q[2] * threshold + q[3]
        d.by_mean[pair] = q[4] * x + q[5] * flow + q[6] * threshold + q[7]
    if d.kinds[leaf, SHIFTS] > 0:
        _shifted(t, p, d, leaf, of[1], of[4])


@inline
def current_of(t: Any, d: Any, leaf: Any) -> Any:
    """Return the current of a reducible storage whose ratios are not modulated."""
    row, only = t[0, LEAVES] + leaf, d.kinds[leaf, ONLY_LINK]
    if only >= 0:
        return d.values[leaf, TIMES] * d.flows[only]
    total = 0.0
    for r in range(t[row, FIRST_LINK], t[row, LAST_LINK]):
        total += d.g[0, r].real * d.flows[t[r, TO_JUNCTION]]
    for r in range(t[row, FIRST_INLET], t[row, LAST_INLET]):
        total += d.g[0, r].real * d.a[0, t[r, FROM_PORT]].real
    return total


@inline
def plain_leaf(t: Any, p: Any, d: Any, leaf: Any, x: Any, mean: Any) -> Any:
    """Fill the derivatives of a reducible storage with constant thresholds; returns False if it meets one.

    Args:
        x, mean: its state and its mean effort in this step.
    """
    kind, own = d.kinds[leaf, KIND], d.values[leaf]
    current = current_of(t, d, leaf)
    piece = RESTING
    if kind == PIECEWISE:
        piece = piece_of(d.whole[p.active.shape[0], leaf], own, own[LOWER], own[UPPER], x, current)
        if piece == CROSSING:
            return False
    fill(t, p, d, leaf, piece, (x, current, own[UPPER] if piece == ABOVE else own[LOWER]))
    exert(t, p, d, leaf, mean)
    return True


@inline
def curved_leaf(t: Any, p: Any, d: Any, leaf: Any, x: Any, mean: Any, h: Any) -> None:
    """Fill the derivatives of a lossless storage with a nonlinear law; arguments as of `plain_leaf`."""
    k, current, only = d.kinds[leaf, STORAGE], current_of(t, d, leaf), d.kinds[leaf, ONLY_LINK]
    flow = d.flows[only] if only >= 0 else 0.0
    for pair in range(p.first[leaf], p.first[leaf + 1]):
        i = p.input[pair]
        shift = d.by_current[pair] + d.by_ratio[pair] * flow
        if only < 0 and p.shifts[pair]:
            shift = _shift(t, p, d, t[0, LEAVES] + leaf, i)
        start = complex(x, TINY if i == k else 0.0)
        end = start + h * complex(current, TINY * shift)
        perturbed = parameter(d, i) >= 0
        if perturbed:
            perturb(p, d, i, TINY)
        between = mean_effort(t, k, start, end, d.theta)
        if perturbed:
            perturb(p, d, i, 0.0)
        d.by_leaf[pair] = end.imag / TINY
        d.by_mean[pair] = between.imag / TINY
    exert(t, p, d, leaf, mean)
