"""Derivatives of one step: affine parts from coefficients that hold for many steps, the rest by complex steps.

The linear terms of the junctions, and reducible storages away from their thresholds (`phnn.integrate.perturbed`), take
their derivatives from coefficients, which are prepared whenever the step size changes; all other blocks are
differentiated one by one, and the modulator states at the end.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from phnn.integrate.cache import inline, plain, stay_outside
from phnn.integrate.perturbed import (
    ABOVE,
    CROSSING,
    CURVED,
    FOLLOWING,
    KIND,
    LEAKS,
    LOWER,
    ONE_PIECE,
    ONLY_LINK,
    PIECEWISE,
    RESTING,
    SHIFTS,
    STIFF,
    STORAGE,
    TIMES,
    UPPER,
    WHOLE,
    current_of,
    curved_leaf,
    exert,
    fill,
    in_full,
    load,
    load_actions,
    parameter,
    perturb,
    perturbed_step,
    piece_of,
    places_of,
    plain_leaf,
    scale,
    step_of,
)
from phnn.integrate.program import (
    FIRST_INLET,
    FIRST_LINK,
    FIRST_RESISTOR,
    FIRST_SOURCE,
    FROM_PORT,
    INTO_JUNCTION,
    IS_LINEAR,
    JUNCTION_INLETS,
    LAST_INLET,
    LAST_LINK,
    LAST_SOURCE,
    LEAVES,
    MODULATOR_STATES,
    OWN_STORAGE,
    READ,
    RULE,
    SOURCE_EFFORT,
    SOURCE_FLOW,
    SOURCE_LEAF,
    SOURCE_PORT,
    SOURCE_RESISTOR,
    SOURCES,
    STORAGES,
    TO_JUNCTION,
)
from phnn.integrate.scheme import LOSSLESS
from phnn.integrate.step import (
    FLOW,
    FORCE,
    HIGH,
    LEAK,
    LEAK_ONE,
    LEAK_TWO,
    LOW,
    ONE,
    RHO,
    STIFFNESS,
    TWO,
    Step,
    branch_effort,
    count,
    fill_constants,
    fill_gains,
    is_linear,
    junction_change,
    junction_flows,
    junction_storage,
    junction_term,
    leaf_current,
    mean_effort,
    memory_decay,
    memory_rate,
    read,
    resistor_flow,
    resistor_thresholds,
)
from phnn.laws.leaf import relaxation, relaxed
from phnn.laws.namespace import TINY
from phnn.laws.other import advanced


#     z⁺ = advanced(z, s̄; θ),     δz⁺ = ∂z⁺/∂z δz + ∂z⁺/∂θ δθ + ∂z⁺/∂s̄ Σ δ(sources)
#
# Each factor comes from complex steps through the functions of the integration itself. The derivative of a reducible
# storage's power follows from those of its end state and mean effort, which are computed before.
@inline
def _known_power(p: Any, d: Any, leaf: Any, current: Any, n: Any, run: Any) -> None:
    """`_leaf_power` of a linear reducible storage whose step lies within an affine piece."""
    k, stiffness = d.kinds[leaf, STORAGE], d.values[leaf, STIFF]
    start, end, mean, rate = run.states[n, k], run.states[n + 1, k], run.efforts[n, k], 1.0 / run.h[n]
    between, moved, only = 0.5 * stiffness * (start + end), end - start, d.kinds[leaf, ONLY_LINK]
    flow = d.flows[only] if only >= 0 else 0.0
    for pair in range(p.first[leaf], p.first[leaf + 1]):
        i, by_end = p.input[pair], d.by_leaf[pair]
        by_start = 1.0 if i == k else 0.0
        by_between = 0.5 * stiffness * (by_start + by_end)
        if parameter(d, i) >= 0:
            by_between += 0.5 * d.c[parameter(d, i), leaf, STIFFNESS].imag / TINY * (start + end)
        stored = by_between * moved + between * (by_end - by_start)
        by_current = d.by_current[pair] + d.by_ratio[pair] * flow
        d.by_drive[i] += by_current * mean + current * d.by_mean[pair] - stored * rate


@inline
def _leaf_power(t: Any, p: Any, d: Any, leaf: Any, n: Any, run: Any) -> None:
    """Add the derivatives of ``i ē − ΔH/h``, the power that the resistors of a reducible storage dissipate."""
    row, h = t[0, LEAVES] + leaf, run.h[n]
    k = t[row, OWN_STORAGE]
    for pair in range(p.first[leaf], p.first[leaf + 1]):
        i = p.input[pair]
        step = perturbed_step(t, p, d, i, h)
        current, start = leaf_current(t, leaf, step.g, step.a, step.wj), step.x[k]
        end = complex(run.states[n + 1, k], TINY * d.by_leaf[pair])
        mean = complex(run.efforts[n, k], TINY * d.by_mean[pair])
        if t[row, IS_LINEAR] > 0:
            between = 0.5 * step.c[leaf, STIFFNESS] * (start + end)
        else:
            between = mean_effort(t, k, start, end, d.theta)
        d.by_drive[i] += (current * mean - between * (end - start) / h).imag / TINY
        perturb(p, d, i, 0.0)


@inline
def _junction_power(t: Any, p: Any, d: Any, s: Any, h: Any) -> None:
    """Add the derivatives of the power that the junction resistor of the source in row ``s`` dissipates."""
    r, source = t[s, SOURCE_RESISTOR], s - t[0, SOURCES]
    for place in range(p.source_first[source], p.source_first[source + 1]):
        i = p.source_input[place]
        step = perturbed_step(t, p, d, i, h)
        effort, q = branch_effort(t, r, step.g, step.wj), read(t, t[r, READ], step)
        d.by_drive[i] += (effort * resistor_flow(t, r, effort, q, d.theta)).imag / TINY
        perturb(p, d, i, 0.0)


@inline
def _signal(t: Any, p: Any, d: Any, s: Any) -> None:
    """Add the derivatives of the effort of a reducible storage, the flow of a junction or the action of a port."""
    for leaf in range(count(t, LEAVES) if t[s, SOURCE_EFFORT] >= 0 else 0):
        if t[t[0, LEAVES] + leaf, OWN_STORAGE] == t[s, SOURCE_EFFORT]:
            for pair in range(p.first[leaf], p.first[leaf + 1]):
                d.by_drive[p.input[pair]] += d.by_mean[pair]
    source = s - t[0, SOURCES]
    for place in range(p.source_first[source], p.source_first[source + 1]):
        i = p.source_input[place]
        _, _, act = places_of(p, d, i)
        if t[s, SOURCE_FLOW] >= 0:
            perturb(p, d, i, TINY)
            junction_flows(t, d.theta, d.x, d.y, d.wj)
            d.by_drive[i] += d.wj[FLOW, t[s, SOURCE_FLOW]].imag / TINY
            perturb(p, d, i, 0.0)
        else:
            d.by_drive[i] += d.a[act, t[s, SOURCE_PORT]].imag / TINY


@plain
def _end(t: Any, row: Any, z: Any, drive: Any, h: Any, theta: Any) -> Any:
    """Return the end state of the modulator state in a row."""
    stay_outside()
    return advanced(z, h, memory_rate(t, row, z, drive, theta), memory_decay(t, row, theta))


@inline
def memories_by(t: Any, p: Any, d: Any, k: Any, n: Any, run: Any) -> None:
    """Fill the derivatives of modulator state ``k`` from those of the reducible storages."""
    row, state, out, h = t[0, MODULATOR_STATES] + k, count(t, STORAGES) + k, d.by_modulator[k], run.h[n]
    for i in range(out.shape[0]):
        d.by_drive[i] = 0.0
    for s in range(t[row, FIRST_SOURCE], t[row, LAST_SOURCE]):
        leaf = t[s, SOURCE_LEAF]
        if leaf >= 0 and not d.todo[leaf] and d.kinds[leaf, KIND] != CURVED:
            _known_power(p, d, leaf, current_of(t, d, leaf), n, run)
        elif leaf >= 0:
            _leaf_power(t, p, d, leaf, n, run)
        elif t[s, SOURCE_RESISTOR] >= 0:
            _junction_power(t, p, d, s, h)
        else:
            _signal(t, p, d, s)
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
    """Return one coefficient of a piece as complex numbers: end state and mean effort for a unit state, current or
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
    """Return the derivative along a perturbation; the value if nothing is perturbed."""
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
        d.by_current[pair], d.by_ratio[pair] = 0.0, 0.0
        for r in range(t[row, FIRST_LINK], t[row, LAST_LINK]):
            d.by_current[pair] += d.g[0, r].real if i == n + t[r, TO_JUNCTION] and not p.varies[leaf] else 0.0
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
                by[4 * out + 3] = own + of[3 * out + 1] * d.by_current[pair] + of[3 * out + 2] * threshold


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
    if p.affine[leaf] and t[row, RULE] == LOSSLESS:
        kind[KIND] = ONE_PIECE if t[row, IS_LINEAR] > 0 else CURVED
    elif p.affine[leaf]:
        kind[KIND] = FOLLOWING if p.reads[leaf] else PIECEWISE
    own[STIFF], own[LEAKS], own[LOWER], own[UPPER] = c[STIFFNESS].real, c[LEAK].real, c[LOW].real, c[HIGH].real


