"""Derivatives of one step: affine parts from coefficients that hold for many steps, the rest by complex steps.

Complex steps go through the functions of the integration itself.

A step maps inputs — states, unknowns, parameters — to the end states of reducible storages and modulator states, the
changes of junction states and the balance ``F``. Every reducible storage is a block, and so is every term of the
junctions that is not linear. `phnn.integrate.program` lists the inputs of each block, so that a block is perturbed by
these alone.

While a reducible storage rests in its dead zone, or slides beyond one threshold ``τ``, its end state and mean effort
are affine,

    x⁺ = A₀ x + A₁ i + A₂ τ,     ē = B₀ x + B₁ i + B₂ τ.

The coefficients and their derivatives by every parameter hold for all steps of one size, and so do the linear terms of
the junctions with constant factors. A step is differentiated in full if the storage meets a threshold, has a nonlinear
law, or has a resistor that follows a state. Modulator states come at the end.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.cache import inline, plain, stay_outside
from phnn.integrate.partition import LOSSLESS
from phnn.integrate.step import (
    FORCE,
    HIGH,
    LEAK,
    LEAK_ONE,
    LEAK_TWO,
    LOW,
    MATRIX,
    ONE,
    RHO,
    STIFFNESS,
    TWO,
    Step,
    count,
    fill_constants,
    fill_gains,
    inertia,
    is_closed,
    is_linear,
    junction_flows,
    junction_storage,
    junction_term,
    leaf_closed,
    leaf_moved,
    leaf_search,
    memory_decay,
    memory_rate,
    modulate,
    shape_of_constants,
    source,
)
from phnn.integrate.table import (
    FACTORS,
    FIRST_INLET,
    FIRST_LINK,
    FIRST_SOURCE,
    FROM_PORT,
    INTO_JUNCTION,
    JUNCTION_INLETS,
    JUNCTIONS,
    LAST_INLET,
    LAST_LINK,
    LAST_SOURCE,
    LEAVES,
    MODULATOR_STATES,
    OWN_STORAGE,
    RULE,
    SOURCE_EFFORT,
    SOURCE_LEAF,
    SOURCES,
    STORAGES,
    TO_JUNCTION,
    Integers,
    Pattern,
    Run,
    rows_of,
)
from phnn.laws.leaf import relaxed, slides_on
from phnn.laws.namespace import TINY
from phnn.laws.other import advanced

Array = NDArray[np.float64]

# Of state, current and threshold, for the end state and for the mean effort.
COEFFICIENTS = 6
# The affine piece on which a reducible storage spends a step; CROSSING if it meets a threshold.
RESTING, ABOVE, BELOW, CROSSING = range(4)
_PIECES = 3
# How a reducible storage is differentiated: always in full; by pieces where it meets no threshold; by one piece without
# thresholds.
WHOLE, PIECEWISE, ONE_PIECE = range(3)
# Columns of ``kinds`` and of ``values``.
STORAGE, KIND, ONLY_LINK, SHIFTS = range(4)
STIFF, LEAKS, LOWER, UPPER, TIMES = range(5)


class Derivatives(NamedTuple):
    """Work arrays for the derivatives of one step by I inputs, K of them parameters.

    Attributes:
        theta, x, y, ends, means: as of `phnn.integrate.step`, complex; wj: (4, m).
        a: (1+S, P) actions, first unperturbed, then perturbed by each parameter of a port law.
        c: (K+1, L+m, …) constants, perturbed by one parameter each; the last ones are unperturbed.
        g: (G, rows) ratios, first unperturbed, then perturbed by each input that changes one.
        found: (L, 4) solutions of the storages without a closed form.
        whole: (K+1, L, 3, 6) derivatives of the coefficients of every piece by each parameter; last, their values.
        affine: (pairs, 3, 8) derivatives of end state and mean effort for each pair, as coefficients of the state, of
            the flow through the only link (or of the current if there are others), of the threshold and of 1.
        kinds: (L, 4) of a reducible storage: its number, how it is differentiated, the junction of its only link (−1
            with other links, with inlets or a modulated ratio), whether an input shifts its current; values: (L, 5) its
            stiffness, leak and thresholds, and the ratio of that link.
        by_ratio: (pairs,) the derivatives of that ratio.
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
    ends: Any
    means: Any
    wj: Any
    a: Any
    c: Any
    g: Any
    found: Any
    whole: Any
    affine: Any
    kinds: Any
    values: Any
    by_ratio: Any
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
        np.zeros(states, np.complex128),
        np.zeros(states, np.complex128),
        np.zeros((4, m), np.complex128),
        np.zeros((1 + run.by_port.shape[0], run.actions.shape[1]), np.complex128),
        np.zeros((with_none, *shape_of_constants(leaves, m)), np.complex128),
        np.zeros((p.slots.size, t.shape[0]), np.complex128),
        np.zeros((leaves, 4)),
        np.zeros((with_none, leaves, _PIECES, COEFFICIENTS)),
        np.zeros((pairs, _PIECES, COEFFICIENTS + 2)),
        np.zeros((leaves, 4), np.int64),
        np.zeros((leaves, 5)),
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
    """Number of the parameter that input ``i`` is; negative if it is a state or an unknown."""
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
    """The rows of constants, ratios and actions that belong to the perturbation of input ``i``."""
    k = parameter(d, i)
    return (k, p.slot[i], 1 + p.in_ports[k]) if k >= 0 else (p.active.shape[0], p.slot[i], 0)


