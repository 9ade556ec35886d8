"""Reading .json recordings: an object of arrays, or a list of records.

    {"time_s": [0, 0.001], "voltage_V": [0, 1.5], "displacement_m": [0, 2e-7]}
    [{"time_s": 0, "voltage_V": 0, "displacement_m": 0}, {"time_s": 0.001, "voltage_V": 1.5, "displacement_m": 2e-7}]

Objects in an object are groups: their arrays are called ``group.name``. The text is never turned into python objects as
a whole, which would take 25 times its size: arrays are converted a block at a time, records one by one.
"""

from __future__ import annotations

import itertools
import json
import re
from array import array
from collections.abc import Iterator
from json.decoder import scanstring  # type: ignore[attr-defined]
from typing import Any

import numpy as np

from phnn.errors import InputRefused
from phnn.intake.files import Source, shown_bytes
from phnn.intake.limits import LIMITS
from phnn.recordings.lines import read_content
from phnn.recordings.table import Table, Where
from phnn.results import printable

# A text takes at most so many times its size while it is read: itself, its bytes, and 8 bytes for each "0,".
_TIMES = 8
_NUMBER = r"(?:-?(?:0|[1-9][0-9]*)(?:\.[0-9]+)?(?:[eE][-+]?[0-9]+)?|null|NaN|-?Infinity)"
_ONE, _MANY = (re.compile(text) for text in (rf"\s*{_NUMBER}\s*", rf"\s*{_NUMBER}\s*(?:,\s*{_NUMBER}\s*)*+"))
_BLANK = re.compile(r"[ \t\n\r]*")
# Characters of an array that are converted at once; characters and names that a message shows.
_BLOCK, _SHOWN, _LISTED = 2**20, 40, 5
_REMEDY = "save it as an object of arrays of equal length, or as a list of records with the same keys"
# Duplicate keys must be seen, so pairs are kept; whole numbers of any length become floats.
_RECORD = json.JSONDecoder(object_pairs_hook=list, parse_int=float)


class NoRecording(InputRefused):
    """Sound json that holds no arrays of numbers: settings, results, a description."""


def read_json(source: Source) -> Table:
    """The arrays of numbers by name; ``null`` and ``NaN`` are missing samples.

    Raises:
        NoRecording: it is json of another kind.
        InputRefused: it is damaged, too large, not json, or a sample is no number.
    """
    source.check_memory(_TIMES * source.size)
    text = _Text(source.name, read_content(source, LIMITS.json_bytes, "a json recording"))
    at = text.blank(0)
    columns: dict[str, np.ndarray] = {}
    left: list[str] = []
    if text.at(at) == "[":
        found, end = text.records(at, "")
        columns = found
    elif text.at(at) == "{":
        end = text.members(at, "", 0, columns, left)
    else:
        text.fail(at, "is neither an object nor a list", _REMEDY)
    if text.blank(end) < len(text.content):
        text.fail(text.blank(end), "follows behind the end", "save the file again")
    if not columns:
        raise NoRecording(f"{source.name}: no arrays of numbers in it: {_REMEDY}")
    notes: tuple[str, ...] = ()
    if left:
        more = " and more" if len(left) > _LISTED else ""
        notes = (f"{', '.join(left[:_LISTED])}{more} are no arrays of numbers and were left alone",)
    return Table(Where(source.name), tuple(columns), tuple(columns.values()), by_name=True, notes=notes)


