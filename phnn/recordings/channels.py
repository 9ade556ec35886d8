"""From the columns of a table to channels in SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from phnn.errors import InputRefused
from phnn.recordings import checks
from phnn.recordings.columns import Column
from phnn.recordings.table import Table
from phnn.recordings.units import (
    QUANTITIES,
    check_unit,
    find_unit,
    known_unit,
    parse_name,
    stated_by_name,
    suits,
    to_si,
)


@dataclass(frozen=True, eq=False)
class Channel:
    """One quantity of a file: ``(N,)`` SI values, where they stand, and the factor from number to SI."""

    values: np.ndarray
    label: str
    unit: str
    factor: float


def select(table: Table, columns: Mapping[str, Column], named: Mapping[str, tuple[str, Column]]) -> dict[str, Channel]:
    """Every quantity that the manifest's columns or the table's own names give, and further channels by name.

    Args:
        columns: by quantity; named: quantity and column of what has a name of its own.

    Raises:
        InputRefused: a column that is absent, ambiguous, without a unit or with an impossible one, of unequal
            length, or with cells that are no finite numbers.
    """
    asked = {quantity: (quantity, columns.get(quantity, Column())) for quantity in QUANTITIES}
    found = {name: _channel(table, *said, name) for name, said in {**asked, **named}.items()}
    channels = {name: channel for name, channel in found.items() if channel is not None}
    lengths = {f"{q} ({c.label})": c.values.size for q, c in channels.items()}
    checks.equal_lengths(lengths, table.where)
    return channels


def _channel(table: Table, quantity: str, said: Column, name: str) -> Channel | None:
    """The channel of a quantity; None where the table has none."""
    index = table.find(said.place) if said.place is not None else _by_name(table, quantity, said.unit)
    if index is None:
        return None
    label = table.label(index)
    if said.place is not None and table.names[index] == "":
        label = f"column {said.place}"
    unit = _unit(table, index, quantity, said)
    values = table.numbers(index)
    checks.finite(values, f"{name} ({label})", table.where)
    return Channel(to_si(said.scale * values, unit), label, unit, said.scale * known_unit(unit).factor)


def _by_name(table: Table, quantity: str, unit: str | None) -> int | None:
    """Index of the one column whose name says ``quantity``."""
    parsed = [parse_name(name) if name else None for name in table.names]
    named = [(i, p[1]) for i, p in enumerate(parsed) if p is not None and p[0] == quantity]
    # a name such as voltage_monitor belongs to another column where voltage_V stands beside it
    known = [i for i, u in named if suits(quantity, u)] or [i for i, _ in named]
    if len(known) > 1:
        names = ", ".join(table.names[i] for i in known)
        raise InputRefused(
            f"{table.where}: {names} all claim to be the {quantity}: keep one, or say which in recordings.yaml, "
            f"columns: {{{quantity}: {{column: NAME}}}}"
        )
    return known[0] if known else None


def _unit(table: Table, index: int, quantity: str, said: Column) -> str:
    named, stated = stated_by_name(table.names[index], quantity), said.unit
    where = f"{table.where}: {table.label(index)}"
    # Whoever states a scale has looked at the numbers.
    if stated is not None and said.scale == 1.0 and suits(quantity, named) and _differ(stated, named or "", quantity):
        raise InputRefused(
            f"{where}: the name says {named}, recordings.yaml says {stated}: make them agree, or leave out the latter; "
            f"where the name is wrong, rename the column, or write its true unit by a scale (unit: {named}, scale: ...)"
        )
    return check_unit(quantity, stated if stated is not None else named, where)


def _differ(one: str, other: str, quantity: str) -> bool:
    """Whether two units give one number different values; of a quantity in any unit, units of one kind alone."""
    first, second = find_unit(one), find_unit(other)
    alike = first is None or second is None or first.si == second.si
    return first != second and (alike or QUANTITIES[quantity] is not None)


def unused(table: Table, channels: Mapping[str, Channel]) -> list[str]:
    """Header names that serve as no channel."""
    used = {channel.label for channel in channels.values()}
    return [name for i, name in enumerate(table.names) if name and table.label(i) not in used]
