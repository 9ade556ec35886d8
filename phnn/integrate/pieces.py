"""Derivatives of the quick steps: away from its thresholds a leaf is affine.

While a leaf rests in its dead zone, or slides beyond one threshold, the end of a step and what the leaf exerts are

    x⁺ = A₀ x + A₁ v̄ + A₂,     a ē = B₀ x + B₁ v̄ + B₂.

The coefficients and their derivatives by every parameter hold for all steps of one size. They come from complex steps
through the functions that march; steps that meet a threshold, and those of leaves whose law is curved, are
differentiated one by one in the same way.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.compiled import inline, plain, stay_outside
from phnn.integrate.constants import (
    CONSTANTS,
    HIGH,
    LEAK,
    LEAK_ONE,
    LEAK_TWO,
    LOW,
    ONE,
    RHO,
    STIFFNESS,
    TWO,
    fill_gains,
)
from phnn.integrate.linearise import Pattern, Run
from phnn.integrate.lookups import junction_storage, mean_effort
from phnn.integrate.quick import CURVED, GAIN, resolve
from phnn.integrate.tables import JUNCTION_INLETS, LEAVES, LOSSLESS, Integers, rows_of
from phnn.laws.leaf import rc_flow, resting, slides_on, sliding
from phnn.laws.namespace import TINY

Array = NDArray[np.float64]

_RESTING, _ABOVE, _BELOW, _CROSSING = range(4)
# A₀ … B₂.
_COEFFICIENTS = 6


class Pieces(NamedTuple):
    """Memory for the derivatives of one step by I inputs, K of them parameters.

    Attributes:
        theta: (M,), g: (rows,), constants: (L+1, 9), complex, and kinds: (L, 2), see `resolve`.
        c: (K+1, L, 10) constants of the leaves, complex: one parameter perturbed each, and last none.
        whole: (K+1, L, 3, 6) derivatives of the coefficients of each piece, and last the coefficients.
        affine: (pairs, 3, 6) the derivatives of each pair as a function of ``(x, v̄, 1)``.
        junction, change: (2, I) of the junction's own terms and of ``z − p`` as functions of ``(v̄, 1)``.
        inlets: (inlets, I) of what the inlets exert as a function of the actions of their ports.
        by_leaf, by_force, by_change: as of `phnn.integrate.linearise.Derivatives`; by_memory: empty.
    """

    theta: Any
    g: Any
    constants: Any
    kinds: Any
    c: Any
    whole: Any
    affine: Any
    junction: Any
    change: Any
    inlets: Any
    by_leaf: Any
    by_force: Any
    by_change: Any
    by_memory: Any


def new_pieces(t: Integers, p: Pattern, theta: Array, run: Run) -> Pieces:
    """Memory for a network and a pattern."""
    leaves, rows, pairs, inputs = len(rows_of(t, LEAVES)), p.active.size + 1, p.leaf.size, p.in_junctions.size
    return Pieces(
        theta.astype(np.complex128),
        np.zeros(t.shape[0], np.complex128),
        np.zeros((leaves + 1, CONSTANTS), np.complex128),
        np.zeros((leaves, 2), np.int64),
        np.zeros((rows, leaves, CONSTANTS + 1), np.complex128),
        np.zeros((rows, leaves, 3, _COEFFICIENTS)),
        np.zeros((pairs, 3, _COEFFICIENTS)),
        np.zeros((2, inputs)),
        np.zeros((2, inputs)),
        np.zeros((len(rows_of(t, JUNCTION_INLETS)), inputs)),
        np.zeros(pairs),
        np.zeros((1, inputs)),
        np.zeros((1, inputs)),
        np.zeros((0, inputs)),
    )


@inline
def _term(piece: Any, h: Any, c: Any, term: Any) -> Any:
    """One term of a piece as complex numbers: what the state, the mean flow, or the threshold alone leads to."""
    none, unit = 0.0 * c[STIFFNESS], 1.0 + 0.0 * c[STIFFNESS]
    x = unit if term == 0 else none
    current = c[GAIN] if term == 1 else none
    if piece == _RESTING:
        return resting(x, current, h, c[STIFFNESS], c[LEAK], c[LEAK_ONE], c[LEAK_TWO])
    threshold = (c[HIGH] if piece == _ABOVE else c[LOW]) if term == 2 else none
    return sliding(x, current, h, c[STIFFNESS], c[RHO], threshold, c[LEAK], c[ONE], c[TWO])


@inline
def _part(z: Any, perturbed: Any) -> Any:
    """The derivative along a perturbation, or the value where there is none."""
    return z.imag / TINY if perturbed else z.real


@inline
def _prepare_leaves(d: Any, k: Any, perturbed: Any, h: Any) -> None:
    for leaf in range(d.kinds.shape[0]):
        for piece in range(3):
            for term in range(3):
                end, mean = _term(piece, h, d.c[k, leaf], term)
                d.whole[k, leaf, piece, term] = _part(end, perturbed)
                d.whole[k, leaf, piece, 3 + term] = _part(d.c[k, leaf, GAIN] * mean, perturbed)


@inline
def _prepare_pairs(p: Any, d: Any, states: Any) -> None:
    """By its state and by the flow a piece has constant derivatives."""
    for pair in range(p.leaf.shape[0]):
        k = p.input[pair] - states - 1
        for piece in range(3):
            for i in range(_COEFFICIENTS):
                if k >= 0:
                    d.affine[pair, piece, i] = d.whole[k, p.leaf[pair], piece, i]
                elif i % 3 == 2:
                    d.affine[pair, piece, i] = d.whole[-1, p.leaf[pair], piece, i - 2 if k < -1 else i - 1]


@plain
def _prepare(t: Any, p: Any, d: Any, states: Any, h: Any) -> None:
    """Everything that is the same in all steps of size ``h``."""
    stay_outside()
    none = p.active.shape[0]
    for k in range(none + 1):
        perturbed = k < none
        if perturbed:
            d.theta[p.active[k]] += TINY * 1j
        fill_gains(t, d.theta, d.g)
        capacity, damping = resolve(t, d.theta, h, d.g, d.constants, d.kinds, d.c[k])
        if perturbed:
            d.theta[p.active[k]] = complex(d.theta[p.active[k]].real, 0.0)
        _prepare_leaves(d, k, perturbed, h)
        # The flow is multiplied by what a parameter perturbs.
        i, row = (states + 1 + k, 0) if perturbed else (states, 1)
        d.change[row, i] = 2.0 * _part(capacity, perturbed)
        d.junction[row, i] = d.change[row, i] / h + _part(damping, perturbed)
        for r in range(d.inlets.shape[0] if perturbed else 0):
            d.inlets[r, i] = -d.g[t[0, JUNCTION_INLETS] + r].imag / TINY
    d.change[1, junction_storage(t, 0)] = -2.0
    d.junction[1, junction_storage(t, 0)] = -2.0 / h
    _prepare_pairs(p, d, states)


@inline
def _piece_of(d: Any, leaf: Any, x: Any, v: Any) -> Any:
    """Where a leaf spends a step, by the rules of `rc_flow`."""
    if d.kinds[leaf, 0] == LOSSLESS:
        return _RESTING
    if d.kinds[leaf, 0] == CURVED:
        return _CROSSING
    stiffness, low, high = d.c[-1, leaf, STIFFNESS].real, d.c[-1, leaf, LOW].real, d.c[-1, leaf, HIGH].real
    effort = stiffness * x
    # Without a dead zone nothing rests in it.
    above = effort > high or (effort == high and low == high)
    piece = _ABOVE if above else _BELOW if effort < low else _RESTING
    q = d.whole[-1, leaf, piece]
    end = stiffness * (q[0] * x + q[1] * v + q[2])
    if piece == _RESTING:
        stays = low <= end <= high
    else:
        current, leak = d.c[-1, leaf, GAIN].real * v, d.c[-1, leaf, LEAK].real
        stays = slides_on(effort, end, above, high if above else low, current, leak)
    return piece if stays else _CROSSING


@inline
def _curved(t: Any, p: Any, d: Any, leaf: Any, k: Any, h: Any, x: Any, current: Any) -> Any:
    """A step of a leaf whose law is curved, with parameter ``k`` perturbed where that is one."""
    end = x + h * current
    if k >= 0:
        d.theta[p.active[k]] += TINY * 1j
    mean = mean_effort(t, d.kinds[leaf, 1], x, end, d.theta)
    if k >= 0:
        d.theta[p.active[k]] = complex(d.theta[p.active[k]].real, 0.0)
    return end, mean


@plain
def _crossed(t: Any, p: Any, d: Any, leaf: Any, states: Any, h: Any, x: Any, v: Any) -> None:
    """Derivatives of a step of a leaf that meets a threshold, or whose law is curved."""
    stay_outside()
    for pair in range(p.first[leaf], p.first[leaf + 1]):
        k = p.input[pair] - states - 1
        c = d.c[max(k, -1), leaf]
        x_c, v_c = complex(x, TINY if k < -1 else 0.0), complex(v, TINY if k == -1 else 0.0)
        if d.kinds[leaf, 0] == CURVED:
            end, mean = _curved(t, p, d, leaf, k, h, x_c, c[GAIN] * v_c)
        else:
            end, mean = rc_flow(
                x_c, c[GAIN] * v_c, h, c[STIFFNESS], c[RHO], c[LOW], c[HIGH], c[LEAK], c[ONE], c[TWO], c[LEAK_ONE],
                c[LEAK_TWO],
            )  # fmt: skip
        d.by_leaf[pair] = end.imag / TINY
        d.by_force[0, p.input[pair]] += (c[GAIN] * mean).imag / TINY


@inline
def _by_port_laws(t: Any, p: Any, d: Any, states: Any, n: Any, by_port: Any) -> None:
    """Add what parameters of port laws change of the force on the junction."""
    for k in range(p.active.shape[0]):
        if p.in_ports[k] >= 0:
            for r in range(t[0, JUNCTION_INLETS], t[0, JUNCTION_INLETS + 1]):
                d.by_force[0, states + 1 + k] -= d.g[r].real * by_port[p.in_ports[k], n, t[r, 0]]


@inline
def derivatives_at(t: Any, p: Any, d: Any, n: Any, run: Any, fresh: Any) -> None:
    """Fill the derivatives of step ``n``; ``fresh`` where its size differs from that of the last call."""
    states, h = run.states.shape[1], run.h[n]
    if fresh:
        _prepare(t, p, d, states, h)
    v = run.efforts[n, junction_storage(t, 0)]
    force, moved = d.by_force[0], d.by_change[0]
    for i in range(force.shape[0]):
        moved[i] = d.change[0, i] * v + d.change[1, i]
        force[i] = d.junction[0, i] * v + d.junction[1, i]
    for r in range(d.inlets.shape[0]):
        action = run.actions[n, t[t[0, JUNCTION_INLETS] + r, 0]]
        for i in range(force.shape[0]):
            force[i] += d.inlets[r, i] * action
    if run.by_port.shape[0] > 0:
        _by_port_laws(t, p, d, states, n, run.by_port)
    for leaf in range(d.kinds.shape[0]):
        x = run.states[n, d.kinds[leaf, 1]]
        piece = _piece_of(d, leaf, x, v)
        if piece == _CROSSING:
            _crossed(t, p, d, leaf, states, h, x, v)
            continue
        for pair in range(p.first[leaf], p.first[leaf + 1]):
            q = d.affine[pair, piece]
            d.by_leaf[pair] = q[0] * x + q[1] * v + q[2]
            d.by_force[0, p.input[pair]] += q[3] * x + q[4] * v + q[5]
