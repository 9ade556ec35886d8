"""Derivatives of one step: affine parts from coefficients that hold for many steps, the rest by complex steps.

While a reducible storage rests in its dead zone, or slides beyond one threshold ``τ``, its end state and mean effort
are affine,

    x⁺ = A₀ x + A₁ i + A₂ τ,     ē = B₀ x + B₁ i + B₂ τ.

The coefficients and their derivatives by every parameter hold for all steps of one size, as do those of the linear
terms of the junctions. If ``τ`` is modulated, they also depend on the slope of the resistor. A block is differentiated
in full (`phnn.integrate.perturbed`) if the storage meets a threshold, has a nonlinear law, or has a resistor whose
slope changes. The modulator states follow at the end.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from phnn.integrate import program as at
from phnn.integrate.cache import inline, plain, stay_outside
from phnn.integrate.perturbed import (
    PIECES,
    leaf_in_full,
    load,
    parameter,
    perturb,
    perturbed_step,
    places_of,
    terms_in_full,
)
from phnn.integrate.scheme import LOSSLESS
from phnn.integrate.step import (
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
    count,
    fill_constants,
    fill_gains,
    inlets,
    is_linear,
    junction_change,
    junction_flows,
    junction_storage,
    junction_term,
    leaf_storage,
    links,
    mean_effort,
    memory_decay,
    memory_rate,
    modulate,
    read,
    resistor_thresholds,
    source,
    sources,
)
from phnn.laws.leaf import relaxation, relaxed, slides_on
from phnn.laws.namespace import TINY
from phnn.laws.other import advanced

# The affine piece on which a reducible storage spends a step; CROSSING if it meets a threshold.
RESTING, ABOVE, BELOW, CROSSING = range(4)


@inline
def _current(t: Any, p: Any, d: Any, leaf: Any) -> Any:
    """Return the current into a reducible storage, and the flow through its only link or, with others, the current."""
    only, total = p.only[leaf], 0.0
    if only >= 0:
        flow = d.flows[t[only, at.TO_JUNCTION]]
        return d.g[0, only].real * flow, flow
    for r in links(t, leaf):
        total += d.g[0, r].real * d.flows[t[r, at.TO_JUNCTION]]
    for r in inlets(t, leaf):
        total += d.g[0, r].real * d.a[0, t[r, at.FROM_PORT]].real
    return total, total


@inline
def _fill_shifts(t: Any, p: Any, d: Any, leaf: Any) -> None:
    """Fill the derivatives of the current by inputs that change a ratio or an action; all others are constant."""
    for pair in range(p.first[leaf], p.first[leaf + 1]):
        if p.shifts[pair]:
            i, total = p.input[pair], 0.0
            _, slot, act = places_of(p, d, i)
            for r in links(t, leaf):
                total += d.g[slot, r].imag / TINY * d.flows[t[r, at.TO_JUNCTION]]
                if i == d.x.shape[0] + t[r, at.TO_JUNCTION]:
                    total += d.g[slot, r].real
            for r in inlets(t, leaf):
                total += (d.g[slot, r] * d.a[act, t[r, at.FROM_PORT]]).imag / TINY
            d.shift[pair] = total


@inline
def _exert(t: Any, p: Any, d: Any, leaf: Any, mean: Any) -> None:
    """Add the force of a reducible storage on its junctions; ``mean`` is its mean effort."""
    first, last = p.first[leaf], p.first[leaf + 1]
    for r in links(t, leaf):
        force, ratio = d.by_force[t[r, at.TO_JUNCTION]], d.g[0, r].real
        for pair in range(first, last):
            force[p.input[pair]] += ratio * d.by_mean[pair] + d.by_ratio[pair] * mean
        for pair in range(first, last if p.shifted[leaf] else first):
            if p.shifts[pair]:
                force[p.input[pair]] += d.g[p.slot[p.input[pair]], r].imag / TINY * mean


@inline
def _curved_leaf(t: Any, p: Any, d: Any, leaf: Any, x: Any, h: Any) -> None:
    """Fill the derivatives of a lossless storage with a nonlinear law from its state ``x``."""
    k, (current, flow) = leaf_storage(t, leaf), _current(t, p, d, leaf)
    for pair in range(p.first[leaf], p.first[leaf + 1]):
        i = p.input[pair]
        start = complex(x, TINY if i == k else 0.0)
        end = start + h * complex(current, TINY * (d.shift[pair] + d.by_ratio[pair] * flow))
        perturbed = parameter(d, i) >= 0
        if perturbed:
            perturb(p, d, i, TINY)
        between = mean_effort(t, k, start, end, d.theta)
        if perturbed:
            perturb(p, d, i, 0.0)
        d.by_leaf[pair] = end.imag / TINY
        d.by_mean[pair] = between.imag / TINY


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


@plain
def _prepare_pieces(t: Any, p: Any, d: Any, leaf: Any, h: Any) -> None:
    """Fill the coefficients of a reducible storage's pieces and, of its pairs, what stays the same while they do."""
    stay_outside()
    none, storage = p.active.shape[0], leaf_storage(t, leaf)
    whole, ratio = d.whole[leaf], d.g[0, p.only[leaf]].real if p.only[leaf] >= 0 else 1.0
    for piece in range(PIECES):
        for term in range(3):
            end, mean = _term(piece, h, d.c[none, leaf], term)
            whole[piece, term], whole[piece, 3 + term] = end.real, mean.real
        for pair in range(p.first[leaf], p.first[leaf + 1]):
            by, i, threshold = d.affine[pair, piece], p.input[pair], 0.0
            by[1], by[5] = 0.0, 0.0
            k = parameter(d, i)
            if k >= 0:
                for term in range(3):
                    end, mean = _term(piece, h, d.c[k, leaf], term)
                    by[term], by[4 + term] = end.imag / TINY, mean.imag / TINY
                threshold = d.c[k, leaf, HIGH if piece == ABOVE else LOW].imag / TINY
            start, shift = 1.0 if i == storage else 0.0, 0.0 if p.shifts[pair] else d.shift[pair]
            for out in range(2):
                of = whole[piece, 3 * out : 3 * out + 3]
                by[4 * out + 1] = by[4 * out + 1] * ratio + of[1] * d.by_ratio[pair]
                by[4 * out + 3] = of[0] * start + of[1] * shift + of[2] * threshold