# The coefficients hold for one slope of the resistor. Where the slope or its derivative changes, the step is
# differentiated in full.
@inline
def _thresholds(t: Any, p: Any, d: Any, i: Any, r: Any, h: Any) -> Any:
    """``(ρ, lo, hi)`` of the resistor in row ``r`` with input ``i`` perturbed; without a perturbation for ``i < 0``."""
    which, slot, act = p.active.shape[0], 0, 0
    if i >= 0:
        which, slot, act = places_of(p, d, i)
        perturb(p, d, i, TINY)
    junction_flows(t, d.theta, d.x, d.y, d.wj)
    q = read(t, t[r, READ], step_of(d, which, slot, act, h))
    found = resistor_thresholds(t, r, q, d.theta)
    if i >= 0:
        perturb(p, d, i, 0.0)
    return found


@plain
def _prepare_slope(t: Any, p: Any, d: Any, leaf: Any, h: Any) -> None:
    """Prepare the affine pieces of a reducible storage for the slope of its resistor in this step."""
    stay_outside()
    none, r = p.active.shape[0], t[t[0, LEAVES] + leaf, FIRST_RESISTOR]
    for k in range(none + 1):
        rho, _, _ = _thresholds(t, p, d, d.x.shape[0] + d.y.shape[0] + k if k < none else -1, r, h)
        c = d.c[k, leaf]
        c[RHO] = rho
        c[ONE], c[TWO] = relaxation(h * (rho + c[LEAK]) * c[STIFFNESS])
        prepare_leaf(d, k, k < none, leaf, h)
    d.slope[leaf] = d.c[none, leaf, RHO].real
    for pair in range(p.first[leaf], p.first[leaf + 1]):
        k = parameter(d, p.input[pair])
        d.slopes[pair] = d.c[k, leaf, RHO].imag / TINY if k >= 0 else 0.0
    prepare_pairs(t, p, d, leaf)