@inline
def step_of(d: Any, which: Any, slot: Any, act: Any, h: Any) -> Step:
    """The step with the constants, ratios and actions in some rows, see `places_of`."""
    return Step(d.theta, d.c[which], d.g[slot], d.a[act], d.x, d.y, h, d.wj, d.ends, d.means)


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
        i = p.slots[s]
        which, act = p.active.shape[0], 0
        if i >= 0:
            which, _, act = places_of(p, d, i)
            perturb(p, d, i, TINY)
        junction_flows(t, d.theta, d.x, d.y, d.wj)
        modulate(t, step_of(d, which, s, act, h))
        if i >= 0:
            perturb(p, d, i, 0.0)


@inline
def terms_in_full(t: Any, p: Any, d: Any, h: Any) -> None:
    """Add the derivatives of the junctions' terms that are not linear."""
    for term in range(p.terms.shape[0]):
        for place in range(p.term_first[term], p.term_first[term + 1]):
            i = p.term_input[place]
            which, slot, act = places_of(p, d, i)
            perturb(p, d, i, TINY)
            junction_flows(t, d.theta, d.x, d.y, d.wj)
            for j in range(d.y.shape[0]):
                d.wj[FORCE, j] = 0.0
            junction_term(t, p.terms[term], step_of(d, which, slot, act, h))
            for j in range(d.y.shape[0]):
                d.by_force[j, i] += d.wj[FORCE, j].imag / TINY
            perturb(p, d, i, 0.0)


