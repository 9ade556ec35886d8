"""Guesses of the time, input and output columns of an unknown table and of their units. They use the names, the units
and, where these say nothing, the values and the order of the columns."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phnn.errors import InputRefused
from phnn.recordings.checks import ACTUATORS
from phnn.recordings.table import Table
from phnn.recordings.units import QUANTITIES, find_unit, parse_name, split_unit

Array = NDArray[np.float64]

TIME, INPUT, OUTPUT = "time", "input", "output"


def _of(words: str) -> frozenset[str]:
    return frozenset(words.split())


# Words of column names by the role that they suggest.
_WORDS: Mapping[str, frozenset[str]] = {
    TIME: _of("time t zeit timestamp temps sec seconds"),
    INPUT: _of("u in input v voltage volt volts vin drive driving command cmd ref reference setpoint excitation force")
    | _of("torque pwm spannung eingang"),
    OUTPUT: _of("y out output vout displacement disp deflection stroke position pos q x z d sensor response level")
    | _of("height angle speed velocity acceleration strain weg ausgang auslenkung"),
}
# Words that say of an input or an output that the system is no piezo actuator.
_OTHER_SYSTEMS = _of("force torque pwm level height angle speed velocity acceleration pressure flow")
# Row counters are no times.
_COUNTERS = _of("index idx sample samples row nr no number n")
# Further quantities, which are neither input nor output where there is anything else.
_FURTHER = ("current", "charge", "temperature")
# Steps of a time may differ by so much of their median and still be a time; `phnn check` then says more.
_UNEVEN = 0.5


def known_unit(text: str | None) -> tuple[str, float] | None:
    """SI unit and factor of a unit; None where phnn does not know it."""
    found = find_unit(text) if text else None
    return (found.si, found.factor) if found is not None else None


@dataclass(frozen=True, eq=False)
class Seen:
    """One column of numbers.

    Attributes:
        index: in the table; name: in the header, empty where there is none.
        values: (N,) as they stand in the file.
    """

    index: int
    name: str
    values: Array

    @cached_property
    def _parts(self) -> tuple[str, str | None]:
        """The name without its unit, and the unit in the spelling of the table of units."""
        return split_unit(self.name)

    @property
    def unit(self) -> str | None:
        """The unit that the name gives, where phnn knows it."""
        return self._parts[1] if known_unit(self._parts[1]) is not None else None

    @property
    def words(self) -> frozenset[str]:
        """The words of the name, in small letters, and its quantity."""
        known = parse_name(self.name) if self.name else None
        words = re.findall(r"[^\W\d_]+", self._parts[0].lower())
        return frozenset([*words, *([known[0]] if known is not None else [])])

    @property
    def constant(self) -> bool:
        """It never changes."""
        return bool(np.ptp(self.values) == 0.0)

    @property
    def advances(self) -> bool:
        """It grows by nearly equal steps, as a time does."""
        steps = np.diff(self.values)
        middle = float(np.median(steps)) if steps.size else 0.0
        return middle > 0.0 and bool(np.all(np.abs(steps - middle) < _UNEVEN * middle))

    @property
    def counts(self) -> bool:
        """It counts rows."""
        return bool(self.words & _COUNTERS) or bool(np.all(np.diff(self.values) == 1.0))


@dataclass(frozen=True)
class Role:
    """A column and what it is taken for.

    Attributes:
        column: which; unit: SI or a multiple that phnn knows.
        by_name: its name says the role, not only its place.
        unit_known: its name says the unit.
    """

    column: Seen
    unit: str
    by_name: bool
    unit_known: bool


@dataclass(frozen=True)
class Layout:
    """What the columns of one file are taken for.

    Attributes:
        time: None where no column is one.
        input, output: of the system.
        actuator: they may be the voltage and the displacement of a piezo actuator.
        others: columns that serve as nothing.
    """

    time: Role | None
    input: Role
    output: Role
    actuator: bool
    others: tuple[Seen, ...]


def columns_seen(table: Table) -> list[Seen]:
    """The columns of a table that hold finite numbers of the most frequent length."""
    found = []
    for i, name in enumerate(table.names):
        try:
            values = table.numbers(i)
        except InputRefused:
            continue
        if values.size > 1 and bool(np.isfinite(values).all()):
            found.append(Seen(i, name, values))
    if table.by_name:
        # Variables stand in a file in any order.
        found.sort(key=lambda c: c.name)
    sizes = [c.values.size for c in found]
    return [c for c in found if c.values.size == max(set(sizes), key=lambda s: (sizes.count(s), s))]


def layout_of(table: Table) -> Layout | None:
    """The roles of a table's columns; None where it has fewer than two columns that may be input and output."""
    columns = columns_seen(table)
    time = _time(columns)
    rest = [c for c in columns if (time is None or c is not time.column) and not (c.words & _COUNTERS)]
    moving = [c for c in rest if not c.constant]
    free = [c for c in moving if not (c.words & set(_FURTHER))]
    free = free if len(free) >= 2 else moving
    if len(free) < 2:
        return None
    source = _by_words(free, INPUT, "voltage")
    answer = _by_words([c for c in free if c is not source], OUTPUT, "displacement")
    u = source or next(c for c in free if c is not answer)
    y = answer or next(c for c in free if c is not u)
    actuator = _like_an_actuator(u, y)
    return Layout(
        time,
        Role(u, u.unit or ("V" if actuator else "1"), source is not None, u.unit is not None),
        Role(y, y.unit or (_length(y) if actuator else "1"), answer is not None, y.unit is not None),
        actuator,
        tuple(c for c in rest if c not in (u, y)),
    )


