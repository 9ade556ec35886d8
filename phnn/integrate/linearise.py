"""Derivatives of one step: affine parts from coefficients that hold for many steps, the rest by complex steps.

The linear terms of the junctions, and reducible storages away from their thresholds (`phnn.integrate.affine`), take
their derivatives from coefficients. These are prepared whenever the step size changes. `phnn.integrate.perturbed`
differentiates all other blocks one by one. `phnn.integrate.drives` differentiates the modulator states.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from phnn.integrate.affine import curved_leaf, plain_leaf
from phnn.integrate.cache import inline, plain, stay_outside
from phnn.integrate.constants import fill_constants, fill_gains
from phnn.integrate.drives import memories_by
from phnn.integrate.following import following_leaf
from phnn.integrate.perturbed import (
    CURVED,
    FOLLOWING,
    KIND,
    STORAGE,
    WHOLE,
    in_full,
    load,
    load_actions,
    perturb,
    scale,
)
from phnn.integrate.prepared import part, prepare_leaf, prepare_pairs, prepare_values
from phnn.integrate.table_access import count, is_linear, junction_storage
from phnn.integrate.tables import (
    FROM_PORT,
    INTO_JUNCTION,
    JUNCTION_INLETS,
    LEAVES,
    MODULATOR_STATES,
)
from phnn.integrate.terms import FORCE, Step, junction_change, junction_flows, junction_term
from phnn.laws.namespace import TINY


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