@inline
def leaf_in_full(t: Any, p: Any, d: Any, leaf: Any, h: Any) -> None:
    """Fill the derivatives of a reducible storage."""
    none, row = p.active.shape[0], t[0, LEAVES] + leaf
    closed = is_closed(t, row)
    found = (0.0, 0.0, 0.0, 0.0)
    if not closed:
        # Solved once, for all derivatives of the step.
        junction_flows(t, d.theta, d.x, d.y, d.wj)
        found = leaf_search(t, leaf, step_of(d, none, 0, 0, h))
    for pair in range(p.first[leaf], p.first[leaf + 1]):
        i = p.input[pair]
        which, slot, act = places_of(p, d, i)
        perturb(p, d, i, TINY)
        junction_flows(t, d.theta, d.x, d.y, d.wj)
        step = step_of(d, which, slot, act, h)
        if closed:
            end, mean = leaf_closed(t, leaf, row, step)
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
    """The affine piece on which a reducible storage spends a step, by the rules of `phnn.laws.leaf.rc_flow`.

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
    """Derivative of the current into the reducible storage in a row by an input."""
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
            shift = _shift(t, p, d, t[0, LEAVES] + leaf, p.input[pair])
            d.by_leaf[pair] += end * shift
            d.by_mean[pair] += mean * shift


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
    """The current of a reducible storage whose ratios are not modulated."""
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


#     z⁺ = advanced(z, s̄; θ),     δz⁺ = ∂z⁺/∂z δz + ∂z⁺/∂θ δθ + ∂z⁺/∂s̄ Σ δ(sources)
#
# Each factor comes from complex steps through the functions of the integration itself. What a reducible storage gives
# follows from the derivatives of its end state and mean effort, which are computed before.
@inline
def _drive(t: Any, p: Any, d: Any, s: Any, n: Any, run: Any) -> None:
    """Add the derivatives of what the source in row ``s`` contributes to a drive."""
    own, leaf, k = s - t[0, SOURCES], t[s, SOURCE_LEAF], t[s, SOURCE_EFFORT]
    for other in range(count(t, LEAVES) if k >= 0 else 0):
        if t[t[0, LEAVES] + other, OWN_STORAGE] == k:
            leaf = other
    first, last = p.source_first[own], p.source_first[own + 1]
    if leaf >= 0:
        first, last, k = p.first[leaf], p.first[leaf + 1], t[t[0, LEAVES] + leaf, OWN_STORAGE]
    for place in range(first, last):
        i = p.input[place] if leaf >= 0 else p.source_input[place]
        which, slot, act = places_of(p, d, i)
        perturb(p, d, i, TINY)
        junction_flows(t, d.theta, d.x, d.y, d.wj)
        if leaf >= 0:
            d.ends[k] = complex(run.states[n + 1, k], TINY * d.by_leaf[place])
            d.means[k] = complex(run.efforts[n, k], TINY * d.by_mean[place])
        d.by_drive[i] += source(t, s, step_of(d, which, slot, act, run.h[n])).imag / TINY
        perturb(p, d, i, 0.0)


@plain
def _end(t: Any, row: Any, z: Any, drive: Any, h: Any, theta: Any) -> Any:
    """End state of the modulator state in a row."""
    stay_outside()
    return advanced(z, h, memory_rate(t, row, z, drive, theta), memory_decay(t, row, theta))


@inline
def memories_by(t: Any, p: Any, d: Any, k: Any, n: Any, run: Any) -> None:
    """Fill the derivatives of modulator state ``k`` from those of the reducible storages."""
    row, state, out, h = t[0, MODULATOR_STATES] + k, count(t, STORAGES) + k, d.by_modulator[k], run.h[n]
    for i in range(out.shape[0]):
        d.by_drive[i] = 0.0
    for s in range(t[row, FIRST_SOURCE], t[row, LAST_SOURCE]):
        _drive(t, p, d, s, n, run)
    drive = complex(run.efforts[n, state], TINY)
    by = _end(t, row, d.x[state], drive, h, d.theta).imag / TINY
    drive = complex(run.efforts[n, state], 0.0)
    for i in range(out.shape[0]):
        out[i] = by * d.by_drive[i]
    for place in range(p.memory_first[k], p.memory_first[k + 1]):
        i = p.memory_input[place]
        perturb(p, d, i, TINY)
        out[i] += _end(t, row, d.x[state], drive, h, d.theta).imag / TINY
        perturb(p, d, i, 0.0)


@inline
def _term(piece: Any, h: Any, c: Any, term: Any) -> Any:
    """One coefficient of a piece as complex numbers: end state and mean effort for a unit state, current or
    threshold."""
    none, unit = 0.0 * c[STIFFNESS], 1.0 + 0.0 * c[STIFFNESS]
    x, current, threshold = unit if term == 0 else none, unit if term == 1 else none, unit if term == 2 else none
    if piece == RESTING:
        gain = (current - c[LEAK] * (x * c[STIFFNESS])) * h
        return relaxed(x, gain, c[STIFFNESS], c[LEAK_ONE], c[LEAK_TWO])
    effort = x * c[STIFFNESS]
    gain = (current - c[LEAK] * effort - c[RHO] * (effort - threshold)) * h
    return relaxed(x, gain, c[STIFFNESS], c[ONE], c[TWO])


@inline
def part(z: Any, perturbed: Any) -> Any:
    """The derivative along a perturbation; the value if nothing is perturbed."""
    return z.imag / TINY if perturbed else z.real


@plain
def prepare_leaf(d: Any, k: Any, perturbed: Any, leaf: Any, h: Any) -> None:
    """Fill the coefficients of a reducible storage's pieces with parameter ``k`` perturbed."""
    stay_outside()
    for piece in range(3):
        for term in range(3):
            end, mean = _term(piece, h, d.c[k, leaf], term)
            d.whole[k, leaf, piece, term] = part(end, perturbed)
            d.whole[k, leaf, piece, 3 + term] = part(mean, perturbed)


