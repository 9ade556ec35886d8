"""The coupling of junctions and reducible storages in a step: flows, currents, modulating variables, junction terms."""

from __future__ import annotations

from typing import Any, NamedTuple

from phnn.integrate.cache import inline
from phnn.integrate.constants import CAPACITY
from phnn.integrate.table_access import count, is_linear, junction_storage, mean_effort, resistor_flow
from phnn.integrate.tables import (
    FIRST_BRANCH,
    FIRST_INLET,
    FIRST_LINK,
    FROM_PORT,
    GYRATORS,
    INTO_JUNCTION,
    JUNCTION_INLETS,
    JUNCTION_RESISTORS,
    JUNCTIONS,
    LAST_BRANCH,
    LAST_INLET,
    LAST_LINK,
    LEAVES,
    OF_JUNCTION,
    OWN_STORAGE,
    READ,
    READ_JUNCTION,
    READ_LEAF,
    READ_MODULATOR,
    TO_JUNCTION,
)

# Rows of the two work arrays: per junction (4, m) and per storage (2, N).
FLOW, CHANGE, FORCE, SIZE = range(4)
NEXT, EFFORT = range(2)


class Step(NamedTuple):
    """One step, in floats or in complex numbers.

    Attributes:
        theta: (M,) parameters.
        c, g, a: constants, ratios and actions, see `phnn.integrate.constants`.
        x: (N,) state at its start; y: (m,) unknowns; h: its size [s].
        wj: (4, m) filled with ``v̄``, ``z − p``, ``F`` and the size of its terms.
    """

    theta: Any
    c: Any
    g: Any
    a: Any
    x: Any
    y: Any
    h: Any
    wj: Any


@inline
def junction_change(t: Any, j: Any, c: Any, x: Any, y: Any) -> Any:
    """``z_j − p_j``; of a linear storage ``2 (v̄/s − p)``, which takes no difference of end states."""
    p = x[junction_storage(t, j)]
    return 2.0 * (y[j] * c[count(t, LEAVES) + j, CAPACITY] - p) if is_linear(t, j) else y[j] - p


@inline
def leaf_current(t: Any, leaf: Any, g: Any, a: Any, wj: Any) -> Any:
    """``i_l``."""
    row = t[0, LEAVES] + leaf
    total = 0.0 * g[0]
    for r in range(t[row, FIRST_LINK], t[row, LAST_LINK]):
        total += g[r] * wj[FLOW, t[r, TO_JUNCTION]]
    for r in range(t[row, FIRST_INLET], t[row, LAST_INLET]):
        total += g[r] * a[t[r, FROM_PORT]]
    return total


@inline
def read(t: Any, r: Any, step: Step) -> Any:
    """Mid-step energy variable, or modulator state, that a law may read; 0 for none.

    The ratios of a reducible storage that is read follow no energy variable. A modulator state is read at the start of
    the step.
    """
    if r < 0:
        return 0.0 * step.g[0]
    leaf, j = t[r, READ_LEAF], t[r, READ_JUNCTION]
    if t[r, READ_MODULATOR] >= 0:
        return step.x[t[r, READ_MODULATOR]]
    if leaf >= 0:
        start = step.x[t[t[0, LEAVES] + leaf, OWN_STORAGE]]
        return start + 0.5 * step.h * leaf_current(t, leaf, step.g, step.a, step.wj)
    return step.x[junction_storage(t, j)] + 0.5 * junction_change(t, j, step.c, step.x, step.y)


@inline
def branch_effort(t: Any, r: Any, g: Any, wj: Any) -> Any:
    """``b_rᵀ v̄`` of the junction resistor in row ``r``."""
    effort = 0.0 * g[0]
    for b in range(t[r, FIRST_BRANCH], t[r, LAST_BRANCH]):
        effort += g[b] * wj[FLOW, t[b, TO_JUNCTION]]
    return effort


@inline
def junction_flows(t: Any, theta: Any, x: Any, y: Any, wj: Any) -> None:
    """Fill ``v̄``."""
    for j in range(count(t, JUNCTIONS)):
        k = junction_storage(t, j)
        wj[FLOW, j] = y[j] if is_linear(t, j) else mean_effort(t, k, x[k], y[j], theta)


@inline
def add(term: Any, j: Any, wj: Any) -> None:
    """Add a term to ``F`` of junction ``j`` and to the size of its terms."""
    wj[FORCE, j] += term
    wj[SIZE, j] += abs(term.real)


@inline
def _resistor_term(t: Any, r: Any, step: Step) -> None:
    g, wj = step.g, step.wj
    effort = branch_effort(t, r, g, wj)
    flow = resistor_flow(t, r, effort, read(t, t[r, READ], step), step.theta)
    for b in range(t[r, FIRST_BRANCH], t[r, LAST_BRANCH]):
        add(g[b] * flow, t[b, TO_JUNCTION], wj)


@inline
def _gyrator_term(t: Any, r: Any, g: Any, wj: Any) -> None:
    add(-g[r] * wj[FLOW, t[r, OF_JUNCTION]], t[r, TO_JUNCTION], wj)


@inline
def _inlet_term(t: Any, r: Any, g: Any, a: Any, wj: Any) -> None:
    add(-g[r] * a[t[r, FROM_PORT]], t[r, INTO_JUNCTION], wj)


@inline
def junction_term(t: Any, r: Any, step: Step) -> None:
    """Add the force of the junction resistor, gyrator or junction inlet in row ``r``."""
    if r < t[0, JUNCTION_RESISTORS + 1]:
        _resistor_term(t, r, step)
    elif r < t[0, GYRATORS + 1]:
        _gyrator_term(t, r, step.g, step.wj)
    else:
        _inlet_term(t, r, step.g, step.a, step.wj)


@inline
def junction_terms(t: Any, step: Step) -> None:
    """``F`` without the reducible storages, the size of its terms, and ``z − p``."""
    x, g, wj = step.x, step.g, step.wj
    rate = 1.0 / step.h
    for j in range(count(t, JUNCTIONS)):
        change = junction_change(t, j, step.c, x, step.y)
        wj[CHANGE, j] = change
        wj[FORCE, j] = change * rate
        wj[SIZE, j] = (abs(change.real) + abs(x[junction_storage(t, j)].real)) * rate
    for r in range(t[0, JUNCTION_RESISTORS], t[0, JUNCTION_RESISTORS + 1]):
        _resistor_term(t, r, step)
    for r in range(t[0, GYRATORS], t[0, GYRATORS + 1]):
        _gyrator_term(t, r, g, wj)
    for r in range(t[0, JUNCTION_INLETS], t[0, JUNCTION_INLETS + 1]):
        _inlet_term(t, r, g, step.a, wj)
