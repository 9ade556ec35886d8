"""Compiled calls of laws by their number in the registry."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from phnn.integrate.cache import inline, plain, stay_outside
from phnn.laws import FACTOR_LAWS, MEMORY_LAWS, RESISTOR_LAWS, STORAGE_LAWS
from phnn.laws.law import close_tables
from phnn.laws.wide import WIDE_RESISTORS, WIDE_STORAGES, compiled_flow, compiled_mean_effort

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
    wide: list[Entry] = [(compiled_mean_effort(x), 0, True) for x in WIDE_STORAGES.values()]
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
    return look_up("flow", scalar + [(_unmodulated(compiled_flow(x)), 0, True) for x in WIDE_RESISTORS.values()], 2)


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