@plain
def prepare_pairs(t: Any, p: Any, d: Any, leaf: Any) -> None:
    """Fill the constant parts of the derivatives of a storage's pairs; `prepare_values` must come first."""
    stay_outside()
    row, none, n = t[0, LEAVES] + leaf, p.active.shape[0], d.x.shape[0]
    only = d.kinds[leaf, ONLY_LINK] >= 0
    times = d.values[leaf, TIMES] if only else 1.0
    for pair in range(p.first[leaf], p.first[leaf + 1]):
        i = p.input[pair]
        k = parameter(d, i)
        # Derivative of the current by the unknown.
        by_current, d.by_ratio[pair] = 0.0, 0.0
        for r in range(t[row, FIRST_LINK], t[row, LAST_LINK]):
            by_current += d.g[0, r].real if i == n + t[r, TO_JUNCTION] and not p.varies[leaf] else 0.0
        if only and p.shifts[pair]:
            d.by_ratio[pair] = d.g[p.slot[i], t[row, FIRST_LINK]].imag / TINY
        for piece in range(3):
            by, of = d.affine[pair, piece], d.whole[none, leaf, piece]
            threshold = 0.0
            if k >= 0 and piece != RESTING:
                threshold = d.c[k, leaf, HIGH if piece == ABOVE else LOW].imag / TINY
            for out in range(2):
                for term in range(3):
                    by[4 * out + term] = d.whole[k, leaf, piece, 3 * out + term] if k >= 0 else 0.0
                by[4 * out + 1] = by[4 * out + 1] * times + of[3 * out + 1] * d.by_ratio[pair]
                own = of[3 * out] if i == t[row, OWN_STORAGE] else 0.0
                by[4 * out + 3] = own + of[3 * out + 1] * by_current + of[3 * out + 2] * threshold


@plain
def prepare_values(t: Any, p: Any, d: Any, leaf: Any) -> None:
    """Fill the kinds and values of a reducible storage."""
    stay_outside()
    row, c, kind, own = t[0, LEAVES] + leaf, d.c[p.active.shape[0], leaf], d.kinds[leaf], d.values[leaf]
    kind[STORAGE], kind[ONLY_LINK], kind[SHIFTS] = t[row, OWN_STORAGE], -1, 0
    for pair in range(p.first[leaf], p.first[leaf + 1]):
        if p.shifts[pair]:
            kind[SHIFTS] = 1
    if t[row, LAST_LINK] - t[row, FIRST_LINK] == 1 and t[row, LAST_INLET] == t[row, FIRST_INLET] and not p.varies[leaf]:
        # The coefficients already contain the derivatives of the ratio by parameters.
        kind[ONLY_LINK], kind[SHIFTS] = t[t[row, FIRST_LINK], TO_JUNCTION], 0
        own[TIMES] = d.g[0, t[row, FIRST_LINK]].real
    kind[KIND] = WHOLE
    if p.affine[leaf]:
        kind[KIND] = ONE_PIECE if t[row, RULE] == LOSSLESS else PIECEWISE
    own[STIFF], own[LEAKS], own[LOWER], own[UPPER] = c[STIFFNESS].real, c[LEAK].real, c[LOW].real, c[HIGH].real


@inline
def _prepare_junctions(t: Any, p: Any, d: Any, k: Any, h: Any) -> None:
    """Fill the linear terms of the junctions with parameter ``k`` perturbed, as functions of the flows."""
    n, m, c, own = d.x.shape[0], d.y.shape[0], d.c[k], count(t, LEAVES)
    perturbed = k < p.active.shape[0]
    for b in range(m):
        moved = inertia(t, b, c)
        # By a parameter the terms are multiples of the flow; by the flow itself they are constants.
        i, row = (n + m + k, b) if perturbed else (n + b, m)
        if perturbed:
            d.change[b, i] = moved.imag / TINY
        else:
            start = junction_storage(t, b)
            d.by_change[b, i] = moved.real
            d.by_change[b, start] = -2.0 if is_linear(t, b) else -1.0
            d.junction[b, m, start] = d.by_change[b, start] / h
        for j in range(m):
            d.junction[j, row, i] = part(c[own + j, MATRIX + b], perturbed)
        d.junction[b, row, i] += part(moved, perturbed) / h


