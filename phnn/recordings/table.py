"""Columns as they stand in a file, before anything is known of their meaning."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import cache
from typing import Any

import numpy as np

from phnn.errors import InputRefused
from phnn.intake import LIMITS
from phnn.recordings.units import find_unit, parse_name, spelled, split_unit
from phnn.results import listed, printable

# A number with commas; one with a unit behind it.
_COMMA = re.compile(r"[-+]?\d[\d.]*(,[\d.]+)+([eE][-+]?\d+)?")
_WITH_UNIT = re.compile(r"\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*([^\s\d.].*?)\s*")
REMEDY_COMMA = "write numbers with a point as decimal sign, and none between thousands"
# The numbers or texts of a column, or what reads them.
Column = np.ndarray | Callable[[], np.ndarray]
# Kinds of numpy's types that are numbers; complex ones are refused where somebody asks for them.
NUMBERS = "iufbc"


@dataclass(frozen=True)
class Stored:
    """An array in a file, whose numbers are read when somebody asks for them."""

    name: str  # groups before it
    shape: tuple[int, ...]
    dtype: np.dtype
    load: Callable[[], np.ndarray]  # raises InputRefused where the numbers are damaged or too large
    unit: str = ""  # that the file states beside the name; empty where it states none


@dataclass(frozen=True)
class Where:
    """A place in a file, for messages: the file's name and how its rows are counted."""

    file: str
    first_line: int | None = None  # line of the first data row in a text file, from 1 on; None for binary files
    offset: int = 0  # rows left out before the first one in use (a slice)
    # Further tables of the file: the row that each begins with, and the lines between all tables up to there.
    between: tuple[tuple[int, int], ...] = ()

    def row(self, i: int) -> str:
        """Return the i-th used row in words; data rows are counted from 1."""
        row = i + self.offset
        if self.first_line is None:
            return f"row {row + 1}"
        before = next((lines for first, lines in reversed(self.between) if first <= row), 0)
        return f"row {row + 1} (line {row + self.first_line + before})"

    def __str__(self) -> str:
        return self.file


