"""Compiled access to the table: evaluates the law of a row by its code, its number in the registry."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from phnn.integrate.cache import inline, plain, stay_outside
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
from phnn.laws import FACTOR_LAWS, MEMORY_LAWS, RESISTOR_LAWS, STORAGE_LAWS
from phnn.laws.law import close_tables
from phnn.laws.wide import WIDE_RESISTORS, WIDE_STORAGES, compiled

_PLACES = ("i0", "i1", "i2", "i3", "i4")
# Parameters that the kernel passes to a law.
SCALARS = len(_PLACES)
# The functions below compile the laws that exist now.
close_tables()

# A function of a law, the number of parameters it takes, and whether it reads a block of weights instead.
Entry = tuple[Callable[..., Any] | None, int, bool]


def look_up(name: str, entries: Sequence[Entry], leading: int) -> Any:
    """A compiled ``name(code, a_1…a_leading, theta, i0…i4)`` calling the function at position ``code``.

    Args:
        entries: by code; a function is None if the law lacks it. Functions of neural laws are called with
            ``(a_1…a_leading, theta, first, units)``.
        leading: number of arguments before the parameters.
    """
    arguments = [f"a{i}" for i in range(leading)]
    scope: dict[str, Any] = {"stay_outside": stay_outside, "__name__": __name__}
    lines = [f"def {name}({', '.join(['code', *arguments, 'theta', *_PLACES])}):", "    stay_outside()"]
    present = [(code, function, count, wide) for code, (function, count, wide) in enumerate(entries) if function]
    for code, function, count, wide in present:
        if wide:
            scope[f"f{code}"] = function
            call = f"return f{code}({', '.join([*arguments, 'theta', 'i0', 'i1'])})"
        else:
            scope[f"f{code}"] = inline(function)
            call = f"return f{code}({', '.join([*arguments, *(f'theta[{p}]' for p in _PLACES[:count])])})"
        # The last branch needs no test, so that the function returns on every path.
        lines.append(f"    {call}" if code == present[-1][0] else f"    if code == {code}:\n        {call}")
    # The text is built from positions only.
    exec("\n".join(lines), scope)
    # Not inlined: it has many call sites, and the constants of the common laws are computed beforehand.
    return plain(scope[name])


def storage_table() -> Any:
    """``mean_effort(code, a, b, theta, i0…i4)``."""
    scalar: list[Entry] = [(x.mean_effort, len(x.example), False) for x in STORAGE_LAWS.values()]
    wide: list[Entry] = [(compiled(x), 0, True) for x in WIDE_STORAGES.values()]
    return look_up("mean_effort", scalar + wide, 2)


def threshold_table() -> Any:
    """``thresholds(code, q, theta, i0…i4)``."""
    return look_up("thresholds", [(x.thresholds, len(x.example), False) for x in RESISTOR_LAWS.values()], 1)


def path_table() -> Any:
    """``path(code, x, i, h, s, theta, i0…i4)``."""
    return look_up("path", [(x.path, len(x.example), False) for x in RESISTOR_LAWS.values()], 4)


def flow_table() -> Any:
    """``flow(code, effort, q, theta, i0…i4)``; neural laws read no state."""
    scalar: list[Entry] = [(x.flow, len(x.example), False) for x in RESISTOR_LAWS.values()]
    return look_up("flow", scalar + [(_unmodulated(compiled(x)), 0, True) for x in WIDE_RESISTORS.values()], 2)


def factor_table() -> Any:
    """``factor(code, q, theta, i0…i4)``."""
    return look_up("factor", [(x.factor, len(x.example), False) for x in FACTOR_LAWS.values()], 1)


def rate_table() -> Any:
    """``rate(code, z, s, theta, i0…i4)``."""
    return look_up("rate", [(x.rate, len(x.example), False) for x in MEMORY_LAWS.values()], 2)


def decay_table() -> Any:
    """``decay(code, theta, i0…i4)``."""
    return look_up("decay", [(x.decay, len(x.example), False) for x in MEMORY_LAWS.values()], 0)


def _unmodulated(flow: Any) -> Any:
    """A flow with an unused read-only argument."""

    def with_read(effort: Any, q: Any, theta: Any, first: Any, units: Any) -> Any:
        return flow(effort, theta, first, units)

    return plain(with_read)


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
