"""Reading json: an object of arrays of numbers, in groups or not, or a list of records with the same keys."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from phnn.errors import InputRefused
from phnn.intake.files import Source
from phnn.intake.limits import LIMITS
from phnn.recordings.table import Table, Where
from phnn.recordings.text_files import read_content
from phnn.results import printable

# A text takes at most so many times its size while it is read: an object of 32 bytes for each "0,", and itself.
_TIMES = 20
_SHOWN, _LISTED = 40, 5
_REMEDY = "save it as an object of arrays of equal length, or as a list of records with the same keys"


class NoRecording(InputRefused):
    """Sound json that holds no arrays of numbers: settings, results, a description."""


def read_json(source: Source) -> Table:
    """Return the arrays of numbers by name; ``null`` and ``NaN`` are missing samples.

    Raises:
        NoRecording: it is json of another kind.
        InputRefused: it is damaged, too large, not json, or a sample is no number.
    """
    source.check_memory(_TIMES * source.size)
    text = read_content(source, LIMITS.json_bytes, "a json recording")
    left: list[str] = []
    try:
        content = json.loads(text, parse_int=float, object_pairs_hook=_once)
        columns = dict(_columns(content, "", 0, left))
    except RecursionError as error:
        raise InputRefused(f"{source.name}: objects or lists too deep in one another: {_REMEDY}") from error
    except ValueError as error:
        if isinstance(error, json.JSONDecodeError):
            cause = f"line {error.lineno}, column {error.colno}: not json ({error.msg}): the file is damaged or was cut"
            raise InputRefused(f"{source.name}: {cause}: save it again") from error
        raise InputRefused(f"{source.name}: {error}") from error
    if not columns:
        raise NoRecording(f"{source.name}: no arrays of numbers in it: {_REMEDY}")
    notes: tuple[str, ...] = ()
    if left:
        more = " and more" if len(left) > _LISTED else ""
        notes = (f"{', '.join(left[:_LISTED])}{more} are no arrays of numbers and were left alone",)
    return Table(Where(source.name), tuple(columns), tuple(columns.values()), by_name=True, notes=notes)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        names = [key for key, _ in pairs]
        twice = next(key for key in names if names.count(key) > 1)
        raise ValueError(f"the key {printable(twice[:_SHOWN])!r} stands twice: give every array a name of its own")
    if len(content) > LIMITS.variables:
        raise ValueError(f"an object of more than {LIMITS.variables} keys: save one recording in a file")
    return content


def _columns(content: Any, prefix: str, depth: int, left: list[str]) -> Iterator[tuple[str, np.ndarray]]:
    """Yield names and numbers of all arrays; ``left`` takes the names of what is none."""
    if depth > LIMITS.depth:
        raise ValueError(f"objects more than {LIMITS.depth} levels deep: {_REMEDY}")
    if isinstance(content, dict):
        for key, value in content.items():
            name = prefix + printable(key[: LIMITS.name_characters])
            if isinstance(value, list) and value and isinstance(value[0], float | None):
                yield name, _numbers(value, name)
            elif isinstance(value, dict) or (isinstance(value, list) and value and isinstance(value[0], dict)):
                yield from _columns(value, f"{name}.", depth + 1, left)
            else:
                left.append(name)
    elif isinstance(content, list) and content and isinstance(content[0], dict):
        first = content[0]
        for i, record in enumerate(content, start=1):
            if not isinstance(record, dict) or record.keys() != first.keys():
                odd = sorted(set(first) ^ set(record))[0] if isinstance(record, dict) else str(record)
                raise ValueError(f"record {i} has other keys ({odd[:_SHOWN]!r}): give every record the same keys")
        for key in (k for k in first if isinstance(first[k], float | None)):
            name = prefix + printable(key[: LIMITS.name_characters])
            yield name, _numbers([record[key] for record in content], name)


def _numbers(values: list[Any], name: str) -> np.ndarray:
    """Return the numbers of an array, missing ones as NaN."""
    for i, value in enumerate(values, start=1):
        if not isinstance(value, float | None):
            raise ValueError(
                f"{name}, row {i}: {printable(repr(value)[:_SHOWN])} is no number: write numbers with a point as "
                f"decimal sign, and null where a sample is missing"
            )
    return np.array([np.nan if value is None else value for value in values])
