"""Compiled access to the table: evaluates the law of a row by its code, with the parameters that the row names."""

from __future__ import annotations

from typing import Any

from phnn.integrate.cache import inline
from phnn.integrate.dispatch import (
    decay_table,
    factor_table,
    flow_table,
    path_table,
    rate_table,
    storage_table,
    threshold_table,
)
from phnn.integrate.tables import (
    IS_LINEAR,
    JUNCTIONS,
    LAW,
    OWN_STORAGE,
    PLACE_1,
    PLACE_2,
    PLACE_3,
    PLACE_4,
    PLACE_5,
    STORAGES,
)

# A state so small that every spring is linear up to it; a power of two, so that a linear one is divided exactly.
NEAR_REST = 2.0**-80

_mean_effort = storage_table()
_thresholds = threshold_table()
_path = path_table()
_flow = flow_table()
_factor = factor_table()
_rate = rate_table()
_decay = decay_table()


@inline
def count(t: Any, kind: Any) -> Any:
    """Number of rows of a kind."""
    return t[0, kind + 1] - t[0, kind]


@inline
def mean_effort(t: Any, k: Any, a: Any, b: Any, theta: Any) -> Any:
    """``ē`` of storage ``k`` between two states."""
    r = t[0, STORAGES] + k
    return _mean_effort(
        t[r, LAW], a, b, theta, t[r, PLACE_1], t[r, PLACE_2], t[r, PLACE_3], t[r, PLACE_4], t[r, PLACE_5]
    )


@inline
def stiffness(t: Any, k: Any, theta: Any) -> Any:
    """``s`` of a linear storage, ``E = s x``, or of another one at rest."""
    small = NEAR_REST + 0.0 * theta[0]
    return mean_effort(t, k, small, small, theta) / NEAR_REST


@inline
def resistor_flow(t: Any, r: Any, effort: Any, q: Any, theta: Any) -> Any:
    """``φ(ε, q)`` of the resistor in row ``r``."""
    return _flow(t[r, LAW], effort, q, theta, t[r, PLACE_1], t[r, PLACE_2], t[r, PLACE_3], t[r, PLACE_4], t[r, PLACE_5])


@inline
def resistor_thresholds(t: Any, r: Any, q: Any, theta: Any) -> Any:
    """``(ρ, lo, hi)(q)`` of the piecewise linear resistor in row ``r``."""
    return _thresholds(t[r, LAW], q, theta, t[r, PLACE_1], t[r, PLACE_2], t[r, PLACE_3], t[r, PLACE_4], t[r, PLACE_5])


@inline
def resistor_path(t: Any, r: Any, x: Any, current: Any, h: Any, s: Any, theta: Any) -> Any:
    """``(x⁺, ē)`` of the storage ``E = s x`` of the resistor in row ``r``, which depends on the path alone."""
    return _path(
        t[r, LAW], x, current, h, s, theta, t[r, PLACE_1], t[r, PLACE_2], t[r, PLACE_3], t[r, PLACE_4], t[r, PLACE_5]
    )


@inline
def factor(t: Any, r: Any, q: Any, theta: Any) -> Any:
    """``f(q)`` of the modulation in row ``r``."""
    return _factor(t[r, LAW], q, theta, t[r, PLACE_1], t[r, PLACE_2], t[r, PLACE_3], t[r, PLACE_4], t[r, PLACE_5])


@inline
def memory_rate(t: Any, r: Any, z: Any, source: Any, theta: Any) -> Any:
    """``f(z, s)`` of the modulator state in row ``r``."""
    return _rate(t[r, LAW], z, source, theta, t[r, PLACE_1], t[r, PLACE_2], t[r, PLACE_3], t[r, PLACE_4], t[r, PLACE_5])


@inline
def memory_decay(t: Any, r: Any, theta: Any) -> Any:
    """``d`` of the modulator state in row ``r``."""
    return _decay(t[r, LAW], theta, t[r, PLACE_1], t[r, PLACE_2], t[r, PLACE_3], t[r, PLACE_4], t[r, PLACE_5])


@inline
def junction_storage(t: Any, j: Any) -> Any:
    """Number of the storage of junction ``j``."""
    return t[t[0, JUNCTIONS] + j, OWN_STORAGE]


@inline
def is_linear(t: Any, j: Any) -> Any:
    """Whether the unknown of junction ``j`` is its mean effort; otherwise it is its end state."""
    return t[t[0, JUNCTIONS] + j, IS_LINEAR] > 0
