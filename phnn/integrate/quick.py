"""The compiled integration of networks with a single linear junction: the same steps, several times faster.

The reducible storages are coupled to the junction through one ratio each; they are lossless or have an exact flow.
Resistors and inlets act on the junction. Ratios of storages and inlets may follow modulator states. Then a step is

    F(v̄) = (2/h)(v̄/s − p) + d v̄ + Σ_r b_r φ_r(b_r v̄) + Σ_l a_l ē_l(a_l v̄) − Σ_p g_p ψ_p(ū_p)

with the damping ``d`` of all linear resistors. Except for the states, nearly every term is a constant that is computed
once. `phnn.integrate.step` has the equations in general.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.compiled import inline, loop_entry, plain, stay_outside
from phnn.integrate.constants import (
    CAPACITY,
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
    fill_constants,
    fill_gains,
)
from phnn.integrate.modulator_states import advance
from phnn.integrate.partition import LINEAR_RESISTOR_CODES
from phnn.integrate.program import Program
from phnn.integrate.roots import extrapolated, make_root
from phnn.integrate.table_access import (
    count,
    factor,
    junction_storage,
    mean_effort,
    resistor_flow,
    resistor_thresholds,
)
from phnn.integrate.tables import (
    EXACT,
    FACTORS,
    FIRST_BRANCH,
    FIRST_INLET,
    FIRST_LINK,
    FIRST_RESISTOR,
    FROM_PORT,
    GYRATORS,
    IS_LINEAR,
    JUNCTION_INLETS,
    JUNCTION_RESISTORS,
    JUNCTIONS,
    LAST_BRANCH,
    LAST_INLET,
    LAST_LINK,
    LAW,
    LEAVES,
    LINKS,
    LOSSLESS,
    MODULATOR_STATES,
    OWN_STORAGE,
    RATIO,
    RATIO_PLACE,
    READ,
    READ_LEAF,
    READ_MODULATOR,
    RULE,
    SIGN,
    STORAGES,
    rows_of,
)
from phnn.integrate.terms import EFFORT, FLOW, NEXT, Step
from phnn.laws.leaf import rc_flow, relaxation
from phnn.laws.namespace import TINY

Array = NDArray[np.float64]

GAIN = CONSTANTS
# Columns of ``kinds``.
_RULE, _STORAGE, _RESISTOR = range(3)
# In addition to the rules of the table: a lossless storage with a nonlinear law, a storage with modulated thresholds.
_CURVED, _FOLLOWING = -1, -2


@lru_cache(maxsize=512)
def serves(program: Program) -> bool:
    """Whether the steps of a program have the form above."""
    t = program.table
    junctions, leaves = rows_of(t, JUNCTIONS), rows_of(t, LEAVES)
    if len(junctions) != 1 or not junctions[0, IS_LINEAR] or len(rows_of(t, GYRATORS)):
        return False
    single = (leaves[:, LAST_LINK] - leaves[:, FIRST_LINK] == 1) & (leaves[:, LAST_INLET] == leaves[:, FIRST_INLET])
    closed = np.isin(leaves[:, RULE], (LOSSLESS, EXACT))
    scalable = [row for kind in (LINKS, JUNCTION_INLETS) for row in range(t[0, kind], t[0, kind + 1])]
    slow = t[rows_of(t, FACTORS)[:, READ], READ_MODULATOR] >= 0
    return bool((single & closed).all() and slow.all()) and set(program.sparsity.scaled) <= set(scalable)


@inline
def _read(t: Any, r: Any, y: Any, capacity: Any, gains: Any, kinds: Any, x: Any, h: Any, p: Any) -> Any:
    """`phnn.integrate.step.read`."""
    if r < 0:
        return 0.0 * y
    leaf = t[r, READ_LEAF]
    if t[r, READ_MODULATOR] >= 0:
        return x[t[r, READ_MODULATOR]] + 0.0 * y
    if leaf >= 0:
        return x[kinds[leaf, _STORAGE]] + 0.5 * h * gains[leaf, GAIN] * y
    return p + (y * capacity - p)


@inline
def _relaxation(c: Any, rho: Any, h: Any) -> Any:
    """The relaxation functions of a reducible storage with slope ``rho``; ``c`` keeps those of the latest slope."""
    one, two = c[ONE] + 0.0 * rho, c[TWO] + 0.0 * rho
    if rho.real != c[RHO]:
        one, two = relaxation(h * (rho + c[LEAK]) * c[STIFFNESS])
        c[RHO], c[ONE], c[TWO] = rho.real, one.real, two.real
    elif rho.imag != 0.0:
        one, two = relaxation(h * (rho + c[LEAK]) * c[STIFFNESS])
    return one, two


@inline
def _total(y: Any, context: Any, x: Any, ends: Any, means: Any) -> Any:
    """``F`` and the size of its terms; fills the end states and mean efforts."""
    t, theta, kinds, c, capacity, damping, drive, h, p, others, ratios = context
    change = 2.0 * (y * capacity - p)
    rate = 1.0 / h
    force = change * rate + damping * y - drive
    size = (abs(change.real) + abs(p)) * rate + abs(damping * y.real) + abs(drive)
    for other in range(others.shape[0]):
        r, ratio = others[other], ratios[other]
        q = _read(t, t[r, READ], y, capacity, c, kinds, x, h, p)
        lost = ratio * resistor_flow(t, r, ratio * y, q, theta)
        force += lost
        size += abs(lost.real)
    for leaf in range(kinds.shape[0]):
        gain = c[leaf, GAIN]
        if kinds[leaf, _RULE] == LOSSLESS:
            moved = h * gain * y
            end = x[kinds[leaf, _STORAGE]] + moved
            mean = c[leaf, STIFFNESS] * (x[kinds[leaf, _STORAGE]] + 0.5 * moved)
        elif kinds[leaf, _RULE] == _CURVED:
            start = x[kinds[leaf, _STORAGE]] + 0.0 * y
            end = start + h * gain * y
            mean = mean_effort(t, kinds[leaf, _STORAGE], start, end, theta)
        elif kinds[leaf, _RULE] == _FOLLOWING:
            r = kinds[leaf, _RESISTOR]
            q = _read(t, t[r, READ], y, capacity, c, kinds, x, h, p)
            rho, low, high = resistor_thresholds(t, r, q, theta)
            one, two = _relaxation(c[leaf], rho, h)
            end, mean = rc_flow(
                x[kinds[leaf, _STORAGE]], gain * y, h, c[leaf, STIFFNESS], rho, low, high, c[leaf, LEAK], one, two,
                c[leaf, LEAK_ONE], c[leaf, LEAK_TWO],
            )  # fmt: skip
        else:
            end, mean = rc_flow(
                x[kinds[leaf, _STORAGE]], gain * y, h, c[leaf, STIFFNESS], c[leaf, RHO], c[leaf, LOW], c[leaf, HIGH],
                c[leaf, LEAK], c[leaf, ONE], c[leaf, TWO], c[leaf, LEAK_ONE], c[leaf, LEAK_TWO],
            )  # fmt: skip
        ends[kinds[leaf, _STORAGE]] = end
        means[kinds[leaf, _STORAGE]] = mean
        force += gain * mean
        size += abs(gain * mean.real)
    return force, size


@inline
def _value_at(y: Any, context: Any) -> Any:
    (t, theta, _), step, x, ends, means, _, _ = context
    return _total(y, (t, theta, *step), x, ends, means)


@plain
def _slope_at(y: Any, context: Any) -> Any:
    stay_outside()
    (t, _, theta), step, x, _, _, ends, means = context
    return _total(complex(y, TINY), (t, theta, *step), x, ends, means)[0].imag / TINY


_root = inline(make_root(_value_at, _slope_at))


@plain
def _resolve(t: Any, theta: Any, h: Any, g: Any, constants: Any, kinds: Any, c: Any, others: Any, ratios: Any) -> Any:
    """Fill the constants of the reducible storages for steps of size ``h``; returns the junction's ``1/s`` and damping.

    Args:
        g: gains; constants: (L+1, 9) work array.
        kinds: (L, 3) filled with the rule and the number of every reducible storage, and the row of its first resistor.
        c: (L, 10) filled with its constants, see `phnn.integrate.constants`, and its ratio.
        others: (R,) rows of the junction's nonlinear resistors; ratios: (R,) filled with theirs.
    """
    stay_outside()
    leaves = count(t, LEAVES)
    fill_constants(t, theta, h, constants)
    for leaf in range(leaves):
        row = t[0, LEAVES] + leaf
        kinds[leaf, _RULE], kinds[leaf, _STORAGE], kinds[leaf, _RESISTOR] = (
            t[row, RULE],
            t[row, OWN_STORAGE],
            t[row, FIRST_RESISTOR],
        )
        for i in range(CONSTANTS):
            c[leaf, i] = constants[leaf, i]
        c[leaf, GAIN] = g[t[row, FIRST_LINK]]
        if t[row, RULE] == LOSSLESS and t[row, IS_LINEAR] <= 0:
            kinds[leaf, _RULE] = _CURVED
        if t[row, RULE] == EXACT and t[t[row, FIRST_RESISTOR], READ] >= 0:
            kinds[leaf, _RULE] = _FOLLOWING
            c[leaf, RHO] = np.nan
    damping, other = 0.0, 0
    for r in range(t[0, JUNCTION_RESISTORS], t[0, JUNCTION_RESISTORS + 1]):
        b = 0.0
        for branch in range(t[r, FIRST_BRANCH], t[r, LAST_BRANCH]):
            b += g[branch]
        if other < others.shape[0] and others[other] == r:
            ratios[other] = b
            other += 1
        else:
            damping += b * b * resistor_flow(t, r, 1.0, 0.0, theta)
    return constants[leaves, CAPACITY], damping


@plain
def _scale(t: Any, theta: Any, x: Any, g: Any, scaled: Any, c: Any) -> None:
    """Set the ratios in some rows to their modulated values, also in the constants of the reducible storages."""
    stay_outside()
    for place in range(scaled.shape[0]):
        r = scaled[place]
        g[r] = t[r, SIGN] * theta[t[r, RATIO]]
    for f in range(t[0, FACTORS], t[0, FACTORS + 1]):
        by = factor(t, f, x[t[t[f, READ], READ_MODULATOR]], theta)
        for place in range(scaled.shape[0]):
            r = scaled[place]
            if t[r, RATIO] == t[f, RATIO_PLACE]:
                g[r] *= by
    for leaf in range(c.shape[0]):
        c[leaf, GAIN] = g[t[t[0, LEAVES] + leaf, FIRST_LINK]]


@plain
def _advance_modulators(
    t: Any, theta: Any, c: Any, g: Any, a: Any, x: Any, next_x: Any, means: Any, h: Any, y: Any, wj: Any, wx: Any
) -> None:  # fmt: skip
    """Advance the modulator states (`phnn.integrate.modulator_states`); ``y`` (1,), ``wj``, ``wx`` are work arrays."""
    stay_outside()
    storages = count(t, STORAGES)
    y[0] = means[junction_storage(t, 0)]
    wj[FLOW, 0] = y[0]
    for k in range(storages):
        wx[NEXT, k], wx[EFFORT, k] = next_x[k], means[k]
    advance(t, Step(theta, c, g, a, x, y, h, wj), wx)
    for k in range(storages, x.shape[0]):
        next_x[k], means[k] = wx[NEXT, k], wx[EFFORT, k]


def _steps(
    t: Any, theta: Any, actions: Any, h: Any, states: Any, efforts: Any, g: Any, constants: Any, kinds: Any, c: Any,
    perturbed: Any, ends: Any, means: Any, others: Any, ratios: Any, slow: Any,
    scaled: Any,
) -> Any:  # fmt: skip
    """Integrate; the last arguments are work arrays: ``perturbed`` is theta in complex numbers."""
    fill_gains(t, theta, g)
    k, remembers = junction_storage(t, 0), count(t, MODULATOR_STATES) > 0
    slope, capacity, damping = 0.0, 0.0, 0.0
    for n in range(actions.shape[0]):
        if n == 0 or h[n] != h[n - 1]:
            capacity, damping = _resolve(t, theta, h[n], g, constants, kinds, c, others, ratios)
            slope = 0.0
        if count(t, FACTORS) > 0:
            _scale(t, theta, states[n], g, scaled, c)
        drive = 0.0
        for r in range(t[0, JUNCTION_INLETS], t[0, JUNCTION_INLETS + 1]):
            drive += g[r] * actions[n, t[r, FROM_PORT]]
        p = states[n, k]
        y = extrapolated(efforts, n, k) if n > 0 else p / capacity
        step = (kinds, c, capacity, damping, drive, h[n], p, others, ratios)
        around = ((t, theta, perturbed), step, states[n], states[n + 1], efforts[n], ends, means)
        y, slope = _root(y, 2.0 * capacity / h[n], slope, around)
        efforts[n, k] = y
        states[n + 1, k] = p + 2.0 * (y * capacity - p)
        if remembers:
            _advance_modulators(
                t, theta, constants, g, actions[n], states[n], states[n + 1], efforts[n], h[n], slow[0], slow[1],
                slow[2],
            )  # fmt: skip
        if not np.isfinite(y):
            return n
    return actions.shape[0]


_compiled = loop_entry(_steps)


def march(program: Program, theta: Array, actions: Array, h: Array, states: Array, efforts: Array) -> int:
    """`phnn.integrate.kernel.Kernel.march` of the networks that this kernel serves."""
    t = program.table
    leaves, ends = len(rows_of(t, LEAVES)), np.zeros(states.shape[1], np.complex128)
    memory = (np.zeros(len(t)), np.zeros((leaves + 1, CONSTANTS)), np.zeros((leaves, 3), np.int64))
    own = (*memory, np.zeros((leaves, CONSTANTS + 1)), theta.astype(np.complex128), ends, np.zeros_like(ends))
    linear = np.isin(rows_of(t, JUNCTION_RESISTORS)[:, LAW], LINEAR_RESISTOR_CODES)
    others = t[0, JUNCTION_RESISTORS] + np.flatnonzero(~linear)
    slow = (np.zeros(1), np.zeros((4, 1)), np.zeros((2, states.shape[1])))
    scaled = np.array(program.sparsity.scaled, dtype=np.int64)
    return int(_compiled(t, theta, actions, h, states, efforts, *own, others, np.zeros(others.size), slow, scaled))