@inline
def following_leaf(t: Any, p: Any, d: Any, leaf: Any, mean: Any, h: Any) -> Any:
    """`plain_leaf` of a reducible storage with modulated thresholds; the state must have been loaded."""
    r, own = t[t[0, LEAVES] + leaf, FIRST_RESISTOR], d.values[leaf]
    of = d.whole[p.active.shape[0], leaf]
    rho, lower, upper = _thresholds(t, p, d, -1, r, h)
    low, high = lower.real, upper.real
    x, current = d.x[d.kinds[leaf, STORAGE]].real, current_of(t, d, leaf)
    effort = own[STIFF] * x
    if not low <= effort <= high or low == high:
        if np.isnan(d.slope[leaf]):
            _prepare_slope(t, p, d, leaf, h)
        if rho.real != d.slope[leaf]:
            return False
    piece = piece_of(of, own, low, high, x, current)
    if piece == CROSSING:
        return False
    slides = piece != RESTING
    for pair in range(p.first[leaf], p.first[leaf + 1] if slides else p.first[leaf]):
        d.thresholds[pair] = 0.0
        if p.follows[pair]:
            slope, lower, upper = _thresholds(t, p, d, p.input[pair], r, h)
            if slope.imag / TINY != d.slopes[pair]:
                return False
            d.thresholds[pair] = (upper if piece == ABOVE else lower).imag / TINY
    fill(t, p, d, leaf, piece, (x, current, high if piece == ABOVE else low))
    for pair in range(p.first[leaf], p.first[leaf + 1] if slides else p.first[leaf]):
        d.by_leaf[pair] += of[piece, 2] * d.thresholds[pair]
        d.by_mean[pair] += of[piece, 5] * d.thresholds[pair]
    exert(t, p, d, leaf, mean)
    return True


