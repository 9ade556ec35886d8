"""Away from its thresholds a leaf is affine: its derivatives follow from coefficients that hold for many steps.

While a leaf rests in its dead zone, or slides beyond one threshold ``τ``, the end of a step and the mean effort are

    x⁺ = A₀ x + A₁ i + A₂ τ,     ē = B₀ x + B₁ i + B₂ τ.

The coefficients and their derivatives by every parameter hold for all steps of one size, and, where ``τ`` follows
something, for one slope of the resistor. They come from complex steps through the functions that march. Steps that
meet a threshold, leaves whose law is curved, and those whose slope moves too, are differentiated one by one.
"""

from __future__ import annotations

from typing import Any

from phnn.integrate.compiled import inline
from phnn.integrate.lookups import mean_effort
from phnn.integrate.perturbed import (
    ABOVE,
    BELOW,
    CROSSING,
    KIND,
    LEAKS,
    LOWER,
    ONLY_LINK,
    PIECEWISE,
    RESTING,
    SHIFTS,
    STIFF,
    STORAGE,
    TIMES,
    UPPER,
    parameter,
    perturb,
    places_of,
)
from phnn.integrate.tables import (
    FIRST_INLET,
    FIRST_LINK,
    FROM_PORT,
    LAST_INLET,
    LAST_LINK,
    LEAVES,
    TO_JUNCTION,
)
from phnn.laws.leaf import slides_on
from phnn.laws.namespace import TINY


@inline
def piece_of(of: Any, own: Any, low: Any, high: Any, x: Any, current: Any) -> Any:
    """Where a leaf spends a step, by the rules of `phnn.laws.leaf.rc_flow`.

    Args:
        of: (3, 6) coefficients of its pieces; own: its values.
    """
    stiffness = own[STIFF]
    effort = stiffness * x
    # Without a dead zone nothing rests in it.
    above = effort > high or (effort == high and low == high)
    if above or effort < low:
        piece, threshold = (ABOVE, high) if above else (BELOW, low)
        end = stiffness * (of[piece, 0] * x + of[piece, 1] * current + of[piece, 2] * threshold)
        return piece if slides_on(effort, end, above, threshold, current, own[LEAKS]) else CROSSING
    end = stiffness * (of[RESTING, 0] * x + of[RESTING, 1] * current)
    return RESTING if low <= end <= high else CROSSING


@inline
def _shift(t: Any, p: Any, d: Any, row: Any, i: Any) -> Any:
    """How an input changes the current of the leaf in a row."""
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
    """Add what a leaf exerts on its junctions, its mean effort being ``exerted``."""
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
    """Add what inputs do by way of the current; ``end`` and ``mean`` are the derivatives by it."""
    for pair in range(p.first[leaf], p.first[leaf + 1]):
        if p.shifts[pair]:
            d.by_current[pair] = _shift(t, p, d, t[0, LEAVES] + leaf, p.input[pair])
            d.by_leaf[pair] += end * d.by_current[pair]
            d.by_mean[pair] += mean * d.by_current[pair]


@inline
def fill(t: Any, p: Any, d: Any, leaf: Any, piece: Any, x: Any, current: Any, threshold: Any) -> None:
    """The derivatives of a leaf within a piece, but for what it exerts."""
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
    """The current of a leaf whose ratios follow nothing."""
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
    """Fill the derivatives of a leaf whose thresholds follow nothing; returns whether a piece serves.

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
    fill(t, p, d, leaf, piece, x, current, own[UPPER] if piece == ABOVE else own[LOWER])
    exert(t, p, d, leaf, mean)
    return True


@inline
def curved_leaf(t: Any, p: Any, d: Any, leaf: Any, x: Any, mean: Any, h: Any) -> None:
    """Fill the derivatives of a lossless leaf whose law is curved; arguments as of `plain_leaf`."""
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
