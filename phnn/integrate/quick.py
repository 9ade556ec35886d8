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

from phnn.integrate import program as at
from phnn.integrate.cache import inline, loop_entry, plain, stay_outside
from phnn.integrate.program import Program, has_one_link, rows_of
from phnn.integrate.roots import extrapolated, make_root
from phnn.integrate.scheme import EXACT, LINEAR_RESISTOR_CODES, LOSSLESS
from phnn.integrate.step import (
    CAPACITY,
    CONSTANTS,
    EFFORT,
    FLOW,
    HIGH,
    LEAK,
    LOW,
    NEXT,
    ONE,
    RHO,
    STIFFNESS,
    TWO,
    Step,
    advance,
    branches,
    count,
    exact_flow,
    fill_constants,
    fill_gains,
    junction_storage,
    mean_effort,
    modulate,
    resistor_flow,
    resistor_thresholds,
    rows,
)
from phnn.laws.leaf import relaxation
from phnn.laws.namespace import TINY

# Columns of ``kinds``: rule and number of a reducible storage, the rows of its first resistor and of its only link.
RULE_OF, STORAGE_OF, RESISTOR_OF, LINK_OF = range(4)
# In addition to the rules of the table: a lossless storage with a nonlinear law, a storage with modulated thresholds.
CURVED, FOLLOWING = -1, -2


class Fixed(NamedTuple):
    """What a step knows before its unknown is found.

    Attributes:
        kinds: (L, 4) see above; c: (L+1, 9) constants, see `phnn.integrate.step.fill_constants`; g: (R,) ratios.
        others: (R,) rows of the junction's nonlinear resistors; ratios: (R,) theirs.
        capacity, damping: ``1/s`` of the junction and the sum of its linear resistors; drive: its inlets.
        h, p: size of the step and the junction's state at its start.
    """

    kinds: Any
    c: Any
    g: Any
    others: Any
    ratios: Any
    capacity: Any
    damping: Any
    drive: Any
    h: Any
    p: Any


@inline
def _read(t: Any, r: Any, y: Any, of: Fixed, x: Any) -> Any:
    """`phnn.integrate.step.read`."""
    if r < 0:
        return 0.0 * y
    leaf = t[r, at.READ_LEAF]
    if t[r, at.READ_MODULATOR] >= 0:
        return x[t[r, at.READ_MODULATOR]] + 0.0 * y
    if leaf >= 0:
        return x[of.kinds[leaf, STORAGE_OF]] + 0.5 * of.h * of.g[of.kinds[leaf, LINK_OF]] * y
    return of.p + (y * of.capacity - of.p)


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
def _total(y: Any, t: Any, theta: Any, of: Fixed, x: Any, ends: Any, means: Any) -> Any:
    """Return ``F`` and the size of its terms; fills the end states and mean efforts."""
    kinds, h, p = of.kinds, of.h, of.p
    change = 2.0 * (y * of.capacity - p)
    rate = 1.0 / h
    force = change * rate + of.damping * y - of.drive
    size = (abs(change.real) + abs(p)) * rate + abs(of.damping * y.real) + abs(of.drive)
    for other in range(of.others.shape[0]):
        r, ratio = of.others[other], of.ratios[other]
        q = _read(t, t[r, at.READ], y, of, x)
        lost = ratio * resistor_flow(t, r, ratio * y, q, theta)
        force += lost
        size += abs(lost.real)
    for leaf in range(kinds.shape[0]):
        gain, c, k, rule = of.g[kinds[leaf, LINK_OF]], of.c[leaf], kinds[leaf, STORAGE_OF], kinds[leaf, RULE_OF]
        if rule == LOSSLESS:
            moved = h * gain * y
            end = x[k] + moved
            mean = c[STIFFNESS] * (x[k] + 0.5 * moved)
        elif rule == CURVED:
            start = x[k] + 0.0 * y
            end = start + h * gain * y
            mean = mean_effort(t, k, start, end, theta)
        elif rule == FOLLOWING:
            r = kinds[leaf, RESISTOR_OF]
            rho, low, high = resistor_thresholds(t, r, _read(t, t[r, at.READ], y, of, x), theta)
            one, two = _relaxation(c, rho, h)
            end, mean = exact_flow(x[k], gain * y, h, c, (rho, low, high, one, two))
        else:
            end, mean = exact_flow(x[k], gain * y, h, c, (c[RHO], c[LOW], c[HIGH], c[ONE], c[TWO]))
        ends[k] = end
        means[k] = mean
        force += gain * mean
        size += abs(gain * mean.real)
    return force, size


@inline
def _value_at(y: Any, context: Any) -> Any:
    t, theta, _, of, x, ends, means, _, _ = context
    return _total(y, t, theta, of, x, ends, means)


@plain
def _slope_at(y: Any, context: Any) -> Any:
    stay_outside()
    t, _, theta, of, x, _, _, ends, means = context
    return _total(complex(y, TINY), t, theta, of, x, ends, means)[0].imag / TINY


root = inline(make_root(_value_at, _slope_at))


Array = NDArray[np.float64]


@lru_cache(maxsize=512)
def serves(program: Program) -> bool:
    """Return whether the steps of a program have the form above."""
    t = program.table
    junctions, leaves = rows_of(t, at.JUNCTIONS), rows_of(t, at.LEAVES)
    if len(junctions) != 1 or not junctions[0, at.IS_LINEAR] or len(rows_of(t, at.GYRATORS)):
        return False
    closed = np.isin(leaves[:, at.RULE], (LOSSLESS, EXACT))
    scalable = [row for kind in (at.LINKS, at.JUNCTION_INLETS) for row in range(t[0, kind], t[0, kind + 1])]
    slow = t[rows_of(t, at.FACTORS)[:, at.READ], at.READ_MODULATOR] >= 0
    return bool((has_one_link(t) & closed).all() and slow.all()) and set(rows_of(t, at.SCALED)[:, 0]) <= set(scalable)


