"""Values of the package's plain dataclasses from json, every field of the type that it declares."""

from __future__ import annotations

import math
import typing
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from typing import Any, TypeVar

from phnn.intake.limits import LIMITS
from phnn.results import printable

T = TypeVar("T")
_SHOWN = 60
# The one text that is no name, and may be empty.
_PROSE = "description"


def of_fields(cls: type[T], content: Any, where: str) -> T:
    """A dataclass from an object of json.

    Args:
        cls: its fields are texts, numbers, truth values, lists of texts, or objects of ratios; fields called ``law`` of
            type ``Any`` are passed on.
        content: a value by the name of each field; those with a default may be absent.
        where: the element, for the message.

    Raises:
        ValueError: an unknown or missing field, or a value of another type.
    """
    given = an_object(content, where)
    hints, known = typing.get_type_hints(cls), {f.name: f for f in fields(cls)}  # type: ignore[arg-type]
    for name in given:
        if name not in known:
            raise ValueError(f"{where} has no field {brief(name)}; there are {', '.join(known)}")
    for name, f in known.items():
        if name not in given and f.default is MISSING and f.default_factory is MISSING:
            raise ValueError(f"{where} has no {name}")
    return cls(**{name: _typed(value, hints[name], name, where) for name, value in given.items()})


def an_object(content: Any, where: str) -> Mapping[str, Any]:
    """Read an object of json. Raises ValueError otherwise."""
    if not isinstance(content, Mapping):
        raise ValueError(f"{where} is {brief(content)}, no object")
    return content


def a_list(content: Any, where: str, most: int = LIMITS.elements) -> list[Any]:
    """A list of json of at most ``most`` entries. Raises ValueError otherwise, or if it is longer."""
    if not isinstance(content, list):
        raise ValueError(f"{where} is {brief(content)}, no list")
    if len(content) > most:
        raise ValueError(f"{where} has {len(content)} entries, at most {most} are accepted")
    return content


def a_text(value: Any, where: str) -> str:
    """A printable text. Raises ValueError otherwise, or if it is too long."""
    if not isinstance(value, str) or printable(value) != value:
        raise ValueError(f"{where} is {brief(value)}, no printable text")
    return value


def a_name(value: Any, where: str) -> str:
    """A printable text that is not empty and no longer than a name. Raises ValueError otherwise."""
    if not 0 < len(a_text(value, where)) <= LIMITS.name_characters:
        raise ValueError(f"{where} has {len(value)} characters: 1 to {LIMITS.name_characters} are accepted")
    return str(value)


def a_number(value: Any, where: str) -> float:
    """Read a finite number. Raises ValueError otherwise."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{where} is {brief(value)}, no finite number")
    return float(value)


def a_count(value: Any, where: str, least: int, most: int) -> int:
    """Read a whole number from ``least`` to ``most``. Raises ValueError otherwise."""
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise ValueError(f"{where} = {brief(value)} is no whole number from {least} to {most}")
    return value


def brief(value: Any) -> str:
    """The beginning of a value, for messages."""
    return printable(repr(value)[:_SHOWN])


def _ratio(value: Any, where: str) -> str | float:
    return a_name(value, where) if isinstance(value, str) else a_number(value, where)


def _ratios(value: Any, where: str) -> dict[str, str | float]:
    return {a_name(n, where): _ratio(v, where) for n, v in an_object(value, where).items()}


def _names(value: Any, where: str) -> tuple[str, ...]:
    return tuple(a_name(v, where) for v in a_list(value, where))


def _combinations(value: Any, where: str) -> tuple[str | Mapping[str, str | float], ...]:
    return tuple(a_name(v, where) if isinstance(v, str) else _ratios(v, where) for v in a_list(value, where))


def _perhaps(value: Any, where: str) -> str | None:
    return None if value is None else a_name(value, where)


def _flag(value: Any, where: str) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{where} is {brief(value)}, neither true nor false")
    return value


_MAKERS: dict[Any, Callable[[Any, str], Any]] = {
    str: a_name,
    float: a_number,
    bool: _flag,
    Any: lambda value, where: value,
    str | float: _ratio,
    str | None: _perhaps,
    tuple[str, ...]: _names,
    tuple[str | Mapping[str, str | float], ...]: _combinations,
    Mapping[str, str | float]: _ratios,
}


def _typed(value: Any, hint: Any, name: str, where: str) -> Any:
    make = a_text if name == _PROSE else _MAKERS[hint]
    return make(value, f"{name} of {where}")
