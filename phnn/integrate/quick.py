"""The compiled integration of networks with a single linear junction: the same steps, several times faster.

The reducible storages are coupled to the junction through one ratio each; they are lossless or have an exact flow.
Resistors and inlets act on the junction. Ratios of storages and inlets may follow modulator states. Then a step is

    F(v̄) = (2/h)(v̄/s − p) + d v̄ + Σ_r b_r φ_r(b_r v̄) + Σ_l a_l ē_l(a_l v̄) − Σ_p g_p ψ_p(ū_p)

with the damping ``d`` of all linear resistors. Except for the states, nearly every term is a constant that is computed
once. `phnn.integrate.step` has the equations in general.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.cache import inline, loop_entry, plain, stay_outside
from phnn.integrate.program import (
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
    Program,
    rows_of,
)
from phnn.integrate.roots import extrapolated, make_root
from phnn.integrate.scheme import EXACT, LINEAR_RESISTOR_CODES, LOSSLESS
from phnn.integrate.step import (
    CAPACITY,
    CONSTANTS,
    EFFORT,
    FLOW,
    HIGH,
    LEAK,
    LEAK_ONE,
    LEAK_TWO,
    LOW,
    NEXT,
    ONE,
    RHO,
    STIFFNESS,
    TWO,
    Step,
    advance,
    count,
    factor,
    fill_constants,
    fill_gains,
    junction_storage,
    mean_effort,
    resistor_flow,
    resistor_thresholds,
)
from phnn.laws.leaf import rc_flow, relaxation
from phnn.laws.namespace import TINY

# Column of the ratio of a reducible storage, after its constants.
GAIN = CONSTANTS
# Columns of ``kinds``.
RULE_OF, STORAGE_OF, RESISTOR_OF = range(3)
# In addition to the rules of the table: a lossless storage with a nonlinear law, a storage with modulated thresholds.
CURVED, FOLLOWING = -1, -2


@inline
def _read(r: Any, y: Any, context: Any, x: Any) -> Any:
    """`phnn.integrate.step.read`."""
    t, _, kinds, c, capacity, _, _, h, p, _, _ = context
    if r < 0:
        return 0.0 * y
    leaf = t[r, READ_LEAF]
    if t[r, READ_MODULATOR] >= 0:
        return x[t[r, READ_MODULATOR]] + 0.0 * y
    if leaf >= 0:
        return x[kinds[leaf, STORAGE_OF]] + 0.5 * h * c[leaf, GAIN] * y
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
    """Return ``F`` and the size of its terms; fills the end states and mean efforts."""
    t, theta, kinds, c, capacity, damping, drive, h, p, others, ratios = context
    change = 2.0 * (y * capacity - p)
    rate = 1.0 / h
    force = change * rate + damping * y - drive
    size = (abs(change.real) + abs(p)) * rate + abs(damping * y.real) + abs(drive)
    for other in range(others.shape[0]):
        r, ratio = others[other], ratios[other]
        q = _read(t[r, READ], y, context, x)
        lost = ratio * resistor_flow(t, r, ratio * y, q, theta)
        force += lost
        size += abs(lost.real)
    for leaf in range(kinds.shape[0]):
        gain = c[leaf, GAIN]
        if kinds[leaf, RULE_OF] == LOSSLESS:
            moved = h * gain * y
            end = x[kinds[leaf, STORAGE_OF]] + moved
            mean = c[leaf, STIFFNESS] * (x[kinds[leaf, STORAGE_OF]] + 0.5 * moved)
        elif kinds[leaf, RULE_OF] == CURVED:
            start = x[kinds[leaf, STORAGE_OF]] + 0.0 * y
            end = start + h * gain * y
            mean = mean_effort(t, kinds[leaf, STORAGE_OF], start, end, theta)
        elif kinds[leaf, RULE_OF] == FOLLOWING:
            r = kinds[leaf, RESISTOR_OF]
            q = _read(t[r, READ], y, context, x)
            rho, low, high = resistor_thresholds(t, r, q, theta)
            one, two = _relaxation(c[leaf], rho, h)
            end, mean = rc_flow(
                x[kinds[leaf, STORAGE_OF]], gain * y, h, c[leaf, STIFFNESS], rho, low, high, c[leaf, LEAK], one, two,
                c[leaf, LEAK_ONE], c[leaf, LEAK_TWO],
            )  # fmt: skip
        else:
            end, mean = rc_flow(
                x[kinds[leaf, STORAGE_OF]], gain * y, h, c[leaf, STIFFNESS], c[leaf, RHO], c[leaf, LOW], c[leaf, HIGH],
                c[leaf, LEAK], c[leaf, ONE], c[leaf, TWO], c[leaf, LEAK_ONE], c[leaf, LEAK_TWO],
            )  # fmt: skip
        ends[kinds[leaf, STORAGE_OF]] = end
        means[kinds[leaf, STORAGE_OF]] = mean
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


root = inline(make_root(_value_at, _slope_at))


Array = NDArray[np.float64]


class Work(NamedTuple):
    """Work arrays of an integration.

    Attributes:
        gains: (R,); constants: (L+1, 9), see `phnn.integrate.step.fill_constants`.
        kinds: (L, 3) rule and number of every reducible storage, and the row of its first resistor.
        c: (L, 10) its constants and its ratio.
        perturbed: (M,) parameters in complex numbers; ends, means: (N,) end states and mean efforts likewise.
        others: (R,) rows of the junction's nonlinear resistors; ratios: (R,) theirs.
        slow: unknown (1,), junction (4, 1) and states (2, N) of the modulator states.
        scaled: rows with a modulated ratio.
    """

    gains: Any
    constants: Any
    kinds: Any
    c: Any
    perturbed: Any
    ends: Any
    means: Any
    others: Any
    ratios: Any
    slow: Any
    scaled: Any


@lru_cache(maxsize=512)
def serves(program: Program) -> bool:
    """Return whether the steps of a program have the form above."""
    t = program.table
    junctions, leaves = rows_of(t, JUNCTIONS), rows_of(t, LEAVES)
    if len(junctions) != 1 or not junctions[0, IS_LINEAR] or len(rows_of(t, GYRATORS)):
        return False
    single = (leaves[:, LAST_LINK] - leaves[:, FIRST_LINK] == 1) & (leaves[:, LAST_INLET] == leaves[:, FIRST_INLET])
    closed = np.isin(leaves[:, RULE], (LOSSLESS, EXACT))
    scalable = [row for kind in (LINKS, JUNCTION_INLETS) for row in range(t[0, kind], t[0, kind + 1])]
    slow = t[rows_of(t, FACTORS)[:, READ], READ_MODULATOR] >= 0
    return bool((single & closed).all() and slow.all()) and set(program.sparsity.scaled) <= set(scalable)


@plain
def _resolve(t: Any, theta: Any, h: Any, work: Work) -> Any:
    """Fill what is constant in steps of size ``h``; returns the junction's ``1/s`` and damping."""
    stay_outside()
    g, constants, kinds, c, others, ratios = (
        work.gains, work.constants, work.kinds, work.c, work.others, work.ratios
    )  # fmt: skip
    leaves = count(t, LEAVES)
    fill_constants(t, theta, h, constants)
    for leaf in range(leaves):
        row = t[0, LEAVES] + leaf
        kinds[leaf, RULE_OF], kinds[leaf, STORAGE_OF], kinds[leaf, RESISTOR_OF] = (
            t[row, RULE],
            t[row, OWN_STORAGE],
            t[row, FIRST_RESISTOR],
        )
        for i in range(CONSTANTS):
            c[leaf, i] = constants[leaf, i]
        c[leaf, GAIN] = g[t[row, FIRST_LINK]]
        if t[row, RULE] == LOSSLESS and t[row, IS_LINEAR] <= 0:
            kinds[leaf, RULE_OF] = CURVED
        if t[row, RULE] == EXACT and t[t[row, FIRST_RESISTOR], READ] >= 0:
            kinds[leaf, RULE_OF] = FOLLOWING
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
def _advance_modulators(t: Any, step: Step, next_x: Any, means: Any, wx: Any) -> None:
    """Advance the modulator states; unknown, ``wj`` and ``wx`` are filled."""
    stay_outside()
    storages, x, y, wj = count(t, STORAGES), step.x, step.y, step.wj
    y[0] = means[junction_storage(t, 0)]
    wj[FLOW, 0] = y[0]
    for k in range(storages):
        wx[NEXT, k], wx[EFFORT, k] = next_x[k], means[k]
    advance(t, step, wx)
    for k in range(storages, x.shape[0]):
        next_x[k], means[k] = wx[NEXT, k], wx[EFFORT, k]


