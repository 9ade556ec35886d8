"""Affine pieces of reducible storages whose thresholds are modulated, with thresholds evaluated step by step.

The coefficients hold for one slope of the resistor. Where the slope or its derivative changes, the step is
differentiated in full.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from phnn.integrate.affine import current_of, exert, fill, piece_of
from phnn.integrate.cache import inline, plain, stay_outside
from phnn.integrate.constants import LEAK, ONE, RHO, STIFFNESS, TWO
from phnn.integrate.perturbed import ABOVE, CROSSING, RESTING, STIFF, STORAGE, parameter, perturb, places_of, step_of
from phnn.integrate.prepared import prepare_leaf, prepare_pairs
from phnn.integrate.table_access import resistor_thresholds
from phnn.integrate.tables import (
    FIRST_RESISTOR,
    LEAVES,
    READ,
)
from phnn.integrate.terms import junction_flows, read
from phnn.laws.leaf import relaxation
from phnn.laws.namespace import TINY


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