@inline
def _prepare_junctions(t: Any, p: Any, d: Any, k: Any, h: Any) -> None:
    """The linear terms with parameter ``k`` perturbed, as functions of the flows."""
    n, m, none = d.x.shape[0], d.y.shape[0], p.active.shape[0]
    perturbed = k < none
    g = d.g[p.slot[n + m + k] if perturbed else 0]
    for s in range(n):
        d.x[s] = 0.0
    for b in range(m):
        for j in range(m):
            d.y[j] = 1.0 if j == b else 0.0
            d.wj[FORCE, j] = 0.0
        junction_flows(t, d.theta, d.x, d.y, d.wj)
        change = junction_change(t, b, d.c[k], d.x, d.y)
        d.wj[FORCE, b] = change / h
        for place in range(p.plain.shape[0]):
            if p.plain[place] < t[0, JUNCTION_INLETS]:
                junction_term(t, p.plain[place], Step(d.theta, d.c[k], g, d.a[0], d.x, d.y, h, d.wj))
        # By a parameter the terms are multiples of the flow; by the flow itself they are constants.
        i, row = (n + m + k, b) if perturbed else (n + b, m)
        if perturbed:
            d.change[b, i] = change.imag / TINY
        else:
            d.by_change[b, i] = change.real
        for j in range(m):
            d.junction[j, row, i] = part(d.wj[FORCE, j], perturbed)
        if not perturbed:
            start = junction_storage(t, b)
            d.by_change[b, start] = -2.0 if is_linear(t, b) else -1.0
            d.junction[b, m, start] = d.by_change[b, start] / h


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
        fill_constants(t, d.theta, h, d.c[k])
        _prepare_junctions(t, p, d, k, h)
        if k < none:
            perturb(p, d, known + k, 0.0)
        for leaf in range(count(t, LEAVES)):
            if p.affine[leaf]:
                prepare_leaf(d, k, k < none, leaf, h)
    for leaf in range(count(t, LEAVES)):
        d.slope[leaf] = np.nan
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
    leaves, remembers = count(t, LEAVES), count(t, MODULATOR_STATES) > 0
    loaded = p.terms.shape[0] > 0 or p.scaled.shape[0] > 0 or remembers
    for leaf in range(leaves):
        loaded = loaded or d.kinds[leaf, KIND] in (WHOLE, FOLLOWING)
    if loaded:
        load(t, d, n, run)
    if p.scaled.shape[0] > 0:
        scale(t, p, d, h)
    left = p.terms.shape[0] > 0
    for leaf in range(leaves):
        k, kind = d.kinds[leaf, STORAGE], d.kinds[leaf, KIND]
        x, mean, done = run.states[n, k], run.efforts[n, k], kind == CURVED
        if kind == CURVED:
            curved_leaf(t, p, d, leaf, x, mean, h)
        elif kind == FOLLOWING:
            done = following_leaf(t, p, d, leaf, mean, h)
        elif kind != WHOLE:
            done = plain_leaf(t, p, d, leaf, x, mean)
        d.todo[leaf] = not done
        left = left or not done
    if left and not loaded:
        load(t, d, n, run)
    if left:
        in_full(t, p, d, n, run)
    for k in range(count(t, MODULATOR_STATES)):
        memories_by(t, p, d, k, n, run)
