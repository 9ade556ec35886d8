"""Modulator states, compiled: each is advanced at the end of a step by the mean powers, efforts or actions in it.

    z⁺ = z + h φ₁(−h d) f(z, s̄),     s̄ = Σ of mean powers, efforts or actions

Laws and ratios read ``z`` at the start of a step (`phnn.integrate.step`). During the step they are therefore fixed, and
the step keeps its power balance. Where ``s̄`` is power that resistors dissipate, it follows from the balance of the
step: ``i ē − ΔH/h`` of a reducible storage, ``ε̄ φ(ε̄)`` on junctions.
"""

from __future__ import annotations

from typing import Any

from phnn.integrate.cache import inline, plain, stay_outside
from phnn.integrate.table_access import count, mean_effort, memory_decay, memory_rate, resistor_flow
from phnn.integrate.tables import (
    FIRST_SOURCE,
    LAST_SOURCE,
    LEAVES,
    MODULATOR_STATES,
    OWN_STORAGE,
    READ,
    SOURCE_EFFORT,
    SOURCE_FLOW,
    SOURCE_LEAF,
    SOURCE_PORT,
    SOURCE_RESISTOR,
    STORAGES,
)
from phnn.integrate.terms import EFFORT, FLOW, NEXT, Step, branch_effort, leaf_current, read
from phnn.laws.other import advanced


@inline
def _source(t: Any, s: Any, step: Step, wx: Any) -> Any:
    """Contribution of the source in row ``s`` to ``s̄``."""
    theta, g, x, wj = step.theta, step.g, step.x, step.wj
    leaf, r = t[s, SOURCE_LEAF], t[s, SOURCE_RESISTOR]
    if leaf >= 0:
        k = t[t[0, LEAVES] + leaf, OWN_STORAGE]
        end = wx[NEXT, k]
        stored = mean_effort(t, k, x[k], end, theta) * (end - x[k]) / step.h
        return leaf_current(t, leaf, g, step.a, wj) * wx[EFFORT, k] - stored
    if r >= 0:
        effort = branch_effort(t, r, g, wj)
        return effort * resistor_flow(t, r, effort, read(t, t[r, READ], step), theta)
    if t[s, SOURCE_EFFORT] >= 0:
        return wx[EFFORT, t[s, SOURCE_EFFORT]]
    if t[s, SOURCE_FLOW] >= 0:
        return wj[FLOW, t[s, SOURCE_FLOW]]
    return step.a[t[s, SOURCE_PORT]]


@plain
def advance(t: Any, step: Step, wx: Any) -> None:
    """Fill the end states and the mean drives ``s̄`` of all modulator states from those of a solved step.

    Args: as of `phnn.integrate.step.inlined_balance`; states and ``wx`` have the modulator states after the storages.
    """
    stay_outside()
    first = count(t, STORAGES)
    for k in range(count(t, MODULATOR_STATES)):
        row, z = t[0, MODULATOR_STATES] + k, step.x[first + k]
        total = 0.0 * step.g[0]
        for s in range(t[row, FIRST_SOURCE], t[row, LAST_SOURCE]):
            total += _source(t, s, step, wx)
        wx[EFFORT, first + k] = total
        rate, decay = memory_rate(t, row, z, total, step.theta), memory_decay(t, row, step.theta)
        wx[NEXT, first + k] = advanced(z, step.h, rate, decay)