@dataclass(frozen=True, eq=False)
class Table:
    """A file's columns; each is an array, numeric or of texts, or what reads it."""

    where: Where
    names: tuple[str, ...]  # of the header; empty texts where there is none
    columns: tuple[Column, ...]  # of one length, unless by_name
    by_name: bool = False  # the columns have no order (.mat, .npz, …), so an index does not find one
    notes: tuple[str, ...] = ()  # what was left out of the file, and why
    shape: tuple[int, ...] = ()  # realisations, periods, samples of a periodic experiment, one after another
    segments: tuple[int, ...] = ()  # rows with which a further recording begins, where the file tells
    stamps: tuple[str, ...] = ()  # columns of dates and times of day, in seconds since the first; one is the time
    units: Mapping[str, str] = field(default_factory=dict)  # by column, what is stated beside it
    # By column, (N,) at which rows it was sampled, where other columns have clocks of their own.
    sampled: Mapping[str, np.ndarray] = field(default_factory=dict)

    def find(self, place: int | str) -> int:
        """Return the index of the column at an index or of a name."""
        named = [n for n in self.names if n]
        if isinstance(place, str):
            hits = [i for i, name in enumerate(self.names) if name == place]
            # A unit below or behind the name is no part of it.
            hits = hits or [i for i, name in enumerate(self.names) if split_unit(name)[0] == place]
            if len(hits) == 1:
                return hits[0]
            known = f"it has {listed(named)}" if named else "its columns have no names, give an index from 0 on"
            cause = "several columns are" if hits else "no column is"
            raise InputRefused(f"{self.where}: {cause} called {place!r}: {known}; correct recordings.yaml")
        if self.by_name:
            cause = f"column {place} is an index, but its variables have names only ({listed(named)})"
            remedy = "use `variables: {voltage: NAME, displacement: NAME}` in recordings.yaml"
            raise InputRefused(f"{self.where}: {cause}: {remedy}")
        if place >= (size := len(self.columns)):
            cause = f"column {place} does not exist, the file has {size} columns (0 to {size - 1})"
            raise InputRefused(f"{self.where}: {cause}: correct `columns` in recordings.yaml")
        return place

    def only(self, first: int, last: int) -> Table:
        """Return the table with the rows from ``first`` up to ``last`` alone."""

        def cut(held: Column) -> Column:
            return (lambda: held()[first:last]) if callable(held) else held[first:last]

        where = replace(self.where, offset=self.where.offset + first)
        segments = tuple(row - first for row in self.segments if first < row < last)
        sampled = {name: rows[first:last] for name, rows in self.sampled.items()}
        return replace(self, where=where, columns=tuple(map(cut, self.columns)), segments=segments, sampled=sampled)

    def label(self, index: int) -> str:
        """Return the column in words."""
        return f"column {self.names[index] or index}"

    def numbers(self, index: int, marks: Sequence[str] = ()) -> np.ndarray:
        """Return ``(N,)`` the column as float64; empty cells, and those that hold a mark, become NaN."""
        held = self.columns[index]
        column = held() if callable(held) else held
        # Texts may hold numbers.
        if column.dtype.kind not in f"{NUMBERS}OUS" or column.ndim != 1:
            cause = f"holds {column.dtype} of shape {column.shape}, not one number for every sample"
            raise InputRefused(f"{self.where}: {self.label(index)} {cause}: export seconds and numbers")
        if np.iscomplexobj(column):
            raise InputRefused(f"{self.where}: {self.label(index)} holds complex numbers: export real samples")
        if column.dtype.kind in "iufb":
            return column.astype(float)
        import pandas as pd

        cells = pd.Series(column)
        values = np.asarray(pd.to_numeric(cells, errors="coerce"), dtype=float)
        bad = np.isnan(values) & ~np.asarray(cells.isna() | cells.isin(list(marks)))
        if not bad.any():
            return values
        row = int(np.argmax(bad))
        cell, cause, remedy = str(column[row]).strip(), "not a number", "correct or delete that row"
        if self.names[index] in self.stamps:
            cause, remedy = "no date or time of day as the others are", "correct it, or delete that row"
        elif _COMMA.fullmatch(cell):
            cause, remedy = "a number with a comma, as decimal sign or between thousands", REMEDY_COMMA
        elif cell.endswith("?"):
            cell, cause = cell[:-1], "a point among numbers with a decimal comma, and may be a thousand times as large"
            remedy = "write all numbers of the file with one decimal sign and without thousands separators"
        elif (unit := _WITH_UNIT.fullmatch(cell)) and find_unit(unit[2]) is not None:
            cause = "a number with its unit"
            remedy = f"write numbers alone into the cells, and unit: {unit[2]} for this column in recordings.yaml"
        elif re.fullmatch(r"[^\W\d]+|[-*.]+", cell):
            mark = f"say missing: [{cell[:40]!r}] for this column in recordings.yaml"
            remedy = f"{remedy}; where it marks a missing value, {mark}"
        place = f"{self.where}: {self.label(index)}, {self.where.row(row)}"
        raise InputRefused(f"{place}: {cell[:40]!r} is {cause}: {remedy}")


# Dates, with a time of day behind them or none; times of day and durations; midnight as the end of a day; when numbers
# without a unit are seconds since 1970, or their thousandths and so on: between 2001 and 2096.
DATE = re.compile(r"\d{1,4}([-./])(?:\d{1,2}|[A-Za-z]{3})\1\d{1,4}([ T]+\d{1,2}:.*)?|\d{4}\d{4}T\d{4,6}.*")
OF_DAY = re.compile(r"(\d+ ?d(ays?)? +)?\d{1,3}:\d{1,2}(:\d{1,2}([.,]\d+)?)?(\s?[AaPp][Mm])?")
_MIDNIGHT = r"(?<=[ T])24:00(?=(?::00(?:\.0*)?)?$)"
_EPOCH, _LATEST = 1e9, 4e9
_EPOCH_NAMES = frozenset({"timestamp", "epoch", "unix", "time", "unixtime", "time_stamp", "unix_time", "ts"})
_LOOKED_AT, _DAY = 5, 86_400.0


