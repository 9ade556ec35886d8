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

from phnn.integrate.cache import loop_entry, plain, stay_outside
from phnn.integrate.constants import (
    CAPACITY,
    CONSTANTS,
    RHO,
    fill_constants,
    fill_gains,
)
from phnn.integrate.junction import CURVED, FOLLOWING, GAIN, RESISTOR_OF, RULE_OF, STORAGE_OF, root
from phnn.integrate.modulator_states import advance
from phnn.integrate.partition import LINEAR_RESISTOR_CODES
from phnn.integrate.program import Program
from phnn.integrate.roots import extrapolated
from phnn.integrate.table_access import (
    count,
    factor,
    junction_storage,
    resistor_flow,
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
    READ_MODULATOR,
    RULE,
    SIGN,
    STORAGES,
    rows_of,
)
from phnn.integrate.terms import EFFORT, FLOW, NEXT, Step

Array = NDArray[np.float64]


class Work(NamedTuple):
    """Work arrays of an integration.

    Attributes:
        gains: (R,); constants: (L+1, 9), see `phnn.integrate.constants`.
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
    """Advance the modulator states (`phnn.integrate.modulator_states`); unknown, ``wj`` and ``wx`` are filled."""
    stay_outside()
    storages, x, y, wj = count(t, STORAGES), step.x, step.y, step.wj
    y[0] = means[junction_storage(t, 0)]
    wj[FLOW, 0] = y[0]
    for k in range(storages):
        wx[NEXT, k], wx[EFFORT, k] = next_x[k], means[k]
    advance(t, step, wx)
    for k in range(storages, x.shape[0]):
        next_x[k], means[k] = wx[NEXT, k], wx[EFFORT, k]


def _steps(
    t: Any, theta: Any, actions: Any, h: Any, states: Any, efforts: Any, work: Work
) -> Any:  # fmt: skip
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
    work = Work(*own, others, np.zeros(others.size), slow, scaled)
    return int(_compiled(t, theta, actions, h, states, efforts, work))
