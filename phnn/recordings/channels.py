"""From the columns of a table to channels in SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from phnn.errors import InputRefused
from phnn.recordings import checks
from phnn.recordings.manifest import DRIVING, EMPTY, GLITCHES, Column
from phnn.recordings.table import Table, Where
from phnn.recordings.units import (
    QUANTITIES,
    check_unit,
    find_unit,
    known_unit,
    parse_name,
    split_unit,
    stated_by_name,
    suits,
    to_si,
)

# What loggers write for a value that is missing, or beyond a counter.
MARKS = (-99.0, -999.0, -9999.0, -99999.0, 999.0, 9999.0, 99999.0, 65535.0, 32767.0, -32768.0, 2147483647.0,
         -2147483648.0, 4294967295.0)  # fmt: skip
# How many values a column has beside such a mark: an input on a few levels may have any of them.
_VALUES = 10
# A mark lies off all other numbers by this share of their range; a glitch off its neighbours by these multiples of what
# 99 of 100 samples do and of the steps of a converter, and by this share of the range.
_APART, _TIMES_OFF, _STEPS, _SHARE = 0.5, 50.0, 20.0, 0.02
# Ranges after which angles and counters start again; the share of it that a signal covers, and that it may jump.
_TURNS = (360.0, 2.0 * np.pi, 400.0, 1.0, 100.0, 1000.0, 3600.0, *(2.0**k for k in range(8, 33)))
_COVERED, _JUMPS = 0.85, 0.5
# By how much a glitch exceeds the differences of the samples around it; share of the bends that undoing a wrap leaves.
_AGREE, _BENDS = 2.0, 0.1
# Differences of samples that are looked at on either side.
_AROUND = 6
# Rows in a row over which a masked input is interpolated.
_MASKED = 10


@dataclass(frozen=True, eq=False)
class Channel:
    """One quantity of a file: ``(N,)`` SI values, where they stand, and the factor from number to SI.

    ``own`` are the ``(N,)`` rows at which it was sampled, None for all; the values of others are interpolated.
    """

    values: np.ndarray
    label: str
    unit: str
    factor: float
    own: np.ndarray | None = None
    notes: tuple[str, ...] = ()


def select(table: Table, columns: Mapping[str, Column], named: Mapping[str, tuple[str, Column]]) -> dict[str, Channel]:
    """Return every quantity that the manifest's columns or the table's own names give, and further channels by name.

    Args:
        columns: by quantity; named: quantity and column of what has a name of its own.
    """
    every = {**{quantity: (quantity, columns.get(quantity, Column())) for quantity in QUANTITIES}, **named}
    if not table.by_name and not table.stamps and columns.get("time", Column()).place is None:
        _one_clock(table)
    spoken_for = {table.find(c.place): c for _, c in every.values() if c.place is not None}
    found = {name: _channel(table, *said, name, spoken_for) for name, said in every.items()}
    channels = {name: channel for name, channel in found.items() if channel is not None}
    if "time" not in channels and table.stamps:
        index = table.names.index(table.stamps)
        channels["time"] = Channel(table.numbers(index), table.label(index), "s", 1.0)
    if len({c.values.size for c in channels.values()}) > 1:
        said = ", ".join(f"{q} ({c.label}) has {c.values.size}" for q, c in channels.items())
        raise InputRefused(f"{table.where}: unequal numbers of samples: {said}: give channels of one recording")
    return channels


def _one_clock(table: Table) -> None:
    """Refuse several columns of seconds that grow, of which none is called the time. Raises InputRefused."""
    clocks = [i for i, n in enumerate(table.names) if n and suits("time", split_unit(n)[1])]
    if len(clocks) < 2 or any((parse_name(table.names[i]) or ("",))[0] == "time" for i in clocks):
        return
    times = [(t := table.numbers(i))[np.isfinite(t)] for i in clocks]
    if all(t.size and (np.diff(t) > 0.0).all() for t in times):
        said = "; ".join(f"{table.label(i)} ends at {t[-1]:g} s" for i, t in zip(clocks, times, strict=True))
        raise InputRefused(
            f"{table.where}: two clocks ({said}): export all channels with one time, or name one of these in "
            f"recordings.yaml, columns: {{time: {{column: ...}}}}"
        )


def _channel(table: Table, quantity: str, said: Column, name: str, spoken_for: Mapping[int, Column]) -> Channel | None:
    """Return the channel of a quantity; None where the table has none.

    Args:
        spoken_for: columns that the manifest names, whatever it takes them for.
    """
    index = table.find(said.place) if said.place is not None else _by_name(table, quantity, spoken_for)
    if index is None:
        return None
    label = table.label(index)
    if said.place is not None and table.names[index] == "":
        label = f"column {said.place}"
    dates = quantity == "time" and table.names[index] == table.stamps
    unit, notes = ("s", ()) if dates else _unit(table, index, quantity, said)
    where, marked = f"{name} ({label})", np.zeros(0, dtype=bool)
    values = table.numbers(index)
    if quantity != "time":
        values, marked = _without_marks(values, said, where, table.where, quantity not in DRIVING)
    checks.finite(values, where, table.where, f"columns: {{{quantity}: {{missing: {EMPTY}}}}}")
    own = table.own.get(table.names[index])
    if marked.any():
        own = ~marked if own is None else own & ~marked
        row = table.where.row(int(np.argmax(marked)))
        notes = (*notes, f"{where}: {int(marked.sum())} values masked, the first in {row}")
    factor = said.scale * known_unit(unit).factor
    return Channel(to_si(said.scale * values, unit), label, unit, factor, own, notes)


def _without_marks(
    values: np.ndarray, said: Column, label: str, where: Where, output: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of a column, unwrapped and interpolated where they are masked, and (N,) bool which are."""
    marked = np.isin(values, [mark for mark in said.missing if not isinstance(mark, str)])
    if EMPTY in said.missing:
        marked |= ~np.isfinite(values)
    good = values[~marked]
    if good.size < checks.FEWEST_SAMPLES or not np.isfinite(good).all():
        return values, np.zeros(values.size, dtype=bool)
    for mark in MARKS:
        others = good[good != mark]
        if others.size in (0, good.size) or np.unique(others).size < _VALUES:
            continue
        far = max(others.min() - mark, mark - others.max())
        if far > _APART * float(np.ptp(others)):
            row = int(np.flatnonzero((values == mark) & ~marked)[0])
            raise InputRefused(
                f"{where}: {label}, {where.row(row)}: {good.size - others.size} values of {mark:g}, all others lie "
                f"between {others.min():g} and {others.max():g}: a mark of missing values? Say missing: [{mark:g}] for "
                f"this column in recordings.yaml, or repair these rows"
            )
    unwrapped = good if said.unwrap is None else np.unwrap(good, period=said.unwrap)
    if output and said.unwrap is None and (turn := _wraps(good)) is not None:
        row = int(np.flatnonzero(~marked)[int(np.argmax(np.abs(np.diff(good)) > _JUMPS * turn)) + 1])
        raise InputRefused(
            f"{where}: {label}, {where.row(row)}: jumps by its whole range of {turn:.6g}, as an angle or a counter "
            f"that starts again: say unwrap: {turn:.6g} for this column in recordings.yaml, in the numbers of the file"
        )
    off = _glitches(unwrapped) if output else np.zeros(0, dtype=np.int64)
    if off.size:
        rows = np.flatnonzero(~marked)[off]
        if GLITCHES not in said.missing:
            raise InputRefused(
                f"{where}: {label}, {where.row(int(rows[0]))}: {values[rows[0]]:g} between {values[rows[0] - 1]:g} and "
                f"{values[rows[0] + 1]:g}, and {off.size - 1} more single values as far off their neighbours: "
                f"glitches? Say missing: [{GLITCHES}] for this column in recordings.yaml, or repair these rows"
            )
        marked[rows] = True
        unwrapped = np.delete(unwrapped, off)
    if not marked.any():
        return unwrapped, marked
    kept = np.flatnonzero(~marked)
    if not output and int(np.diff(np.concatenate([[-1], kept, [values.size]])).max()) > _MASKED + 1:
        place = where.row(int(np.argmax(marked)))
        cause = f"more than {_MASKED} values of an input are missing in a row"
        raise InputRefused(f"{where}: {label}, {place}: {cause}: cut the recording there (`slice` in recordings.yaml)")
    return np.interp(np.arange(values.size), kept, unwrapped), marked


