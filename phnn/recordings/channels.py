"""From the columns of a table to channels in SI units, at sampling instants from stamps as loggers write them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator, make_interp_spline

from phnn.errors import InputRefused
from phnn.recordings import checks
from phnn.recordings.manifest import DRIVING, EMPTY, GLITCHES, Column
from phnn.recordings.table import Table, Where
from phnn.recordings.units import QUANTITIES, check_unit, find_unit, parse_name, split_unit, stated_by_name, suits
from phnn.signals.reconstruct import find_jumps

Array = np.ndarray
# What loggers write for a value that is missing, or beyond a counter.
MARKS = (-99.0, -999.0, -9999.0, -99999.0, 999.0, 9999.0, 99999.0, 65535.0, 32767.0, -32768.0, 2147483647.0,
         -2147483648.0, 4294967295.0)  # fmt: skip
# How many values a column has beside such a mark: an input on a few levels may have any of them.
_VALUES = 10
# A mark lies off all other numbers by this share of their range; a glitch off its neighbours by these multiples of what
# 99 of 100 samples do and of the steps of a converter, and by this share of the range.
_APART, _TIMES_OFF, _STEPS, _SHARE = 0.5, 50.0, 20.0, 0.02
# Another number is a mark as well from so many ranges off, if an output has it so often.
_ALONE, _REPEATED = 5.0, 3
# Ranges after which angles and counters start again; the share of it that a signal covers, and that it may jump.
_COUNTERS = tuple(2.0**k for k in range(8, 33))
_TURNS = (360.0, 2.0 * np.pi, 400.0, 1.0, 100.0, 1000.0, 3600.0, *_COUNTERS)
_COVERED, _JUMPS = 0.85, 0.5
# Of these one is sure to start again, also where a signal stays near its ends, and moves by that share of the range.
_CIRCLES, _MOVES = (360.0, 2.0 * np.pi, *_COUNTERS), 0.01
# By how much a glitch exceeds the differences of the samples around it; share of the bends that undoing a wrap leaves.
_AGREE, _BENDS = 2.0, 0.1
# Differences of samples that are looked at on either side.
_AROUND = 6
# Share of the samples of an output, within it, that may be dropouts to 0.
_DROPS = 0.05
# Quantities that no model needs.
_SPARE = ("current", "charge", "temperature")
_TOLD_BY_UNIT = ("time", "voltage", "displacement", "force")  # that a column may be by its unit alone
# Rows in a row over which a masked input is interpolated.
_MASKED = 10


@dataclass(frozen=True, eq=False)
class Channel:
    """One quantity of a file: ``(N,)`` SI values, where they stand, their unit there and in SI, and how numbers of the
    file become SI: ``factor * number + offset``.

    ``sampled`` are the ``(N,)`` rows at which it was sampled, None for all; the values of others are interpolated.
    """

    values: Array
    label: str
    unit: str
    si: str
    factor: float
    sampled: Array | None = None
    notes: tuple[str, ...] = ()
    offset: float = 0.0


def select(
    table: Table, columns: Mapping[str, Column], named: Mapping[str, tuple[str, Column]]
) -> tuple[dict[str, Channel], tuple[str, ...]]:
    """Return every quantity that the manifest's columns or the table's own names give, further channels by name, and
    why a further channel was left out of which the manifest says nothing. ``columns`` are given by quantity; ``named``
    holds quantity and column of what has a name of its own."""
    every = {**{quantity: (quantity, columns.get(quantity, Column())) for quantity in QUANTITIES}, **named}
    if not table.by_name and not table.stamps and every["time"][1].place is None:
        _one_clock(table)
    claimed = {table.find(c.place): c for _, c in every.values() if c.place is not None}
    by_unit = not columns and not named
    channels, unusable = {}, []
    for name, (quantity, column) in every.items():
        try:
            if (channel := _channel(table, quantity, column, name, claimed, by_unit)) is not None:
                channels[name] = channel
        except InputRefused as error:
            if quantity not in _SPARE or column != Column():
                raise
            unusable.append(f"the {quantity} was left out ({error})")
    if len({c.values.size for c in channels.values()}) > 1:
        sizes = ", ".join(f"{q} ({c.label}) has {c.values.size}" for q, c in channels.items())
        raise InputRefused(f"{table.where}: unequal numbers of samples: {sizes}: give channels of one recording")
    return channels, tuple(unusable)


def _one_clock(table: Table) -> None:
    """Refuse several columns of seconds that grow, of which none is called the time. Raises InputRefused."""
    clocks = [i for i, n in enumerate(table.names) if n and suits("time", split_unit(n)[1])]
    if len(clocks) < 2 or any(parse_name(table.names[i])[0] == "time" for i in clocks):
        return
    times = [(t := table.numbers(i))[np.isfinite(t)] for i in clocks]
    if all(t.size and (np.diff(t) > 0.0).all() for t in times):
        ends = "; ".join(f"{table.label(i)} ends at {t[-1]:g} s" for i, t in zip(clocks, times, strict=True))
        cause = f"two clocks ({ends}): export all channels with one time, or name one of these in recordings.yaml"
        raise InputRefused(f"{table.where}: {cause}, columns: {{time: {{column: ...}}}}")


def _channel(
    table: Table, quantity: str, column: Column, name: str, claimed: Mapping[int, Column], by_unit: bool
) -> Channel | None:
    """Return the channel of a quantity; None where the table has none. ``claimed`` are the columns that the manifest
    names, whatever it takes them for; ``by_unit``: it names none, so that the only column with a unit may be meant."""
    index = table.find(column.place) if column.place is not None else _by_name(table, quantity, claimed)
    if index is None and by_unit and quantity in _TOLD_BY_UNIT:
        index = _by_unit(table, quantity)
    if index is None:
        return None
    label = table.label(index)
    dates = quantity == "time" and table.names[index] in table.stamps
    unit, notes = ("s", ()) if dates else _unit(table, index, quantity, column)
    where, marked = f"{name} ({label})", np.zeros(0, dtype=bool)
    values = table.numbers(index, [mark for mark in column.missing if isinstance(mark, str)])
    if quantity != "time":
        values, marked = _without_marks(values, column, where, table.where, quantity not in DRIVING)
    mask = "" if quantity == "time" else f", or mask them by columns: {{{quantity}: {{missing: {EMPTY}}}}}"
    checks.finite(values, where, table.where, mask)
    sampled = table.sampled.get(table.names[index])
    if marked.any():
        sampled = ~marked if sampled is None else sampled & ~marked
        row = table.where.row(int(np.argmax(marked)))
        notes = (*notes, f"{where}: {int(marked.sum())} values masked, the first in {row}")
    known = find_unit(unit)
    assert known is not None, unit
    si_values = column.scale * values * known.factor + known.offset
    return Channel(si_values, label, unit, known.si, column.scale * known.factor, sampled, notes, known.offset)


def _without_marks(values: Array, column: Column, label: str, where: Where, output: bool) -> tuple[Array, Array]:
    """Return the numbers of a column, unwrapped and interpolated where they are masked, and (N,) bool which are."""
    marked = np.isin(values, [mark for mark in column.missing if not isinstance(mark, str)])
    if any(isinstance(mark, str) and mark != GLITCHES for mark in column.missing):
        marked |= ~(np.abs(values) < checks.LARGEST_VALUE)
    good = values[~marked]
    if good.size < checks.FEWEST_SAMPLES or not np.isfinite(good).all():
        return values, np.zeros(values.size, dtype=bool)
    zero = good == 0.0
    marks = (*MARKS, 0.0) if output and zero.mean() < _DROPS and not zero[0] and not zero[-1] else MARKS
    for mark in (*marks, *((good.min(), good.max()) if output else ())):
        others, apart = good[good != mark], _APART if mark in marks else _ALONE
        few = good.size - others.size < (1 if mark in marks else _REPEATED)
        if few or not others.size or np.unique(others).size < _VALUES:
            continue
        if max(others.min() - mark, mark - others.max()) > apart * float(np.ptp(others)):
            row = where.row(int(np.flatnonzero((values == mark) & ~marked)[0]))
            between = f"{others.min():g} and {others.max():g}"
            cause = f"{good.size - others.size} values of {mark:.10g}, all others lie between {between}"
            remedy = f"Say missing: [{mark:.10g}] for this column in recordings.yaml, or repair these rows"
            raise InputRefused(f"{where}: {label}, {row}: {cause}: a mark of missing values? {remedy}")
    unwrapped = good if column.unwrap is None else np.unwrap(good, period=column.unwrap)
    if output and column.unwrap is None and (turn := _wraps(good)) is not None:
        row = where.row(int(np.flatnonzero(~marked)[int(np.argmax(np.abs(np.diff(good)) > _JUMPS * turn)) + 1]))
        cause = f"jumps by its whole range of {turn:.6g}, as an angle or a counter that starts again"
        remedy = f"say unwrap: {turn:.6g} for this column in recordings.yaml, in the numbers of the file"
        raise InputRefused(f"{where}: {label}, {row}: {cause}: {remedy}")
    off = _glitches(unwrapped) if output else np.zeros(0, dtype=np.int64)
    if off.size:
        rows = np.flatnonzero(~marked)[off]
        if GLITCHES not in column.missing:
            first, behind = rows[0], rows[0] + 1 + (rows[0] + 1 in rows)
            kind = "single values" if (np.diff(off) > 1).all() else "values, one or two in a row,"
            example = f"{values[first]:g} between {values[first - 1]:g} and {values[behind]:g}"
            cause = f"{example}, and {off.size - 1} more {kind} as far off their neighbours: glitches?"
            remedy = f"Say missing: [{GLITCHES}] for this column in recordings.yaml, or repair these rows"
            raise InputRefused(f"{where}: {label}, {where.row(int(first))}: {cause} {remedy}")
        marked[rows] = True
        unwrapped = np.delete(unwrapped, off)
    if not marked.any():
        return unwrapped, marked
    kept = np.flatnonzero(~marked)
    if not output and int(np.diff(np.concatenate([[-1], kept, [values.size]])).max()) > _MASKED + 1:
        row = where.row(int(np.argmax(marked)))
        cause = f"more than {_MASKED} values of an input are missing in a row"
        raise InputRefused(f"{where}: {label}, {row}: {cause}: cut the recording there (`slice` in recordings.yaml)")
    return np.interp(np.arange(values.size), kept, unwrapped), marked


def _wraps(x: Array) -> float | None:
    """Return the number after which a column starts again, where it jumps by nearly its whole range to do so."""
    size, steps = float(np.ptp(x)), np.diff(x)
    middle = np.mean(np.abs(x - 0.5 * (x.min() + x.max())) < 0.4 * size)
    for turn in _TURNS:
        jumps = np.abs(steps) > _JUMPS * turn
        if not _COVERED * turn <= size <= 1.0001 * turn or not jumps.any() or np.unique(x).size <= 2 * jumps.sum():
            continue
        rest, after = np.abs(steps[~jumps]).max(initial=0.0), np.abs(np.abs(steps[jumps]) - turn).max()
        unwrapped = np.unwrap(x, period=turn)
        smooth = np.std(np.diff(unwrapped, 2)) <= _BENDS * min(turn, float(np.std(np.diff(x, 2))))
        covered = middle > 0.3 or (turn in _CIRCLES and np.ptp(unwrapped) > _MOVES * turn)
        if smooth and after <= 2.0 * rest + 1e-3 * turn and covered:
            return turn
    return None


def _glitches(x: Array) -> Array:
    """Return samples that lie far off those before and behind them, to one side, alone or in pairs."""
    spread = float(np.ptp(np.quantile(x, [0.005, 0.995])))
    steps = np.abs(np.diff(x))
    step = float(steps[steps > 0.0].min(initial=np.inf)) if (steps > 0.0).any() else 0.0
    rows: set[int] = set()
    for n in (1, 2):
        inside = np.lib.stride_tricks.sliding_window_view(x[1:-1], n)
        lower, upper = np.minimum(x[: -n - 1], x[n + 1 :]), np.maximum(x[: -n - 1], x[n + 1 :])
        off = np.maximum(np.maximum(inside.min(axis=1) - upper, lower - inside.max(axis=1)), 0.0)
        usual = float(np.quantile(off, 0.99))
        middle = float(np.median(off[off > 0.0])) if (off > 0.0).any() else 0.0
        least = max(_TIMES_OFF * max(usual, middle), _STEPS * step, _SHARE * spread)
        # What follows a jump rings to one side as well: the samples around, and the neighbours, have to agree.
        for i in (np.flatnonzero((off > least) & (off / _AGREE > upper - lower)) + 1).tolist():
            around = np.r_[steps[max(i - 1 - _AROUND, 0) : i - 1], steps[i + n : i + n + _AROUND], 0.0].max()
            rows.update(range(i, i + n) if off[i - 1] / _AGREE > around else ())
    return np.array(sorted(rows), dtype=np.int64)


def _by_name(table: Table, quantity: str, claimed: Mapping[int, Column]) -> int | None:
    """Return the index of the one column whose name says ``quantity``, or that tells the time by its dates."""
    units = {i: unit for i, (named, unit) in enumerate(map(parse_name, table.names)) if named == quantity}
    clocks = [i for i, unit in units.items() if suits("time", unit) and table.names[i] not in table.stamps]
    if quantity == "time" and table.stamps and not clocks:
        return table.names.index(table.stamps[0])
    # What the manifest takes for something else is not asked again for a unit, or for marks.
    asked = [i for i in units if i in claimed and (claimed[i].missing or claimed[i].unwrap)]
    # A name such as voltage_monitor belongs to another column where voltage_V stands beside it.
    known = [i for i, unit in units.items() if suits(quantity, unit) and i not in asked]
    known = known or [i for i in units if i not in claimed]
    if len(known) > 1:
        names = ", ".join(table.names[i] for i in known)
        remedy = f"keep one, or say which in recordings.yaml, columns: {{{quantity}: {{column: NAME}}}}"
        raise InputRefused(f"{table.where}: {names} all claim to be the {quantity}: {remedy}")
    return known[0] if known else None


def _by_unit(table: Table, quantity: str) -> int | None:
    """Return the index of the only column whose unit is one of ``quantity``, where its name is that of no other."""
    units = [i for i, n in enumerate(table.names) if n and suits(quantity, split_unit(n)[1] or table.units.get(n))]
    return units[0] if len(units) == 1 and not parse_name(table.names[units[0]])[0] else None


def _unit(table: Table, index: int, quantity: str, column: Column) -> tuple[str, tuple[str, ...]]:
    """Return the unit of a column, and what is said of others: that of the manifest wins over what the file states."""
    name = table.names[index]
    named, in_file, stated = stated_by_name(name, quantity), table.units.get(name), column.unit
    where = f"{table.where}: {table.label(index)}"
    if stated is not None:
        # Whoever states a scale has looked at the numbers.
        others = [u for u in (named, in_file) if column.scale == 1.0 and _contradicts(stated, u, quantity)]
        notes = tuple(f"{name}: the file says {u}, recordings.yaml says {stated}, which counts" for u in others)
        return check_unit(quantity, stated, where), notes
    if named is not None and _contradicts(named, in_file, quantity):
        cause = f"the name says {named}, what stands beside it {in_file}: correct one, or say which counts"
        example = f"columns: {{{quantity}: {{column: {name}, unit: {named}}}}}"
        raise InputRefused(f"{where}: {cause} in recordings.yaml, {example}")
    return check_unit(quantity, in_file if named is None else named, where), ()


def _contradicts(one: str, other: str | None, quantity: str) -> bool:
    """Return whether two units give one number different values; of a quantity in any unit, units of one kind alone."""
    first, second = find_unit(one), find_unit(other or "")
    alike = first is None or second is None or first.si == second.si
    return suits(quantity, other) and first != second and (alike or QUANTITIES[quantity] is not None)


_NEGLIGIBLE = 1e-4  # of the interval: moving a sample by less changes nothing that a sensor could show
_LARGEST_ROUNDING = 0.05  # of the interval
# Share of the rows that may be out of order or repeated, where sorting repairs them.
_DISORDER = 0.05
# Share of the usual interval that a row which was out of order keeps to its neighbours.
_ROOM = 0.3
# An interval of more usual ones than the first is a gap, over which an input that is not held is interpolated up to the
# second; beyond it, what drove the system is not known.
_GAP, BRIDGED = 1.5, 12.0
# A channel is held between stamps of its own: their interval in rows, the share of the changes that fall on a raster,
# the share of its stamps that change it, and by how much of the raster a stamp may miss it.
_SLOWER, _ON_RASTER, _CHANGING, _OFF = 1.5, 0.95, 0.5, 0.05
# Levels of an input that is held on purpose; share of the changes of an encoder that are of one step.
_LEVELS, _ONE_STEP = 8, 0.5


class Stamped(NamedTuple):
    """Channels at their sampling instants ``t`` (N,) from 0 on [s], in order, uniform where the stamps are but for
    rounding: (N,) SI values by channel, (N,) rows of the file from its first one in use, and what was repaired."""

    t: Array
    values: dict[str, Array]
    rows: Array
    notes: tuple[str, ...] = ()


def stamped(t: Array, resolution: float, channels: Mapping[str, Array], where: Where, held: bool = False) -> Stamped:
    """Return channels (N,) with stamps ``t`` [s] at their sampling instants, in order. ``resolution`` are seconds in a
    unit of the file's time column; between rows with ``held`` inputs an interval may have any length."""
    if t.size % 2 == 0 and t.size > 2 and np.array_equal(t[::2], t[1::2]) and (np.diff(t[::2]) > 0.0).all():
        # An oscilloscope keeps the extremes of every interval.
        means = {name: 0.5 * (values[::2] + values[1::2]) for name, values in channels.items()}
        one = stamped(t[::2], resolution, means, where, held)
        pairs = "two rows with every time, least and largest value: their means are taken"
        return Stamped(one.t, one.values, 2 * one.rows, (pairs, *one.notes))
    t, rows, notes = _in_order(t, channels, where)
    values = {name: x[rows] for name, x in channels.items()}
    steps = np.diff(t)
    usual = float(np.median(steps))
    checks.interval(usual, where)
    gap = np.flatnonzero(steps > _GAP * usual)
    unknown = gap[steps[gap] > BRIDGED * usual]
    if unknown.size and not held:
        first = int(unknown[0])
        row = where.row(int(rows[first + 1]))
        cause = f"time, {row}: a gap of {steps[first]:.6g} s where samples are {usual:.6g} s apart"
        remedy = "split the file there, or in recordings.yaml say `segments: true`, take one side of it with `slice`"
        raise InputRefused(f"{where}: {cause}: {remedy}, or say `input: zero_order` where the input was held")
    if gap.size:
        row, how = where.row(int(rows[gap[0] + 1])), "held" if held else "interpolated"
        gaps = f"{gap.size} intervals are longer than the usual {usual:.4g} s, up to {steps[gap].max():.4g} s"
        notes += (f"{gaps}, the first before {row}: the input is {how} there",)
    k = np.arange(t.size)
    dt, start = (float(c) for c in np.polyfit(k, t - t[0], 1))
    largest = float(np.abs(t - t[0] - (start + dt * k)).max())
    if largest <= _NEGLIGIBLE * dt:
        return Stamped(dt * k, values, rows, notes)
    printed = _printed_resolution(t / resolution) * resolution
    if largest <= min(0.6 * printed, _LARGEST_ROUNDING * dt):
        notes += (f"times are rounded to {printed:.3g} s; taken as a uniform grid of {dt:.9g} s",)
        return Stamped(dt * k, values, rows, notes)
    spacing = f"sampling jitters by up to {largest / dt:.2%} of the interval"
    if largest > dt:
        spacing = f"intervals of {steps.min():.4g} to {steps.max():.4g} s"
    notes += (f"{spacing}; each sample keeps its own instant",)
    return Stamped(t - t[0], values, rows, notes)


