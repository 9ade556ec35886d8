"""Affine pieces: the derivatives of a reducible storage away from its thresholds.

While the storage rests in its dead zone, or slides beyond one threshold ``τ``, its end state and mean effort are
affine,

    x⁺ = A₀ x + A₁ i + A₂ τ,     ē = B₀ x + B₁ i + B₂ τ.

The coefficients and their derivatives by every parameter hold for all steps of one size. If ``τ`` is modulated, they
also depend on the slope of the resistor. They come from complex steps through the functions of the integration itself.
A step is differentiated on its own if the storage meets a threshold, has a nonlinear law, or has a resistor whose slope
changes.
"""

from __future__ import annotations

from typing import Any

from phnn.integrate.cache import inline
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
from phnn.integrate.table_access import mean_effort
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