def _wraps(x: np.ndarray) -> float | None:
    """Return the number after which a column starts again, where it jumps by nearly its whole range to do so."""
    size, steps = float(np.ptp(x)), np.diff(x)
    middle = np.mean(np.abs(x - 0.5 * (x.min() + x.max())) < 0.4 * size)
    for turn in _TURNS:
        jumps = np.abs(steps) > _JUMPS * turn
        if not _COVERED * turn <= size <= 1.0001 * turn or not jumps.any() or np.unique(x).size <= 2 * jumps.sum():
            continue
        rest, after = np.abs(steps[~jumps]).max(initial=0.0), np.abs(np.abs(steps[jumps]) - turn).max()
        bends = float(np.std(np.diff(np.unwrap(x, period=turn), 2)))
        smooth = bends <= _BENDS * min(turn, float(np.std(np.diff(x, 2))))
        if smooth and after <= 2.0 * rest + 1e-3 * turn and middle > 0.3:
            return turn
    return None


def _glitches(x: np.ndarray) -> np.ndarray:
    """Return single samples that lie far off both neighbours, to one side."""
    before, after = x[1:-1] - x[:-2], x[1:-1] - x[2:]
    off = np.where(np.sign(before) == np.sign(after), np.minimum(np.abs(before), np.abs(after)), 0.0)
    usual = float(np.quantile(off, 0.99))
    middle = float(np.median(off[off > 0.0])) if (off > 0.0).any() else 0.0
    spread = float(np.ptp(np.quantile(x, [0.005, 0.995])))
    steps = np.abs(np.diff(x))
    step = float(steps[steps > 0.0].min(initial=np.inf)) if (steps > 0.0).any() else 0.0
    least = max(_TIMES_OFF * max(usual, middle), _STEPS * step, _SHARE * spread)
    # What follows a jump rings to one side as well: the samples around a glitch, and its neighbours, have to agree.
    found = np.flatnonzero((off > least) & (off / _AGREE > np.abs(x[2:] - x[:-2]))) + 1
    around = (np.r_[steps[max(i - 1 - _AROUND, 0) : i - 1], steps[i + 1 : i + 1 + _AROUND], 0.0].max() for i in found)
    return found[[off[i - 1] / _AGREE > most for i, most in zip(found, around, strict=True)]]