def _in_order(t: Array, channels: Mapping[str, Array], where: Where) -> tuple[Array, Array, tuple[str, ...]]:
    """Return stamps in ascending order, the rows that they come from, and what was repaired."""
    steps = np.diff(t)
    if (steps > 0.0).all():
        return t, np.arange(t.size), ()
    usual, back = float(np.median(np.abs(steps))), np.flatnonzero(steps < 0.0)
    far = back.size > 0 and (back.size > _DISORDER * t.size or float(-steps.min()) > BRIDGED * usual)
    order = np.argsort(t, kind="stable")
    if back.size and not far:
        # A row that was written late leaves room for itself; a time that is wrong comes close to another.
        moved = np.flatnonzero(order != np.arange(t.size))
        close = np.diff(t[order])[np.clip([moved - 1, moved], 0, t.size - 2)]
        far = bool((close[close > 0.0] < _ROOM * usual).any())
    order = np.arange(t.size) if far else order
    again = np.flatnonzero(np.diff(t[order]) == 0.0) + 1
    same = all(np.array_equal(x[order[again]], x[order[again - 1]]) for x in channels.values())
    if far or not same or again.size > _DISORDER * t.size:
        raise checks.disorder(t[order], where, order)
    notes = []
    if back.size:
        notes.append(f"{back.size} times go back, the first at {where.row(int(back[0]) + 1)}: rows sorted by time")
    if again.size:
        row = where.row(int(order[again[0]]))
        notes.append(f"{again.size} rows repeat the one before them, the first at {row}: taken once")
    rows = np.delete(order, again)
    return t[rows], rows, tuple(notes)