# The coefficients hold for one slope of the resistor. Where a modulated slope or its derivative changes, the step is
# differentiated in full.
@plain
def _prepare_slope(t: Any, p: Any, d: Any, leaf: Any, h: Any) -> None:
    """Prepare the affine pieces of a reducible storage for the slope of its resistor in this step."""
    stay_outside()
    none = p.active.shape[0]
    for k in range(none + 1):
        c, i = d.c[k, leaf], d.x.shape[0] + d.y.shape[0] + k if k < none else -1
        c[RHO], _, _ = _thresholds(t, p, d, leaf, i, h)
        c[ONE], c[TWO] = relaxation(h * (c[RHO] + c[LEAK]) * c[STIFFNESS])
    _prepare_pieces(t, p, d, leaf, h)


@plain
def _thresholds(t: Any, p: Any, d: Any, leaf: Any, i: Any, h: Any) -> Any:
    """Return ``(ρ, lo, hi)`` of the first resistor of a storage with input ``i`` perturbed, none for ``i < 0``."""
    stay_outside()
    r = t[t[0, at.LEAVES] + leaf, at.FIRST_RESISTOR]
    q = read(t, t[r, at.READ], perturbed_step(t, p, d, i, h))
    thresholds = resistor_thresholds(t, r, q, d.theta)
    perturb(p, d, i, 0.0)
    return thresholds


@inline
def _piece_of(of: Any, c: Any, low: Any, high: Any, x: Any, current: Any) -> Any:
    """Return the affine piece on which a reducible storage spends a step, by the rules of `phnn.laws.leaf.rc_flow`:
    one of (3, 6) coefficients ``of`` its pieces; ``c`` are its constants."""
    stiffness = c[STIFFNESS].real
    effort = stiffness * x
    # Without a dead zone, no state rests in it.
    above = effort > high or (effort == high and low == high)
    if above or effort < low:
        piece, threshold = (ABOVE, high) if above else (BELOW, low)
        end = stiffness * (of[piece, 0] * x + of[piece, 1] * current + of[piece, 2] * threshold)
        return piece if slides_on(effort, end, above, threshold, current, c[LEAK].real) else CROSSING
    end = stiffness * (of[RESTING, 0] * x + of[RESTING, 1] * current)
    return RESTING if low <= end <= high else CROSSING