def with_stamps(table: Table) -> Table:
    """Return the table with dates, times of day and stamps counted from 1970 as seconds since the first of a column,
    and numbers that each have one unit behind them as numbers with that unit.

    A date takes up the time of day beside it. A cell that cannot be read stays a text, which `Table.numbers` refuses.
    """
    columns, names, notes, stamps = list(table.columns), list(table.names), table.notes, table.stamps
    units = dict(table.units)
    for i, held in enumerate(table.columns):
        if not callable(held) and names[i] and (measured := _measured(held)) is not None:
            columns[i], units[names[i]] = measured
            continue
        later = i + 1 < len(table.columns) and table.columns[i + 1]
        # Of columns without a name, the first of dates is the time.
        if callable(held) or (stamps and not names[i]) or (dates := _dates(held, later, names[i])) is None:
            continue
        columns[i], names[i] = dates[0], names[i] or "date"
        notes = notes if stamps else (*notes, f"{names[i]}: dates, taken as seconds since {dates[1]}")
        stamps = (*stamps, names[i])
    return replace(table, columns=tuple(columns), names=tuple(names), stamps=stamps, notes=notes, units=units)


def _measured(column: np.ndarray) -> tuple[np.ndarray, str] | None:
    """Return the numbers of texts such as `0.2 sec`, and their unit; None where it is not one unit that is known."""
    if column.dtype.kind not in "OUS" or column.ndim != 1 or not column.size:
        return None
    import pandas as pd

    cells = pd.Series(column).dropna()
    first = _WITH_UNIT.fullmatch(str(cells.iloc[0])) if cells.size else None
    if first is None or find_unit(first[2]) is None:
        return None
    parts = cells.astype(str).str.extract(f"^{_WITH_UNIT.pattern}$")
    values = pd.to_numeric(parts[0], errors="coerce")
    if values.isna().any() or (parts[1] != first[2]).any():
        return None
    return np.asarray(values.reindex(range(column.size)), float), spelled(first[2])


def _dates(column: np.ndarray, following: Any, name: str) -> tuple[np.ndarray, str] | None:
    """Return seconds since the first date of a column, and that date; None where it holds none."""
    if column.dtype.kind in "iuf":
        if name.strip().lower() not in _EPOCH_NAMES or not column.size or not np.isfinite(column).all():
            return None
        # How many of the numbers are a second.
        for scale in (1.0, 1e3, 1e6, 1e9):
            if column.min() / scale >= _EPOCH and column.max() / scale <= _LATEST:
                return np.asarray(column - column[0], float) / scale, f"{column[0] / scale:.6f} s after 1970"
        return None
    if column.dtype.kind not in "OUSmM" or column.ndim != 1 or not column.size:
        return None
    import pandas as pd

    cells, of_day, late = pd.Series(column), False, pd.Timedelta(0)
    if column.dtype.kind == "m":
        return np.asarray(cells.dt.total_seconds() - cells.dt.total_seconds().iloc[0], dtype=float), str(cells.iloc[0])
    if column.dtype.kind in "OUS" and not isinstance(cells.dropna().iloc[:1].squeeze(), datetime):
        of_day = _all_alike(cells, OF_DAY)
        if not of_day and not _all_alike(cells, DATE):
            return None
        cells = _written(cells)
        dates = isinstance(following, np.ndarray) and not of_day and not cells.str.contains(":").any()
        if dates and following.ndim == 1 and following.dtype.kind in "OUS" and _all_alike(pd.Series(following), OF_DAY):
            cells = cells + " " + _written(pd.Series(following))
        if not of_day:
            late = pd.to_timedelta(cells.str.contains(_MIDNIGHT, na=False).astype(int), unit="D")
            cells = cells.str.replace(_MIDNIGHT, "00:00", regex=True)
    if of_day and not cells.str.contains("[AaPp]").any():
        # Hours that are counted on beyond a day.
        whole = cells.where(cells.str.count(":") > 1, cells + ":00").str.replace(r" ?d\w*", "D", regex=True)
        instants = pd.Timestamp(0, tz="UTC") + pd.to_timedelta(whole, errors="coerce")
    else:
        head = str(cells.dropna().iloc[0])
        instants = late + _in_either_order(cells, head, "." in head.split(":")[0].split(" ")[0])
    if instants.isna().all():
        return None
    first = instants.dropna().iloc[0]
    seconds = np.array((instants - first) / pd.Timedelta(1, "s"), dtype=float)
    known = np.isfinite(seconds)
    if instants.dt.normalize().nunique() == 1 and np.diff(seconds[known]).min(initial=0.0) < -0.5 * _DAY:
        # Times of day that pass midnight.
        seconds[known] = np.unwrap(seconds[known], period=_DAY)
    unread = np.asarray(cells.notna()) & ~known
    # A time of day has no date of its own.
    seconds = np.where(unread, column.astype(object), seconds) if unread.any() else seconds
    return seconds, str(cells.dropna().iloc[0] if of_day else first)