@plain
def _prepare(t: Any, p: Any, d: Any, h: Any) -> None:
    """Prepare the quantities that are the same in all steps of size ``h``."""
    stay_outside()
    known, none = d.x.shape[0] + d.y.shape[0], p.active.shape[0]
    for s in range(p.slots.shape[0]):
        if p.slots[s] >= known:
            perturb(p, d, p.slots[s], TINY)
        fill_gains(t, d.theta, d.g[s])
        if p.slots[s] >= known:
            perturb(p, d, p.slots[s], 0.0)
    for k in range(none + 1):
        if k < none:
            perturb(p, d, known + k, TINY)
        fill_constants(t, d.theta, d.g[p.slot[known + k] if k < none else 0], h, d.c[k])
        _prepare_junctions(t, p, d, k, h)
        if k < none:
            perturb(p, d, known + k, 0.0)
        for leaf in range(count(t, LEAVES)):
            if p.affine[leaf]:
                prepare_leaf(d, k, k < none, leaf, h)
    for leaf in range(count(t, LEAVES)):
        prepare_values(t, p, d, leaf)
        if p.affine[leaf]:
            prepare_pairs(t, p, d, leaf)


@inline
def _linear_terms(t: Any, p: Any, d: Any) -> None:
    """Fill the derivatives of the junctions' linear terms."""
    m, known = d.y.shape[0], d.x.shape[0] + d.y.shape[0]
    for j in range(m):
        force, moved = d.by_force[j], d.by_change[j]
        one, of, own = d.junction[j, m], d.change[j], d.flows[j]
        for i in range(force.shape[0]):
            force[i] = one[i]
        for i in range(known, force.shape[0]):
            moved[i] = of[i] * own
        for b in range(m):
            by, v = d.junction[j, b], d.flows[b]
            for i in range(known, force.shape[0]):
                force[i] += by[i] * v
    for place in range(p.plain.shape[0]):
        r = p.plain[place]
        if r >= t[0, JUNCTION_INLETS]:
            force = d.by_force[t[r, INTO_JUNCTION]]
            for s in range(1, p.slots.shape[0]):
                force[p.slots[s]] -= d.g[s, r].imag / TINY * d.a[0, t[r, FROM_PORT]].real
            for k in range(p.active.shape[0] if d.a.shape[0] > 1 else 0):
                if p.in_ports[k] >= 0:
                    force[known + k] -= d.g[0, r].real * (d.a[1 + p.in_ports[k], t[r, FROM_PORT]].imag / TINY)


@inline
def derivatives_at(t: Any, p: Any, d: Any, n: Any, run: Any, fresh: Any) -> None:
    """Fill the derivatives of step ``n``; ``fresh`` if its size differs from that of the last call."""
    h = run.h[n]
    if fresh:
        _prepare(t, p, d, h)
    for j in range(d.y.shape[0]):
        d.flows[j] = run.efforts[n, junction_storage(t, j)]
    load_actions(d, n, run)
    _linear_terms(t, p, d)
    leaves = count(t, LEAVES)
    left = p.terms.shape[0] > 0
    for leaf in range(leaves):
        left = left or d.kinds[leaf, KIND] == WHOLE
    loaded = left or count(t, FACTORS) > 0 or count(t, MODULATOR_STATES) > 0
    if loaded:
        load(t, d, n, run)
    if count(t, FACTORS) > 0:
        scale(t, p, d, h)
    for leaf in range(leaves):
        k, done = d.kinds[leaf, STORAGE], False
        if d.kinds[leaf, KIND] != WHOLE:
            done = plain_leaf(t, p, d, leaf, run.states[n, k], run.efforts[n, k])
        d.todo[leaf] = not done
        left = left or not done
    if left and not loaded:
        load(t, d, n, run)
    if left:
        in_full(t, p, d, n, run)
    for k in range(count(t, MODULATOR_STATES)):
        memories_by(t, p, d, k, n, run)
