"""Reading .csv files and white-space separated text."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

import numpy as np

from phnn.errors import InputRefused
from phnn.recordings.table import DECIMAL_COMMA, REMEDY_COMMA, Table, Where
from phnn.recordings.units import parse_name

_LONGEST_HEADER = 100_000
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f]")


def read_csv(path: Path) -> Table:
    """A comma-separated file; its header row is optional where the manifest gives columns by index.

    Raises:
        InputRefused: not text, empty, other separators, a comma as decimal sign, rows of unequal length.
    """
    lines = _lines(path)
    start, _ = _skip_comments(lines)
    head = lines[start]
    if len(head) > _LONGEST_HEADER:
        raise InputRefused(f"{path.name}: line {start + 1} has {len(head)} characters: write one row per sample")
    sample = lines[start : start + 20]
    if any(";" in line for line in sample):
        raise InputRefused(
            f"{path.name}: line {start + 1}: semicolons separate the columns ({head[:60]!r}): save it with commas "
            f"as separator and a point as decimal sign"
        )
    if "," not in head:
        raise InputRefused(
            f"{path.name}: line {start + 1}: no comma in {head[:60]!r}: separate the columns by commas, "
            f"or name the file .txt where white space separates them"
        )
    cells = next(csv.reader([head]))
    header = not all(_is_number(cell) for cell in cells)
    names = tuple(cell.strip() for cell in cells) if header else ("",) * len(cells)
    first = start + 1 if header else start
    if first >= len(lines):
        raise InputRefused(f"{path.name}: a header but no rows: the recording is empty, record it again or remove it")
    _check_width(path, lines[first], len(cells), first)
    return _parse(path, lines, first, names, ",")


def read_text(path: Path) -> Table:
    """White-space separated columns, with or without a header (a commented header counts).

    Raises:
        InputRefused: not text, empty, commas or semicolons between or in the numbers, rows of unequal length.
    """
    lines = _lines(path)
    start, comments = _skip_comments(lines)
    cells = lines[start].split()
    header = not all(_is_number(cell) for cell in cells) and not any(DECIMAL_COMMA.match(c) for c in cells)
    first = start + 1 if header else start
    if first >= len(lines):
        raise InputRefused(f"{path.name}: a header but no rows: the recording is empty, record it again or remove it")
    row = lines[first]
    if ";" in row or "," in row:
        sign = ";" if ";" in row else ","
        raise InputRefused(
            f"{path.name}: line {first + 1}: {sign!r} in {row[:60]!r}: {REMEDY_COMMA} and white space between columns, "
            f"or name the file .csv where commas separate the columns"
        )
    width = len(row.split())
    names = tuple(cells) if header else ("",) * width
    if not header and comments:
        said = comments[-1].lstrip("#% \t").split()
        if len(said) == width and any(parse_name(word) for word in said):
            names = tuple(said)
    if len(names) != width:
        raise InputRefused(
            f"{path.name}: line {first + 1} has {width} columns, its header {len(names)}: write one word per column "
            f"in the header, such as voltage_V"
        )
    return _parse(path, lines, first, names, r"\s+")


def looks_like_numbers(path: Path) -> bool:
    """Whether a .dat or .txt file holds columns of numbers rather than prose."""
    try:
        lines = _lines(path)
        start, _ = _skip_comments(lines)
    except InputRefused:
        return False
    rows = [line.replace(",", ".").replace(";", " ").split() for line in lines[start : start + 12]]
    body = rows[1:]
    return len(body) > 0 and all(len(r) >= 2 and all(_is_number(cell) for cell in r) for r in body)


def _lines(path: Path) -> list[str]:
    raw = path.read_bytes()
    if not raw.strip():
        raise InputRefused(f"{path.name}: the file is empty: record it again or remove it")
    try:
        content = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        content = raw.decode("latin-1")  # a micro sign written by older laboratory software
    control = _CONTROL.search(content)
    if control is not None:
        raise InputRefused(
            f"{path.name}: not a text file (byte 0x{ord(control[0]):02x} at position {control.start()}): "
            f"export it again as plain text, or remove it from the folder"
        )
    return content.rstrip().splitlines()


def _skip_comments(lines: list[str]) -> tuple[int, list[str]]:
    """Index of the first line that is neither blank nor a comment, and the comments before it."""
    comments: list[str] = []
    for i, line in enumerate(lines):
        stripped = line.strip()
        if stripped and stripped[0] not in "#%":
            return i, comments
        if stripped:
            comments.append(stripped)
    return len(lines) - 1, comments


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _check_width(path: Path, row: str, width: int, line: int) -> None:
    cells = next(csv.reader([row]))
    if len(cells) == width:
        return
    whole = all(re.fullmatch(r"\s*[-+]?\d+([eE][-+]?\d+)?\s*", cell) for cell in cells)
    if len(cells) > width and whole:
        raise InputRefused(
            f"{path.name}: line {line + 1}: {row[:60]!r} has a comma as decimal sign, which here also separates the "
            f"columns: {REMEDY_COMMA}"
        )
    raise InputRefused(
        f"{path.name}: line {line + 1} has {len(cells)} cells, the header {width}: give every row the header's columns"
    )


def _parse(path: Path, lines: list[str], first: int, names: tuple[str, ...], separator: str) -> Table:
    import pandas as pd

    try:
        frame = pd.read_csv(
            io.StringIO("\n".join(lines[first:])),
            header=None,
            sep=separator,
            low_memory=False,
            skip_blank_lines=False,
        )
    except (pd.errors.ParserError, pd.errors.EmptyDataError, csv.Error) as error:
        found = re.search(r"line (\d+), saw (\d+)", str(error))
        if found is None:
            raise InputRefused(f"{path.name}: cannot be parsed ({error}): export it again") from error
        raise InputRefused(
            f"{path.name}: line {int(found[1]) + first} has {found[2]} cells, the rows before it {len(names)}: "
            f"delete the surplus cells; {REMEDY_COMMA}"
        ) from error
    columns = tuple(np.asarray(frame[i]) for i in frame.columns)
    return Table(Where(path.name, first + 1), names, columns)