def unstated(table: Table, stated: Sequence[str]) -> dict[str, tuple[int, str]]:
    """Column and guessed unit of quantities that the names of a table call for, but without a unit of theirs or by
    several columns: such names are refused unless the manifest says more.

    Args:
        stated: quantities that the manifest states already.
    """
    found: dict[str, list[tuple[int, str | None]]] = {}
    for i, name in enumerate(table.names):
        known = parse_name(name) if name else None
        if known is not None and known[0] not in stated:
            found.setdefault(known[0], []).append((i, known[1]))
    doubtful = {q: some for q, some in found.items() if len(some) > 1 or known_unit(some[0][1]) is None}
    return {
        q: (i, unit if unit is not None and known_unit(unit) is not None else QUANTITIES[q] or "1")
        for q, ((i, unit), *_) in doubtful.items()
    }


def _time(columns: Sequence[Seen]) -> Role | None:
    named = next((c for c in columns if c.words & _WORDS[TIME] and not c.constant), None)
    evenly = [c for c in columns if c.advances and not (c.words & (_COUNTERS | _WORDS[INPUT] | _WORDS[OUTPUT]))]
    found = named or next(iter(sorted(evenly, key=lambda c: c.counts)), None)
    if found is None:
        return None
    unit = known_unit(found.unit)
    known = unit is not None and unit[0] == "s"
    return Role(found, str(found.unit) if known else "s", named is not None, known)


def _by_words(columns: Sequence[Seen], role: str, first: str) -> Seen | None:
    """The column whose name says the role, that of quantity ``first`` before all others."""
    named = [c for c in columns if c.words & _WORDS[role]]
    exact = [c for c in named if (p := parse_name(c.name)) is not None and p[0] == first]
    return next(iter([*exact, *named]), None)


def _like_an_actuator(u: Seen, y: Seen) -> bool:
    """Whether nothing says that these are not voltage and displacement of a piezo actuator."""
    for column, quantity in ((u, "voltage"), (y, "displacement")):
        if column.words & _OTHER_SYSTEMS:
            return False
        known = known_unit(column.unit)
        if known is not None:
            least, most, unit = ACTUATORS[quantity]
            si, factor = known
            size = float(np.abs(column.values).max() if quantity == "voltage" else np.ptp(column.values))
            if si != unit or not least <= factor * size <= most:
                return False
    return True


def _length(column: Seen) -> str:
    """The unit in which the numbers of a column would be a stroke that piezo actuators have, micrometres first."""
    shortest, longest = 1e-9, 1e-3
    size = float(np.ptp(column.values))
    factors = {"um": 1e-6, "m": 1.0, "mm": 1e-3, "nm": 1e-9}
    return next((u for u, factor in factors.items() if shortest <= size * factor <= longest), "um")