def _by_name(table: Table, quantity: str, spoken_for: Mapping[int, Column]) -> int | None:
    """Return the index of the one column whose name says ``quantity``."""
    parsed = [(i, parse_name(name)) for i, name in enumerate(table.names) if name]
    # What the manifest takes for something else is not asked again for a unit, or for marks.
    named = [
        (i, p[1])
        for i, p in parsed
        if p is not None
        and p[0] == quantity
        and (i not in spoken_for or (suits(quantity, p[1]) and not (spoken_for[i].missing or spoken_for[i].unwrap)))
    ]
    # a name such as voltage_monitor belongs to another column where voltage_V stands beside it
    known = [i for i, u in named if suits(quantity, u)] or [i for i, _ in named]
    if len(known) > 1:
        names = ", ".join(table.names[i] for i in known)
        raise InputRefused(
            f"{table.where}: {names} all claim to be the {quantity}: keep one, or say which in recordings.yaml, "
            f"columns: {{{quantity}: {{column: NAME}}}}"
        )
    return known[0] if known else None


def _unit(table: Table, index: int, quantity: str, said: Column) -> tuple[str, tuple[str, ...]]:
    """Return the unit of a column, and what is said of others: that of the manifest wins over what the file states."""
    name = table.names[index]
    named, beside, stated = stated_by_name(name, quantity), table.units.get(name), said.unit
    where = f"{table.where}: {table.label(index)}"
    if stated is not None:
        # Whoever states a scale has looked at the numbers.
        others = [u for u in (named, beside) if said.scale == 1.0 and _contradicts(stated, u, quantity)]
        notes = tuple(f"{name}: the file says {u}, recordings.yaml says {stated}, which counts" for u in others)
        return check_unit(quantity, stated, where), notes
    if named is not None and _contradicts(named, beside, quantity):
        raise InputRefused(
            f"{where}: the name says {named}, what stands beside it {beside}: correct one, or say which counts in "
            f"recordings.yaml, columns: {{{quantity}: {{column: {name}, unit: {named}}}}}"
        )
    return check_unit(quantity, beside if named is None else named, where), ()


def _contradicts(one: str, other: str | None, quantity: str) -> bool:
    """Whether two units give one number different values; of a quantity in any unit, units of one kind alone."""
    first, second = find_unit(one), find_unit(other or "")
    alike = first is None or second is None or first.si == second.si
    return suits(quantity, other) and first != second and (alike or QUANTITIES[quantity] is not None)