class _Text:
    """A json text that is read from left to right; positions are characters from 0."""

    def __init__(self, name: str, content: str) -> None:
        self.name, self.content = name, content

    def blank(self, at: int) -> int:
        """The first character from ``at`` on that is no white space."""
        found = _BLANK.match(self.content, at)
        assert found is not None
        return found.end()

    def at(self, at: int) -> str:
        """The character there; empty behind the end."""
        return self.content[at : at + 1]

    def fail(self, at: int, cause: str, remedy: str) -> None:
        """Refuse what stands at a position. Raises InputRefused."""
        line = self.content.count("\n", 0, at) + 1
        column = at - self.content.rfind("\n", 0, at)
        shown = repr(self.content[at : at + _SHOWN]) if at < len(self.content) else "the end of the file"
        raise InputRefused(f"{self.name}: line {line}, column {column}: {printable(shown)} {cause}: {remedy}")

    def expect(self, at: int, wanted: str) -> int:
        """The next character but white space must be one of those wanted; its position."""
        at = self.blank(at)
        if not self.at(at) or self.at(at) not in wanted:
            self.fail(
                at, f"stands where {' or '.join(wanted)} belongs", "the file is damaged or was cut: save it again"
            )
        return at

    def key(self, at: int) -> tuple[str, int]:
        """The key whose quotation mark stands at a position, and where the value behind it begins."""
        try:
            name, end = scanstring(self.content, at + 1, True)
        except ValueError:
            self.fail(at, "is no closed text", "the file is damaged or was cut: save it again")
        return printable(name[: LIMITS.name_characters]), self.blank(self.expect(end, ":") + 1)

    def members(self, at: int, prefix: str, depth: int, columns: dict[str, np.ndarray], left: list[str]) -> int:
        """Collect the arrays of an object; the position behind it."""
        if depth > LIMITS.groups:
            self.fail(at, f"lies more than {LIMITS.groups} objects deep", _REMEDY)
        at = self.expect(at + 1, '"}')
        seen: set[str] = set()
        while self.at(at) == '"':
            key, value = self.key(at)
            if key in seen:
                self.fail(at, "is a key for the second time", "give every array a name of its own")
            seen.add(key)
            if len(columns) + len(left) > LIMITS.variables:
                self.fail(at, f"is the key behind {LIMITS.variables} others", "save one recording in a file")
            end = self.value(value, prefix + key, depth, columns, left)
            at = self.expect(end, ",}")
            if self.at(at) == ",":
                at = self.expect(at + 1, '"')
        return at + 1

    def value(self, at: int, name: str, depth: int, columns: dict[str, np.ndarray], left: list[str]) -> int:
        """Read one member of an object; the position behind it."""
        kind = self.at(at)
        inner = self.at(self.blank(at + 1)) if kind == "[" else ""
        if kind == "{":
            return self.members(at, f"{name}.", depth + 1, columns, left)
        if inner == "{":
            found, end = self.records(at, f"{name}.")
            columns |= found
            return end
        if inner and inner in "-0123456789nNI":
            columns[name], end = self.numbers(at, name)
            return end
        left.append(name)
        return self.other(at)

    def other(self, at: int) -> int:
        """Pass over a value that is no array of numbers; the position behind it."""
        most = LIMITS.yaml_bytes
        try:
            return at + int(json.JSONDecoder(parse_int=float).raw_decode(self.content[at : at + most])[1])
        except (ValueError, RecursionError) as error:
            stopped = at + int(getattr(error, "pos", 0))
            if len(self.content) - at > most or isinstance(error, RecursionError):
                self.fail(at, f"begins a value of more than {shown_bytes(most)} that is no array of numbers", _REMEDY)
            self.fail(min(stopped, len(self.content)), "is not json", "the file is damaged or was cut: save it again")
        raise AssertionError

    def numbers(self, at: int, name: str) -> tuple[np.ndarray, int]:
        """The array of numbers whose bracket stands at a position, and the position behind it."""
        end = self.content.find("]", at)
        if end < 0:
            self.fail(at, "begins an array that has no end", "the file was cut: save it again")
        found = array("d")
        for begin, stop in self._blocks(at + 1, end):
            block = self.content[begin:stop]
            if not _MANY.fullmatch(block):
                self._refuse_number(begin, block, name, len(found))
            found.extend(map(float, block.replace("null", "NaN").split(",")))
        return np.frombuffer(found, dtype=float), end + 1

    def _blocks(self, begin: int, end: int) -> Iterator[tuple[int, int]]:
        """Stretches between two commas each."""
        while begin <= end:
            stop = self.content.find(",", min(begin + _BLOCK, end), end)
            stop = end if stop < 0 else stop
            yield begin, stop
            begin = stop + 1

    def _refuse_number(self, begin: int, block: str, name: str, count: int) -> None:
        for i, part in enumerate(block.split(",")):
            if not _ONE.fullmatch(part):
                at = min(self.blank(begin), begin + len(part))
                cause = f"is {name}[{count + i}], where a number belongs"
                self.fail(at, cause, "write numbers with a point as decimal sign, and null where a sample is missing")
            begin += len(part) + 1

    def records(self, at: int, prefix: str) -> tuple[dict[str, np.ndarray], int]:
        """The columns of a list of records, and the position behind it; keys in any order, the same in each."""
        at = self.expect(at + 1, "{]") if prefix or self.at(self.blank(at + 1)) in ("{", "]", "") else at + 1
        if self.at(at) == "]":
            return {}, at + 1
        if self.at(at) != "{":
            # Valid json of another kind: an array without names.
            raise NoRecording(f"{self.name}: a list whose entries are no records: {_REMEDY}")
        first, _ = self._record(at, 1)
        keys = list(first)
        numeric = [k for k in keys if not isinstance(first[k], str | bool | list)]
        columns = {k: array("d") for k in numeric}
        for number in itertools.count(1):
            record, end = self._record(at, number)
            if record.keys() != first.keys():
                odd = sorted(set(keys) ^ set(record))[0]
                has = "lacks" if odd in keys else "alone has"
                self.fail(at, f"is record {number}, which {has} {odd!r}", "give every record the same keys")
            for key, column in columns.items():
                column.append(self._sample(record[key], at, number, key))
            at = self.expect(end, ",]")
            if self.at(at) == "]":
                break
            at = self.expect(at + 1, "{")
        named = {prefix + printable(k[: LIMITS.name_characters]): np.frombuffer(c) for k, c in columns.items()}
        return named, at + 1

    def _record(self, at: int, number: int) -> tuple[dict[str, Any], int]:
        """One record without objects in it, and the position behind it."""
        end = self.content.find("}", at, at + LIMITS.line_characters) + 1
        if not end:
            self.fail(at, f"begins record {number}, which has no end", "the file was cut or a record is too long")
        try:
            pairs = _RECORD.decode(self.content[at:end])
        except (ValueError, RecursionError) as error:
            self.fail(
                at + min(int(getattr(error, "pos", 0)), end - at), f"is not json, in record {number}",
                "write one number for each key",
            )  # fmt: skip
        record = dict(pairs)
        if len(record) < len(pairs) or len(record) > LIMITS.text_columns:
            cause = "has a key twice" if len(record) < len(pairs) else f"has more than {LIMITS.text_columns} keys"
            self.fail(at, f"is record {number}, which {cause}", "give every column a name of its own")
        return record, end

    def _sample(self, value: Any, at: int, number: int, key: str) -> float:
        if value is None:
            return float("nan")
        if not isinstance(value, float):
            shown = printable(repr(value)[:_SHOWN])
            self.fail(
                at, f"is record {number}, where {key[:_SHOWN]} is {shown} and no number",
                "write numbers, and null where a sample is missing",
            )  # fmt: skip
        return float(value)