def own_rows(t: Array, x: Array, drive: Array | None = None) -> Array | None:
    """Return (N,) bool, the rows at which a channel was sampled; None where that may be all.

    A channel that another rate was recorded beside, or that a data base delivers more slowly than it stores, repeats
    its last value in between: its changes lie on a raster of several rows. Those of an input ``drive`` (N,) on few
    levels may explain them.
    """
    changed = np.flatnonzero(np.diff(x)) + 1
    if changed.size < checks.FEWEST_SAMPLES or changed.size > x.size / _SLOWER + 1:
        return None
    sizes = np.abs(np.diff(x)[changed - 1])
    if np.mean(sizes <= 1.0001 * sizes.min()) > _ONE_STEP:
        return None
    if drive is not None and np.unique(drive).size <= _LEVELS and np.mean(np.diff(drive)[changed - 1] != 0.0) > 0.9:
        return None
    steps = np.diff(t[changed])
    raster = float(np.median(steps))
    if raster < _SLOWER * float(np.median(np.diff(t))):
        return None
    whole = np.rint(steps / raster)
    raster = float(steps.sum() / max(whole.sum(), 1.0))
    on = (whole >= 1.0) & (np.abs(steps - whole * raster) <= _OFF * raster)
    if on.mean() < _ON_RASTER or changed.size < _CHANGING * (t[-1] - t[0]) / raster:
        return None
    since = (t - t[changed[0]]) / raster
    slot = np.rint(since)
    off = np.abs(since - slot)
    sampled = np.zeros(x.size, dtype=bool)
    # Of several rows near an instant of the raster, the first that has the new value.
    sampled[changed[np.append(True, on)]] = True
    missing = np.flatnonzero((off <= _OFF) & ~np.isin(slot, slot[sampled]))
    sampled[missing[np.unique(slot[missing], return_index=True)[1]]] = True
    return sampled


