"""The march of the commonest networks with everything resolved beforehand: the same steps at a fraction of the price.

One linear junction; leaves that hang on it through one ratio each and are lossless, or have an exact flow whose
thresholds follow no state; linear resistors on the junction. Then a step is

    F(v̄) = (2/h)(v̄/s − p) + d v̄ + Σ_l a_l ē_l(a_l v̄) − Σ_p g_p ψ_p(ū_p)

with constants for everything but the states. `phnn.integrate.step` holds the equations in general.
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
from phnn.integrate.lookups import count, junction_storage, mean_effort, resistor_flow
from phnn.integrate.program import Program
from phnn.integrate.roots import extrapolated, make_root
from phnn.integrate.tables import (
    EXACT,
    FACTORS,
    GYRATORS,
    JUNCTION_INLETS,
    JUNCTION_RESISTORS,
    JUNCTIONS,
    LEAF_RESISTORS,
    LEAVES,
    LOSSLESS,
    MEMORIES,
    rows_of,
)
from phnn.laws import RESISTOR_LAWS
from phnn.laws.leaf import rc_flow
from phnn.laws.namespace import TINY

Array = NDArray[np.float64]

GAIN = CONSTANTS
# The rule of a lossless leaf whose law is not linear, beside those of the table.
CURVED = -1
# Linear resistors, whose conductance is their flow at one.
_LINEAR = [code for code, name in enumerate(RESISTOR_LAWS) if name == "linear"]
# What a network of this form has none of.
_OTHERS = (FACTORS, GYRATORS, MEMORIES)


@lru_cache(maxsize=512)
def serves(program: Program) -> bool:
    """Whether the steps of a program have the form above."""
    t = program.table
    junctions, leaves = rows_of(t, JUNCTIONS), rows_of(t, LEAVES)
    if len(junctions) != 1 or not junctions[0, 1] or any(len(rows_of(t, kind)) for kind in _OTHERS):
        return False
    if not np.isin(rows_of(t, JUNCTION_RESISTORS)[:, 0], _LINEAR).all():
        return False
    single = (leaves[:, 6] - leaves[:, 5] == 1) & (leaves[:, 8] == leaves[:, 7])
    closed = np.isin(leaves[:, 1], (LOSSLESS, EXACT))
    return bool((single & closed).all()) and bool((rows_of(t, LEAF_RESISTORS)[:, 5] < 0).all())


@inline
def _total(y: Any, context: Any, x: Any, ends: Any, means: Any) -> Any:
    """``F``, the size of its terms, and what the step leads to."""
    t, theta, kinds, c, capacity, damping, drive, h, p = context
    change = 2.0 * (y * capacity - p)
    rate = 1.0 / h
    force = change * rate + damping * y - drive
    size = (abs(change.real) + abs(p)) * rate + abs(damping * y.real) + abs(drive)
    for leaf in range(kinds.shape[0]):
        gain = c[leaf, GAIN]
        if kinds[leaf, 0] == LOSSLESS:
            moved = h * gain * y
            end = x[kinds[leaf, 1]] + moved
            mean = c[leaf, STIFFNESS] * (x[kinds[leaf, 1]] + 0.5 * moved)
        elif kinds[leaf, 0] == CURVED:
            start = x[kinds[leaf, 1]] + 0.0 * y
            end = start + h * gain * y
            mean = mean_effort(t, kinds[leaf, 1], start, end, theta)
        else:
            end, mean = rc_flow(
                x[kinds[leaf, 1]], gain * y, h, c[leaf, STIFFNESS], c[leaf, RHO], c[leaf, LOW], c[leaf, HIGH],
                c[leaf, LEAK], c[leaf, ONE], c[leaf, TWO], c[leaf, LEAK_ONE], c[leaf, LEAK_TWO],
            )  # fmt: skip
        ends[kinds[leaf, 1]] = end
        means[kinds[leaf, 1]] = mean
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
def resolve(t: Any, theta: Any, h: Any, g: Any, constants: Any, kinds: Any, c: Any) -> Any:
    """Fill the leaves' kinds and constants for steps of size ``h``; returns the junction's ``1/s`` and its damping.

    Args:
        g: gains; constants: (L+1, 9) memory.
        kinds: (L, 2) filled with the rule and the storage of every leaf.
        c: (L, 10) filled with its constants, see `phnn.integrate.constants`, and its ratio.
    """
    stay_outside()
    leaves = count(t, LEAVES)
    fill_constants(t, theta, h, constants)
    for leaf in range(leaves):
        row = t[0, LEAVES] + leaf
        curved = t[row, 1] == LOSSLESS and t[row, 2] <= 0
        kinds[leaf, 0], kinds[leaf, 1] = CURVED if curved else t[row, 1], t[row, 0]
        for i in range(CONSTANTS):
            c[leaf, i] = constants[leaf, i]
        c[leaf, GAIN] = g[t[row, 5]]
    none = 0.0 * theta[0]
    damping = none
    for r in range(t[0, JUNCTION_RESISTORS], t[0, JUNCTION_RESISTORS + 1]):
        b = none
        for branch in range(t[r, 6], t[r, 7]):
            b += g[branch]
        damping += b * b * resistor_flow(t, r, 1.0 + none, none, theta)
    return constants[leaves, CAPACITY], damping


def _steps(
    t: Any, theta: Any, actions: Any, h: Any, states: Any, efforts: Any, g: Any, constants: Any, kinds: Any, c: Any,
    perturbed: Any, ends: Any, means: Any,
) -> Any:  # fmt: skip
    """March; the last arguments are memory: ``perturbed`` is theta in complex numbers."""
    fill_gains(t, theta, g)
    k = junction_storage(t, 0)
    slope, capacity, damping = 0.0, 0.0, 0.0
    for n in range(actions.shape[0]):
        if n == 0 or h[n] != h[n - 1]:
            capacity, damping = resolve(t, theta, h[n], g, constants, kinds, c)
            slope = 0.0
        drive = 0.0
        for r in range(t[0, JUNCTION_INLETS], t[0, JUNCTION_INLETS + 1]):
            drive += g[r] * actions[n, t[r, 0]]
        p = states[n, k]
        y = extrapolated(efforts, n, k) if n > 0 else p / capacity
        step = (kinds, c, capacity, damping, drive, h[n], p)
        around = ((t, theta, perturbed), step, states[n], states[n + 1], efforts[n], ends, means)
        y, slope = _root(y, 2.0 * capacity / h[n], slope, around)
        efforts[n, k] = y
        states[n + 1, k] = p + 2.0 * (y * capacity - p)
        if not np.isfinite(y):
            return n
    return actions.shape[0]


_compiled = loop_entry(_steps)


def march(program: Program, theta: Array, actions: Array, h: Array, states: Array, efforts: Array) -> int:
    """`phnn.integrate.kernel.march` from the state in ``states[0]`` and under the actions of the ports."""
    t = program.table
    leaves, ends = len(rows_of(t, LEAVES)), np.zeros(states.shape[1], np.complex128)
    memory = (np.zeros(len(t)), np.zeros((leaves + 1, CONSTANTS)), np.zeros((leaves, 2), np.int64))
    own = (*memory, np.zeros((leaves, CONSTANTS + 1)), theta.astype(np.complex128), ends, np.zeros_like(ends))
    return int(_compiled(t, theta, actions, h, states, efforts, *own))
