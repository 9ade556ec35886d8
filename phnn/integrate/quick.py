"""The march of the commonest networks with everything resolved beforehand: the same steps at a fraction of the price.

One linear junction; leaves that hang on it through one ratio each and are lossless, or have an exact flow; resistors
and inlets on the junction. Ratios of leaves and inlets may follow memories. Then a step is

    F(v̄) = (2/h)(v̄/s − p) + d v̄ + Σ_r b_r φ_r(b_r v̄) + Σ_l a_l ē_l(a_l v̄) − Σ_p g_p ψ_p(ū_p)

with constants for nearly everything but the states, ``d`` of all linear resistors. `phnn.integrate.step` holds the
equations in general.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.arguments import March, Step
from phnn.integrate.compiled import inline, loop_entry, plain, stay_outside
from phnn.integrate.constants import (
    CONSTANTS,
    LEAK,
    LEAK_ONE,
    LEAK_TWO,
    ONE,
    RHO,
    STIFFNESS,
    TWO,
    branch_of,
    fill_gains,
    relaxed_of,
)
from phnn.integrate.lookups import (
    count,
    junction_storage,
    mean_effort,
    resistor_flow,
    resistor_thresholds,
)
from phnn.integrate.memories import advance
from phnn.integrate.partition import LINEAR_RESISTOR_CODES
from phnn.integrate.program import Program
from phnn.integrate.resolved import CURVED, FOLLOWING, GAIN, KIND, RESISTOR, STORAGE, Leaves, Memory, resolve, scale
from phnn.integrate.roots import extrapolated, make_root
from phnn.integrate.tables import (
    EXACT,
    FACTORS,
    FIRST_INLET,
    FIRST_LINK,
    FROM_PORT,
    GYRATORS,
    IS_LINEAR,
    JUNCTION_INLETS,
    JUNCTION_RESISTORS,
    JUNCTIONS,
    LAST_INLET,
    LAST_LINK,
    LAW,
    LEAVES,
    LINKS,
    LOSSLESS,
    MEMORIES,
    READ,
    READ_LEAF,
    READ_MEMORY,
    RULE,
    STORAGES,
    rows_of,
)
from phnn.integrate.terms import EFFORT, FLOW, NEXT
from phnn.laws.leaf import Branch, Relaxed, rc_flow, relaxation
from phnn.laws.namespace import TINY

Array = NDArray[np.float64]


class _Junction(NamedTuple):
    """The junction in one step: ``1/s``, ``d``, the drive ``Σ g ψ``, the step's size ``h`` and the state ``p``."""

    capacity: Any
    damping: Any
    drive: Any
    h: Any
    p: Any


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
    slow = t[rows_of(t, FACTORS)[:, READ], READ_MEMORY] >= 0
    return bool((single & closed).all() and slow.all()) and set(program.uses.scaled) <= set(scalable)


@inline
def _read(t: Any, r: Any, y: Any, leaves: Any, junction: Any, x: Any) -> Any:
    """`phnn.integrate.terms.read`."""
    if r < 0:
        return 0.0 * y
    leaf = t[r, READ_LEAF]
    if t[r, READ_MEMORY] >= 0:
        return x[t[r, READ_MEMORY]] + 0.0 * y
    if leaf >= 0:
        return x[leaves.kinds[leaf, STORAGE]] + 0.5 * junction.h * leaves.c[leaf, GAIN] * y
    return junction.p + (y * junction.capacity - junction.p)


@inline
def _relaxation(c: Any, rho: Any, h: Any) -> Any:
    """That of a leaf with slope ``rho``; the one of the slope before is kept in its constants ``c``."""
    one, two = c[ONE] + 0.0 * rho, c[TWO] + 0.0 * rho
    if rho.real != c[RHO]:
        one, two = relaxation(h * (rho + c[LEAK]) * c[STIFFNESS])
        c[RHO], c[ONE], c[TWO] = rho.real, one.real, two.real
    elif rho.imag != 0.0:
        one, two = relaxation(h * (rho + c[LEAK]) * c[STIFFNESS])
    return one, two