@loop_entry
def _steps(t: Any, theta: Any, actions: Any, h: Any, states: Any, efforts: Any, work: Work) -> Any:
    """Integrate."""
    g, constants, kinds, c, perturbed, ends, means, others, ratios, slow, scaled = work
    fill_gains(t, theta, g)
    k, remembers = junction_storage(t, 0), count(t, MODULATOR_STATES) > 0
    slope, capacity, damping = 0.0, 0.0, 0.0
    for n in range(actions.shape[0]):
        if n == 0 or h[n] != h[n - 1]:
            capacity, damping = _resolve(t, theta, h[n], work)
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
        y, slope = root(y, 2.0 * capacity / h[n], slope, around)
        efforts[n, k] = y
        states[n + 1, k] = p + 2.0 * (y * capacity - p)
        if remembers:
            whole = Step(theta, constants, g, actions[n], states[n], slow[0], h[n], slow[1])
            _advance_modulators(t, whole, states[n + 1], efforts[n], slow[2])
        if not np.isfinite(y):
            return n
    return actions.shape[0]


def march(program: Program, theta: Array, actions: Array, h: Array, states: Array, efforts: Array) -> int:
    """`phnn.integrate.kernel.march_any` of the programs that this kernel serves."""
    t = program.table
    leaves, ends = len(rows_of(t, LEAVES)), np.zeros(states.shape[1], np.complex128)
    memory = (np.zeros(len(t)), np.zeros((leaves + 1, CONSTANTS)), np.zeros((leaves, 3), np.int64))
    own = (*memory, np.zeros((leaves, CONSTANTS + 1)), theta.astype(np.complex128), ends, np.zeros_like(ends))
    linear = np.isin(rows_of(t, JUNCTION_RESISTORS)[:, LAW], LINEAR_RESISTOR_CODES)
    others = t[0, JUNCTION_RESISTORS] + np.flatnonzero(~linear)
    slow = (np.zeros(1), np.zeros((4, 1)), np.zeros((2, states.shape[1])))
    scaled = np.array(program.sparsity.scaled, dtype=np.int64)
    work = Work(*own, others, np.zeros(others.size), slow, scaled)
    return int(_steps(t, theta, actions, h, states, efforts, work))
