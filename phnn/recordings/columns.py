"""The columns of a file that the manifest assigns to quantities."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from phnn.errors import InputRefused
from phnn.recordings.units import QUANTITIES, check_unit
from phnn.recordings.values import choice, keys_of, label, mapping, number, shown

DRIVING = ("input", "voltage", "force")
GAINS = ("known", "unknown")
# What may be missing beside numbers: cells without a number, and single samples far off their neighbours.
EMPTY, GLITCHES = "empty", "glitches"
AXES = ("time", "channel", "realisation", "period")


@dataclass(frozen=True)
class Column:
    """Where a quantity is found and how it is read: SI value = unit(scale × number).

    Attributes:
        gain: ``"unknown"`` where the number is proportional to what drives the system by an unknown factor.
        unwrap: the number by which a counter or an angle starts again, None where it does not.
        missing: numbers that mark a missing value; `EMPTY` for empty cells, `GLITCHES` for single samples far off.
    """

    place: int | str | None = None
    unit: str | None = None
    scale: float = 1.0
    gain: str = "known"
    unwrap: float | None = None
    missing: tuple[float | str, ...] = ()


def columns_of(value: Any, inherited: Mapping[str, Column], where: str) -> dict[str, Column]:
    """Columns by quantity, laid over inherited ones."""
    content = mapping(value, where)
    keys_of(content, QUANTITIES, where)
    columns = dict(inherited)
    for quantity, said in content.items():
        columns[quantity] = _column(said, columns.get(quantity, Column()), quantity, f"{where}: {quantity}")
    return columns


def variables_of(value: Any, inherited: Mapping[str, Column], where: str) -> dict[str, Column]:
    """Names of variables. Places given elsewhere no longer count (they describe other files), units still do."""
    content = mapping(value, where)
    columns = {quantity: replace(column, place=None) for quantity, column in inherited.items()}
    return columns_of(content, columns, where)


def named_of(value: Any, quantity: str, where: str) -> dict[str, Column]:
    """Columns by the name of a port or a storage."""
    content = {label(n, where): said for n, said in mapping(value, where).items()}
    columns = {n: _column(said, Column(), quantity, f"{where}: {n}") for n, said in content.items()}
    for name, column in columns.items():
        if name in QUANTITIES or column.place is None:
            cause = "is the name of a quantity" if name in QUANTITIES else "has no column"
            raise InputRefused(
                f"{where}: {shown(name)} {cause}: write NAME: {{column: ..., unit: ...}}, NAME of the network's"
            )
    return columns


def axes_of(value: Any, where: str) -> tuple[str, ...]:
    """What the axes of an array are."""
    axes = tuple(choice(v, AXES, where) for v in value) if isinstance(value, list) else ()
    if "time" not in axes or len(set(axes)) < len(axes):
        raise InputRefused(
            f"{where}: {shown(value)}: list the axes of the array in order, each once: {', '.join(AXES)}"
        )
    return axes


def _column(said: Any, inherited: Column, quantity: str, where: str) -> Column:
    if isinstance(said, (int, str)) and not isinstance(said, bool):
        said = {"column": said}
    content = mapping(said, where)
    keys_of(
        content, ("column", "unit", "scale", "unwrap", "missing", *(("gain",) if quantity in DRIVING else ())), where
    )
    column = inherited
    if "column" in content:
        place = content["column"]
        if isinstance(place, bool) or not isinstance(place, (int, str)) or (isinstance(place, int) and place < 0):
            raise InputRefused(
                f"{where}: column {shown(place)} is neither an index from 0 on nor a name: give one of them"
            )
        column = replace(column, place=place)
    if "unit" in content:
        column = replace(column, unit=check_unit(quantity, str(content["unit"]), where))
    if "gain" in content:
        column = replace(column, gain=choice(content["gain"], GAINS, f"{where}: gain"))
    if "unwrap" in content:
        column = replace(column, unwrap=number(content["unwrap"], f"{where}: unwrap", above=0.0))
    if "missing" in content:
        said = content["missing"] if isinstance(content["missing"], list) else [content["missing"]]
        marks = tuple(v if v in (EMPTY, GLITCHES) else number(v, f"{where}: missing") for v in said)
        column = replace(column, missing=marks)
    if "scale" in content:
        scale = number(content["scale"], f"{where}: scale")
        if scale == 0.0:
            raise InputRefused(f"{where}: scale 0 would erase the column: give the factor from number to {quantity}")
        column = replace(column, scale=scale)
    return column