@inline
def _leaf_by_pieces(t: Any, p: Any, d: Any, leaf: Any, x: Any, h: Any) -> Any:
    """Fill the derivatives of a reducible storage from its state ``x``; returns False if it meets a threshold."""
    c, of = d.c[p.active.shape[0], leaf], d.whole[leaf]
    first, last, piece = p.first[leaf], p.first[leaf + 1], RESTING
    (current, flow), low, high = _current(t, p, d, leaf), c[LOW].real, c[HIGH].real
    if p.reads[leaf]:
        rho, lower, upper = _thresholds(t, p, d, leaf, -1, h)
        low, high = lower.real, upper.real
        if not low <= c[STIFFNESS].real * x <= high or low == high:
            if np.isnan(c[RHO].real):
                _prepare_slope(t, p, d, leaf, h)
            if rho.real != c[RHO].real:
                return False
    if t[t[0, at.LEAVES] + leaf, at.RULE] != LOSSLESS:
        piece = _piece_of(of, c, low, high, x, current)
    if piece == CROSSING:
        return False
    follows = p.reads[leaf] and piece != RESTING
    for pair in range(first, last if follows else first):
        if p.follows[pair]:
            slope, lower, upper = _thresholds(t, p, d, leaf, p.input[pair], h)
            k = parameter(d, p.input[pair])
            if slope.imag != (d.c[k, leaf, RHO].imag if k >= 0 else 0.0):
                return False
            d.by_threshold[pair] = (upper if piece == ABOVE else lower).imag / TINY
    threshold = high if piece == ABOVE else low
    for pair in range(first, last):
        q = d.affine[pair, piece]
        d.by_leaf[pair] = q[0] * x + q[1] * flow + q[2] * threshold + q[3]
        d.by_mean[pair] = q[4] * x + q[5] * flow + q[6] * threshold + q[7]
    for pair in range(first, last if follows or p.shifted[leaf] else first):
        shift = d.shift[pair] if p.shifts[pair] else 0.0
        moved = d.by_threshold[pair] if follows and p.follows[pair] else 0.0
        d.by_leaf[pair] += of[piece, 1] * shift + of[piece, 2] * moved
        d.by_mean[pair] += of[piece, 4] * shift + of[piece, 5] * moved
    return True


#     z⁺ = advanced(z, s̄; θ),     δz⁺ = ∂z⁺/∂z δz + ∂z⁺/∂θ δθ + ∂z⁺/∂s̄ Σ δ(sources)
#
# Each factor comes from complex steps through the functions of the integration itself. The derivative of a reducible
# storage's power follows from those of its end state and mean effort, which are computed before.
@inline
def _leaf_power(t: Any, p: Any, d: Any, leaf: Any, n: Any, run: Any) -> None:
    """Add the derivatives of ``i ē − ΔH/h``, the power that the resistors of a reducible storage dissipate."""
    k, (total, flow) = leaf_storage(t, leaf), _current(t, p, d, leaf)
    for pair in range(p.first[leaf], p.first[leaf + 1]):
        i = p.input[pair]
        which, _, _ = places_of(p, d, i)
        start = complex(run.states[n, k], TINY if i == k else 0.0)
        end = complex(run.states[n + 1, k], TINY * d.by_leaf[pair])
        mean = complex(run.efforts[n, k], TINY * d.by_mean[pair])
        if t[t[0, at.LEAVES] + leaf, at.IS_LINEAR] > 0:
            between = 0.5 * d.c[which, leaf, STIFFNESS] * (start + end)
        else:
            perturb(p, d, i, TINY)
            between = mean_effort(t, k, start, end, d.theta)
            perturb(p, d, i, 0.0)
        current = complex(total, TINY * (d.shift[pair] + d.by_ratio[pair] * flow))
        power = current * mean - between * (end - start) / run.h[n]
        d.by_drive[i] += power.imag / TINY


@inline
def _by_source(t: Any, p: Any, d: Any, s: Any, h: Any) -> None:
    """Add the derivatives of the source in row ``s``, unless it is the power of a reducible storage."""
    for leaf in range(count(t, at.LEAVES) if t[s, at.SOURCE_EFFORT] >= 0 else 0):
        if leaf_storage(t, leaf) == t[s, at.SOURCE_EFFORT]:
            for pair in range(p.first[leaf], p.first[leaf + 1]):
                d.by_drive[p.input[pair]] += d.by_mean[pair]
    number = s - t[0, at.SOURCES]
    for place in range(p.source_first[number], p.source_first[number + 1]):
        i = p.source_input[place]
        d.by_drive[i] += source(t, s, perturbed_step(t, p, d, i, h)).imag / TINY
        perturb(p, d, i, 0.0)


@plain
def _end(t: Any, row: Any, z: Any, drive: Any, h: Any, theta: Any) -> Any:
    """Return the end state of the modulator state in a row."""
    stay_outside()
    return advanced(z, h, memory_rate(t, row, z, drive, theta), memory_decay(t, row, theta))