def _written(cells: Any) -> Any:
    """Return the cells of a series as texts with points; missing ones stay as they are."""
    return cells.map(lambda cell: str(cell).strip().replace(",", "."), na_action="ignore")


def _all_alike(cells: Any, pattern: re.Pattern[str]) -> bool:
    """Return whether the first cells of a series that are there have a pattern."""
    head = _written(cells.dropna().iloc[:_LOOKED_AT])
    return head.size > 0 and all(map(pattern.fullmatch, head))


def _in_either_order(cells: Any, head: str, day_first: bool) -> Any:
    """Return dates, ``head`` first, with the day before the month or behind it: where they go on with the
    smaller steps; as ``day_first`` says where both do alike."""
    import pandas as pd

    def parsed(first: bool) -> Any:
        return pd.to_datetime(cells, errors="coerce", utc=True, dayfirst=first, format="mixed")

    def disorder(parsed_dates: Any) -> tuple[int, Any]:
        return int(parsed_dates.isna().sum()), parsed_dates.dropna().diff().abs().max()

    parsed_dates = parsed(day_first)
    if parsed_dates.dt.normalize().nunique() < 2 or not re.match(r"\d{1,2}[-./]", head):
        return parsed_dates
    return min(parsed_dates, parsed(not day_first), key=disorder)


def beside(tables: Sequence[Table]) -> Table:
    """Return the columns of several files of one recording, side by side, counted through."""
    first = tables[0]
    if len(tables) == 1:
        return first
    where = replace(first.where, file=", ".join(t.where.file for t in tables))
    shapes = [" × ".join(map(str, t.shape)) for t in tables]
    if len(set(shapes)) > 1:
        cause = f"arrays of different shapes ({', '.join(shapes)} realisations, periods and samples)"
        raise InputRefused(f"{where}: {cause}: give input and output of one experiment")
    clocks = [t.numbers(i) for t in tables for i, n in enumerate(t.names) if parse_name(n)[0] == "time"]
    for clock in clocks[1:]:
        half = 0.5 * np.median(np.abs(np.diff(clocks[0])))
        if clock.size == clocks[0].size and np.abs(clock - clocks[0]).max(initial=0.0) > half:
            ends = "; ".join(f"{c[0]:.6g} to {c[-1]:.6g}" for c in (clocks[0], clock))
            raise InputRefused(f"{where}: times that differ ({ends}): export all channels of a recording with one time")
    both: dict[str, Any] = {
        name: tuple(one for t in tables for one in getattr(t, name)) for name in ("names", "columns", "notes", "stamps")
    }
    both |= {name: {k: v for t in tables for k, v in getattr(t, name).items()} for name in ("units", "sampled")}
    return replace(first, where=where, by_name=any(t.by_name for t in tables), **both)


def _members(value: Any) -> list[Any]:
    """Return the members of a cell array or an array of structures; empty for anything else."""
    if isinstance(value, np.ndarray) and value.dtype == object:
        return list(value.ravel())
    return list(value) if isinstance(value, list) else []


def _is_vector(value: Any) -> bool:
    if not isinstance(value, Stored | np.ndarray) or value.dtype.kind not in NUMBERS:
        return False
    return max(value.shape, default=1) == math.prod(value.shape) > 1


# Fields of a structure that is a signal: its name, its numbers and its unit.
_NAMES, _DATA = ("Name", "name", "label", "title"), ("Data", "data", "values", "Values")
_UNITS = ("Unit", "unit", "Units", "units")


def _signal(value: Any) -> Stored | None:
    """Return the numbers of a structure that is a signal, with its name and unit; None for any other."""
    if not isinstance(value, Mapping):
        return None
    held = next((value[k] for k in _DATA if k in value), None)
    if not isinstance(held, Stored | np.ndarray) or held.dtype.kind not in NUMBERS or max(held.shape, default=1) < 2:
        return None
    if not any(k in value for k in _NAMES):
        return None
    texts = {k: v.strip() for k, v in value.items() if isinstance(v, str) and v.strip()}
    name, unit = (next((texts[k] for k in keys if k in texts), "") for keys in (_NAMES, _UNITS))
    return Stored(name.strip("<>"), held.shape, held.dtype, held.load if isinstance(held, Stored) else held.view, unit)