def interpolated(t: Array, values: Array, at: Array) -> Array:
    """Return a channel at other instants; where it jumps, free of overshoot. Its ends are continued as constants."""
    at = np.clip(at, t[0], t[-1])
    if find_jumps(values).size:
        return np.asarray(PchipInterpolator(t, values)(at))
    return np.asarray(make_interp_spline(t, values, k=3)(at))


def evenly(t: Array, values: Array) -> tuple[float, Array]:
    """Return an interval and a channel on a uniform grid with as many samples."""
    dt = float(t[-1] - t[0]) / (t.size - 1)
    if np.abs(t - t[0] - dt * np.arange(t.size)).max() <= _NEGLIGIBLE * dt:
        return dt, values
    return dt, interpolated(t, values, t[0] + dt * np.arange(t.size))


def merged(clocks: Mapping[str, tuple[Array, Array]], where: Where) -> tuple[Array, dict[str, Array], dict[str, Array]]:
    """Return the instants of channels with clocks of their own, given as (n,) absolute times [s] and values by name,
    their values there, and which instants are theirs."""
    first, last = max(t[0] for t, _ in clocks.values()), min(t[-1] for t, _ in clocks.values())
    least = min(float(np.median(np.diff(t))) for t, _ in clocks.values() if t.size > 1)
    if not first < last:
        spans = "; ".join(f"{name} from {t[0]:.6f} s to {t[-1]:.6f} s" for name, (t, _) in clocks.items())
        raise InputRefused(f"{where}: the clocks of the channels do not overlap ({spans}): export one recording")
    slack = 1e-3 * least
    every = np.sort(np.concatenate([t[(t >= first - slack) & (t <= last + slack)] for t, _ in clocks.values()]))
    every = every[np.append(True, np.diff(every) > slack)]
    values, sampled = {}, {}
    for name, (t, x) in clocks.items():
        near = np.clip(np.searchsorted(t, every - slack), 0, t.size - 1)
        sampled[name] = np.abs(t[near] - every) <= 2.0 * slack
        values[name] = x[near] if sampled[name].all() else np.where(sampled[name], x[near], interpolated(t, x, every))
    return every, values, sampled


def _printed_resolution(numbers: Array) -> float:
    """Return the place value of the last digit with which numbers were written; 0 where they use full precision."""
    for digits in range(13):
        scaled = numbers * 10.0**digits
        if np.all(np.abs(scaled - np.round(scaled)) <= 1e-6 + 4.0 * np.spacing(np.abs(scaled))):
            return float(10.0**-digits)
    return 0.0