@inline
def _total(y: Any, context: Any, x: Any, ends: Any, means: Any) -> Any:
    """``F``, the size of its terms, and what the step leads to."""
    t, theta, leaves, junction = context
    kinds, c, others, ratios = leaves
    capacity, damping, drive, h, p = junction
    change = 2.0 * (y * capacity - p)
    rate = 1.0 / h
    force = change * rate + damping * y - drive
    size = (abs(change.real) + abs(p)) * rate + abs(damping * y.real) + abs(drive)
    for other in range(others.shape[0]):
        r, ratio = others[other], ratios[other]
        q = _read(t, t[r, READ], y, leaves, junction, x)
        lost = ratio * resistor_flow(t, r, ratio * y, q, theta)
        force += lost
        size += abs(lost.real)
    for leaf in range(kinds.shape[0]):
        gain = c[leaf, GAIN]
        if kinds[leaf, KIND] == LOSSLESS:
            moved = h * gain * y
            end = x[kinds[leaf, STORAGE]] + moved
            mean = c[leaf, STIFFNESS] * (x[kinds[leaf, STORAGE]] + 0.5 * moved)
        elif kinds[leaf, KIND] == CURVED:
            start = x[kinds[leaf, STORAGE]] + 0.0 * y
            end = start + h * gain * y
            mean = mean_effort(t, kinds[leaf, STORAGE], start, end, theta)
        elif kinds[leaf, KIND] == FOLLOWING:
            r = kinds[leaf, RESISTOR]
            q = _read(t, t[r, READ], y, leaves, junction, x)
            rho, low, high = resistor_thresholds(t, r, q, theta)
            one, two = _relaxation(c[leaf], rho, h)
            branch = Branch(c[leaf, STIFFNESS], rho, low, high, c[leaf, LEAK])
            relaxed = Relaxed(one, two, c[leaf, LEAK_ONE], c[leaf, LEAK_TWO])
            end, mean = rc_flow(x[kinds[leaf, STORAGE]], gain * y, h, branch, relaxed)
        else:
            end, mean = rc_flow(x[kinds[leaf, STORAGE]], gain * y, h, branch_of(c[leaf]), relaxed_of(c[leaf]))
        ends[kinds[leaf, STORAGE]] = end
        means[kinds[leaf, STORAGE]] = mean
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


@inline
def _remember(s: Any, wx: Any, next_x: Any, means: Any) -> None:
    """Advance the memories at the end of a step to ``next_x``, see `phnn.integrate.memories`."""
    storages = count(s.t, STORAGES)
    s.y[0] = means[junction_storage(s.t, 0)]
    s.wj[FLOW, 0] = s.y[0]
    for k in range(storages):
        wx[NEXT, k], wx[EFFORT, k] = next_x[k], means[k]
    advance(s, wx)
    for k in range(storages, next_x.shape[0]):
        next_x[k], means[k] = wx[NEXT, k], wx[EFFORT, k]


def _steps(run: Any, theta: Any, memory: Any) -> Any:
    """March; ``theta`` (M,) are the parameters."""
    t, actions, h, states, efforts = run
    g, leaves = memory.g, memory.leaves
    fill_gains(t, theta, g)
    k, remembers = junction_storage(t, 0), count(t, MEMORIES) > 0
    slope, capacity, damping = 0.0, 0.0, 0.0
    for n in range(actions.shape[0]):
        if n == 0 or h[n] != h[n - 1]:
            capacity, damping = resolve(t, theta, h[n], memory)
            slope = 0.0
        if count(t, FACTORS) > 0:
            scale(t, theta, states[n], g, memory.scaled, leaves.c)
        drive = 0.0
        for r in range(t[0, JUNCTION_INLETS], t[0, JUNCTION_INLETS + 1]):
            drive += g[r] * actions[n, t[r, FROM_PORT]]
        p = states[n, k]
        y = extrapolated(efforts, n, k) if n > 0 else p / capacity
        step = (leaves, _Junction(capacity, damping, drive, h[n], p))
        around = ((t, theta, memory.perturbed), step, states[n], states[n + 1], efforts[n], memory.ends, memory.means)
        y, slope = _root(y, 2.0 * capacity / h[n], slope, around)
        efforts[n, k] = y
        states[n + 1, k] = p + 2.0 * (y * capacity - p)
        if remembers:
            here = Step(t, theta, memory.constants, g, actions[n], states[n], memory.y, h[n], memory.wj)
            _remember(here, memory.wx, states[n + 1], efforts[n])
        if not np.isfinite(y):
            return n
    return actions.shape[0]


_compiled = loop_entry(_steps)


def march(program: Program, theta: Array, actions: Array, h: Array, states: Array, efforts: Array) -> int:
    """`phnn.integrate.kernel.Kernel.march` of the networks that it serves."""
    t = program.table
    size, ends = len(rows_of(t, LEAVES)), np.zeros(states.shape[1], np.complex128)
    linear = np.isin(rows_of(t, JUNCTION_RESISTORS)[:, LAW], LINEAR_RESISTOR_CODES)
    others = t[0, JUNCTION_RESISTORS] + np.flatnonzero(~linear)
    leaves = Leaves(np.zeros((size, 3), np.int64), np.zeros((size, CONSTANTS + 1)), others, np.zeros(others.size))
    memory = Memory(
        np.zeros(len(t)), np.zeros((size + 1, CONSTANTS)), leaves, theta.astype(np.complex128), ends,
        np.zeros_like(ends), np.zeros(1), np.zeros((4, 1)), np.zeros((2, states.shape[1])),
        np.array(program.uses.scaled, dtype=np.int64),
    )  # fmt: skip
    return int(_compiled(March(t, actions, h, states, efforts), theta, memory))