@plain
def _resolve(t: Any, step: Step, of: Fixed) -> Any:
    """Fill what is constant in steps of one size; returns the junction's ``1/s`` and damping."""
    stay_outside()
    theta, c, g, kinds = step.theta, step.c, step.g, of.kinds
    leaves = count(t, at.LEAVES)
    fill_constants(t, theta, step.h, c)
    for leaf in range(leaves):
        row = t[0, at.LEAVES] + leaf
        kinds[leaf, RULE_OF], kinds[leaf, STORAGE_OF] = t[row, at.RULE], t[row, at.OWN_STORAGE]
        kinds[leaf, RESISTOR_OF], kinds[leaf, LINK_OF] = t[row, at.FIRST_RESISTOR], t[row, at.FIRST_LINK]
        if t[row, at.RULE] == LOSSLESS and t[row, at.IS_LINEAR] <= 0:
            kinds[leaf, RULE_OF] = CURVED
        if t[row, at.RULE] == EXACT and t[t[row, at.FIRST_RESISTOR], at.READ] >= 0:
            kinds[leaf, RULE_OF] = FOLLOWING
            c[leaf, RHO] = np.nan
    damping, other = 0.0, 0
    for r in rows(t, at.JUNCTION_RESISTORS):
        b = 0.0
        for branch in branches(t, r):
            b += g[branch]
        if other < of.others.shape[0] and of.others[other] == r:
            of.ratios[other] = b
            other += 1
        else:
            damping += b * b * resistor_flow(t, r, 1.0, 0.0, theta)
    return c[leaves, CAPACITY], damping


@plain
def _advance_modulators(t: Any, step: Step, next_x: Any, means: Any) -> None:
    """Advance the modulator states of a solved step; the arrays of the step are filled."""
    stay_outside()
    storages, wx = count(t, at.STORAGES), step.wx
    step.y[0] = means[junction_storage(t, 0)]
    step.wj[FLOW, 0] = step.y[0]
    for k in range(storages):
        wx[NEXT, k], wx[EFFORT, k] = next_x[k], means[k]
    advance(t, step)
    for k in range(storages, step.x.shape[0]):
        next_x[k], means[k] = wx[NEXT, k], wx[EFFORT, k]


@loop_entry
def _steps(t: Any, actions: Any, h: Any, states: Any, efforts: Any, work: Step, fixed: Fixed, perturbed: Any) -> Any:
    """Integrate; the arrays of ``work`` and ``fixed`` are filled, ``perturbed`` are complex parameters and states."""
    theta, c, g = work.theta, work.c, work.g
    moved_theta, moved_ends, moved_means = perturbed
    kinds, others, ratios = fixed.kinds, fixed.others, fixed.ratios
    fill_gains(t, theta, g)
    k, slope, capacity, damping = junction_storage(t, 0), 0.0, 0.0, 0.0
    for n in range(actions.shape[0]):
        step = Step(theta, c, g, actions[n], states[n], work.y, h[n], work.wj, work.wx)
        if n == 0 or h[n] != h[n - 1]:
            capacity, damping = _resolve(t, step, fixed)
            slope = 0.0
        if count(t, at.FACTORS) > 0:
            modulate(t, step)
        drive = 0.0
        for r in rows(t, at.JUNCTION_INLETS):
            drive += g[r] * actions[n, t[r, at.FROM_PORT]]
        p = states[n, k]
        y = extrapolated(efforts, n, k) if n > 0 else p / capacity
        of = Fixed(kinds, c, g, others, ratios, capacity, damping, drive, h[n], p)
        around = (t, theta, moved_theta, of, states[n], states[n + 1], efforts[n], moved_ends, moved_means)
        y, slope = root(y, 2.0 * capacity / h[n], slope, around)
        efforts[n, k] = y
        states[n + 1, k] = p + 2.0 * (y * capacity - p)
        if count(t, at.MODULATOR_STATES) > 0:
            _advance_modulators(t, step, states[n + 1], efforts[n])
        if not np.isfinite(y):
            return n
    return actions.shape[0]


def march(program: Program, theta: Array, actions: Array, h: Array, states: Array, efforts: Array) -> int:
    """`phnn.integrate.kernel.march_any` of the programs that this kernel serves."""
    t, n = program.table, states.shape[1]
    leaves, none = len(rows_of(t, at.LEAVES)), np.zeros(0)
    c, g, y, wj, wx = (np.zeros(shape) for shape in ((leaves + 1, CONSTANTS), len(t), 1, (4, 1), (2, n)))
    linear = np.isin(rows_of(t, at.JUNCTION_RESISTORS)[:, at.LAW], LINEAR_RESISTOR_CODES)
    others = t[0, at.JUNCTION_RESISTORS] + np.flatnonzero(~linear)
    fixed = Fixed(np.zeros((leaves, 4), np.int64), c, g, others, np.zeros(others.size), 0.0, 0.0, 0.0, 0.0, 0.0)
    perturbed = (theta.astype(np.complex128), np.zeros(n, np.complex128), np.zeros(n, np.complex128))
    step = Step(theta, c, g, none, none, y, 0.0, wj, wx)
    return int(_steps(t, actions, h, states, efforts, step, fixed, perturbed))