def experiments_of(name: str, value: Any) -> list[tuple[str, list[np.ndarray]]]:
    """Return the columns, each a name and its (n,) values in every experiment, that the experiments of an array of
    structures or of a cell array share; empty for others."""
    members = [m if isinstance(m, Mapping) else _by_column(name, m) for m in _members(value)]
    if len(members) < 2 or any(m.keys() != members[0].keys() or _signal(m) for m in members):
        return []
    shared = [k for k in members[0] if all(_is_vector(m[k]) for m in members)]
    parts = [(printable(k), [np.ravel(_loaded(m[k])) for m in members]) for k in shared]
    sizes = {tuple(v.size for v in values) for _, values in parts}
    return parts if len(parts) > 1 and len(sizes) == 1 else []


def _by_column(name: str, value: Any) -> dict[str, np.ndarray]:
    """Return the columns of a matrix; none of anything else."""
    matrix = _loaded(value)
    if not isinstance(matrix, np.ndarray) or matrix.ndim != 2:
        return {}
    return {f"{name}[{i}]": column for i, column in enumerate(upright(matrix).T[: LIMITS.columns])}


def _loaded(value: Any) -> Any:
    """Return the numbers of a value of a structure."""
    return value.load() if isinstance(value, Stored) else value


def stored_arrays(content: Mapping[str, Any], prefix: str = "") -> Iterator[Stored]:
    """Yield the values of a mapping as arrays, those of one in it as ``group.name``, signals by their names too."""
    for name, value in content.items():
        full = prefix + name
        members = _members(value)
        if any(isinstance(m, Mapping | Stored) for m in members):
            yield from stored_arrays({f"[{i}]": m for i, m in enumerate(members)}, full)
        elif isinstance(value, Mapping):
            signal = _signal(value)
            if signal is not None:
                time = not signal.name and signal.unit in ("s", "ms", "us")
                yield replace(signal, name=signal.name or ("time" if time else full))
            elif "signals" in value and _is_vector(value.get("time")):
                # A scope of Simulink, "structure with time".
                yield from stored_arrays({"time": {"name": "time", "data": value["time"], "unit": "s"}})
            yield from stored_arrays(value, full + ".")
        elif isinstance(value, Stored):
            yield replace(value, name=full)
        elif hasattr(value, "magnitude") and hasattr(value, "units"):
            # A quantity of pint.
            array = np.asarray(value.magnitude)
            yield Stored(full, array.shape, array.dtype, array.view, f"{value.units:~C}")
        else:
            masked = isinstance(value, np.ma.MaskedArray)
            array = np.ma.filled(value.astype(float), np.nan) if masked else np.asarray(value)
            yield Stored(full, array.shape, array.dtype, array.view)


def table_of(where: Where, arrays: Iterable[Stored]) -> Table:
    """Return the columns of all arrays of numbers, by name; of several of one name, the first."""
    columns: dict[str, Column] = {}
    units: dict[str, str] = {}
    skipped: list[str] = []
    for stored in arrays:
        name = printable(stored.name)
        shape = tuple(n for n in stored.shape if n != 1)
        if stored.dtype.kind not in NUMBERS:
            continue
        load = cache(stored.load)
        if len(shape) <= 1:
            several = {name: _column(load)}
        elif len(shape) == 2 and min(shape) <= LIMITS.columns:
            several = {f"{name}[{i}]": _column(load, i) for i in range(min(shape))}
        else:
            skipped.append(f"{name} of {' × '.join(map(str, stored.shape))}")
            continue
        columns |= {n: c for n, c in several.items() if n not in columns}
        units |= {n: stored.unit for n in several if stored.unit and n not in units}
    if not columns:
        more = f" (left out, with more than {LIMITS.columns} columns: {listed(skipped)})" if skipped else ""
        raise InputRefused(f"{where}: no numeric variables in it{more}: save the samples as vectors")
    return Table(where, tuple(columns), tuple(columns.values()), by_name=True, units=units)


def _column(load: Callable[[], np.ndarray], i: int | None = None) -> Column:
    """Return what reads the i-th column of an array; without an index, the array as a vector."""
    return lambda: np.atleast_1d(np.squeeze(load())) if i is None else upright(np.squeeze(load()))[:, i]


def upright(matrix: np.ndarray) -> np.ndarray:
    """Return a matrix with the samples along its first axis: there are never more channels than samples."""
    return matrix.T if matrix.shape[0] < matrix.shape[1] else matrix