@inline
def _modulator_by(t: Any, p: Any, d: Any, k: Any, n: Any, run: Any) -> None:
    """Fill the derivatives of modulator state ``k`` from those of the reducible storages."""
    row, state, out, h = t[0, at.MODULATOR_STATES] + k, count(t, at.STORAGES) + k, d.by_modulator[k], run.h[n]
    for i in range(out.shape[0]):
        d.by_drive[i] = 0.0
    for s in sources(t, row):
        if t[s, at.SOURCE_LEAF] >= 0:
            _leaf_power(t, p, d, t[s, at.SOURCE_LEAF], n, run)
        else:
            _by_source(t, p, d, s, h)
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
            if p.plain[place] < t[0, at.JUNCTION_INLETS]:
                junction_term(t, p.plain[place], Step(d.theta, d.c[k], g, d.a[0], d.x, d.y, h, d.wj, d.wx))
        # By a parameter the terms are multiples of the flow; by the flow itself they are constants.
        i, row = (n + m + k, b) if perturbed else (n + b, m)
        if perturbed:
            d.change[b, i] = change.imag / TINY
        else:
            d.by_change[b, i] = change.real
        for j in range(m):
            d.junction[j, row, i] = d.wj[FORCE, j].imag / TINY if perturbed else d.wj[FORCE, j].real
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
        perturb(p, d, p.slots[s], TINY)
        fill_gains(t, d.theta, d.g[s])
        perturb(p, d, p.slots[s], 0.0)
    for k in range(none + 1):
        i = known + k if k < none else -1
        perturb(p, d, i, TINY)
        fill_constants(t, d.theta, h, d.c[k])
        _prepare_junctions(t, p, d, k, h)
        perturb(p, d, i, 0.0)
    for leaf in range(count(t, at.LEAVES)):
        if p.reads[leaf]:
            # No slope is known yet.
            d.c[none, leaf, RHO] = np.nan
        for pair in range(p.first[leaf], p.first[leaf + 1]):
            d.shift[pair], d.by_ratio[pair] = 0.0, 0.0
            if p.only[leaf] >= 0:
                d.by_ratio[pair] = d.g[p.slot[p.input[pair]], p.only[leaf]].imag / TINY
            for r in links(t, leaf):
                if p.input[pair] == d.x.shape[0] + t[r, at.TO_JUNCTION]:
                    d.shift[pair] += d.g[0, r].real
        if p.affine[leaf]:
            _prepare_pieces(t, p, d, leaf, h)


@inline
def _linear_terms(t: Any, p: Any, d: Any) -> None:
    """Fill the derivatives of the junctions' linear terms."""
    m, known = d.y.shape[0], d.x.shape[0] + d.y.shape[0]
    for j in range(m):
        force, moved = d.by_force[j], d.by_change[j]
        one, of, flow = d.junction[j, m], d.change[j], d.flows[j]
        for i in range(force.shape[0]):
            force[i] = one[i]
        for i in range(known, force.shape[0]):
            moved[i] = of[i] * flow
        for b in range(m):
            by, v = d.junction[j, b], d.flows[b]
            for i in range(known, force.shape[0]):
                force[i] += by[i] * v
    for place in range(p.plain.shape[0]):
        r = p.plain[place]
        if r >= t[0, at.JUNCTION_INLETS]:
            force = d.by_force[t[r, at.INTO_JUNCTION]]
            for s in range(1, p.slots.shape[0]):
                force[p.slots[s]] -= d.g[s, r].imag / TINY * d.a[0, t[r, at.FROM_PORT]].real
            for k in range(p.active.shape[0] if d.a.shape[0] > 1 else 0):
                if p.in_ports[k] >= 0:
                    force[known + k] -= d.g[0, r].real * (d.a[1 + p.in_ports[k], t[r, at.FROM_PORT]].imag / TINY)


@inline
def derivatives_at(t: Any, p: Any, d: Any, n: Any, run: Any, fresh: Any) -> None:
    """Fill the derivatives of step ``n``; ``fresh`` if its size differs from that of the last call."""
    h = run.h[n]
    if fresh:
        _prepare(t, p, d, h)
    load(t, d, n, run)
    _linear_terms(t, p, d)
    for s in range(p.slots.shape[0] if count(t, at.FACTORS) > 0 else 0):
        modulate(t, perturbed_step(t, p, d, p.slots[s], h))
        perturb(p, d, p.slots[s], 0.0)
    terms_in_full(t, p, d, h)
    for leaf in range(count(t, at.LEAVES)):
        row, done = t[0, at.LEAVES] + leaf, False
        k = t[row, at.OWN_STORAGE]
        if p.affine[leaf]:
            if p.shifted[leaf]:
                _fill_shifts(t, p, d, leaf)
            if t[row, at.RULE] == LOSSLESS and t[row, at.IS_LINEAR] <= 0:
                _curved_leaf(t, p, d, leaf, run.states[n, k], h)
                done = True
            else:
                done = _leaf_by_pieces(t, p, d, leaf, run.states[n, k], h)
        if done:
            _exert(t, p, d, leaf, run.efforts[n, k])
        else:
            leaf_in_full(t, p, d, leaf, h)
    for k in range(count(t, at.MODULATOR_STATES)):
        _modulator_by(t, p, d, k, n, run)
