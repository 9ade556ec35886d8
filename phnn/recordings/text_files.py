"""Reading text: columns of numbers, below whatever an instrument writes above them.

Separator and decimal sign are those under which most lines are nothing but numbers; the rows begin with the first such
line. The names stand right above, with a row of units between them or none; what stands higher is left alone.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from phnn.errors import InputRefused
from phnn.intake.files import Source
from phnn.intake.limits import LIMITS
from phnn.intake.names import printable
from phnn.recordings.table import REMEDY_COMMA, Table, Where
from phnn.recordings.units import UNITS, parse_name, spelled

# A text takes about so many times its size while it is read.
_TIMES = 8
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f]")
_MARKS = "#%"
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
# Lines that are looked at to recognise the columns.
_LOOKED_AT = 60
_NUMBER = {
    sign: re.compile(rf"[-+]?(\d+{re.escape(sign)}?\d*|{re.escape(sign)}\d+)([eE][-+]?\d+)?|[-+]?(nan|inf)", re.I)
    for sign in ".,"
}
_WHOLE = re.compile(r"\s*[-+]?\d+([eE][-+]?\d+)?\s*")
# A word, with a unit in brackets behind it.
_WORD = re.compile(r"\S+(?:\s*[\[(][^\])]*[\])])?")


@dataclass(frozen=True)
class _Dialect:
    """How columns are separated (a blank stands for any white space), and the decimal sign."""

    separator: str
    decimal: str

    def cells(self, line: str) -> list[str]:
        """The cells of a line, quotes removed."""
        if self.separator == " ":
            return line.split()
        try:
            found = next(csv.reader([line], delimiter=self.separator, skipinitialspace=True), [])
        except csv.Error:
            return []
        return [cell.strip() for cell in found]

    def width(self, line: str) -> int:
        """How many columns of numbers a line has; 0 where a cell is none. Some may be empty."""
        cells = self.cells(line)
        filled = [cell for cell in cells if cell]
        return len(cells) if filled and all(_NUMBER[self.decimal].fullmatch(cell) for cell in filled) else 0


# Of several that fit as well, the first is meant. Commas may be both where the cells are quoted.
_DIALECTS = tuple(
    _Dialect(*pair)
    for pair in ((",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), (",", ","), (" ", "."), (" ", ","))
)


def read_text(source: Source) -> Table:
    """Columns separated by commas, semicolons, tabulators or blanks, numbers with a point or a comma as decimal sign.

    Raises:
        InputRefused: not text, no columns of numbers, damaged rows, rows of unequal length, a header of another length.
    """
    lines, ended = _lines(source)
    dialect, width = _recognised(lines)
    if not width:
        head = next(line.strip() for line in lines if line.strip())
        raise InputRefused(
            f"{source.name}: no rows of numbers in it, it begins with {head[:60]!r}: the recording is empty or no "
            f"table: record it again or remove it"
        )
    if width > LIMITS.text_columns:
        raise InputRefused(
            f"{source.name}: {width} columns, at most {LIMITS.text_columns} are accepted: write one row per sample"
        )
    first = next(i for i, line in enumerate(lines) if dialect.width(line) == width)
    names = _names(source, lines, first, dialect, width)
    if ended or not lines[first + 1 :]:
        return _parse(source, lines, first, names, dialect)
    if _breaks_off(lines[first:], dialect):
        note = f"its last line, {lines[-1].strip()[:40]!r}, was left out: the file ends within it"
        return replace(_parse(source, lines[:-1], first, names, dialect), notes=(note,))
    note = f"its last line, {lines[-1].strip()[:40]!r}, has no end: if the file was cut there, its last number is wrong"
    return replace(_parse(source, lines, first, names, dialect), notes=(note,))


def looks_like_numbers(source: Source) -> bool:
    """Whether a text file holds columns of numbers rather than prose."""
    try:
        lines, _ = _lines(source)
    except InputRefused:
        return False
    return _recognised(lines)[1] >= 2


def _breaks_off(rows: Sequence[str], dialect: _Dialect) -> bool:
    """Whether the last row lacks cells, or its last number digits that all other rows have in one number.

    What an instrument writes with a fixed number of digits shows it; of others nothing can be said.
    """
    last, *others = [dialect.cells(row) or [""] for row in reversed(rows)]
    if len(last) < min(len(cells) for cells in others) or not _NUMBER[dialect.decimal].fullmatch(last[-1]):
        return True
    formats = {_format(cells[-1], dialect.decimal) for cells in others}
    return len(formats) == 1 and formats != {_format(last[-1], dialect.decimal)}


def _format(number: str, decimal: str) -> tuple[int, int]:
    """Digits behind the decimal sign and in the exponent."""
    mantissa, _, exponent = number.lower().partition("e")
    return len(mantissa.partition(decimal)[2]), len(exponent.lstrip("+-"))


def _lines(source: Source) -> tuple[list[str], bool]:
    """The lines of a text, and whether the last of them ends as the others do."""
    source.check_memory(_TIMES * source.size)
    raw = source.read(LIMITS.text_bytes, "a text file")
    try:
        content = raw.decode("utf-16" if raw.startswith(_UTF16) else "utf-8-sig")
    except UnicodeDecodeError:
        content = raw.decode("latin-1")  # a micro sign written by older laboratory software
    del raw
    if not content or content.isspace():
        raise InputRefused(f"{source.name}: the file is empty: record it again or remove it")
    control = _CONTROL.search(content)
    if control is not None:
        raise InputRefused(
            f"{source.name}: not a text file (byte 0x{ord(control[0]):02x} at position {control.start()}): "
            f"export it again as plain text, or remove it from the folder"
        )
    lines = content.rstrip().splitlines()
    for i, line in enumerate(lines):
        if len(line) > LIMITS.line_characters:
            raise InputRefused(f"{source.name}: line {i + 1} has {len(line)} characters: write one row per sample")
    return lines, content.endswith(("\n", "\r"))


def _recognised(lines: Sequence[str]) -> tuple[_Dialect, int]:
    """The dialect under which most lines are rows of numbers, and how many columns these have; 0 where none are."""
    filled = [line for line in lines if line.strip() and line.strip()[0] not in _MARKS]
    shown = [filled[i] for i in np.unique(np.linspace(0, len(filled) - 1, _LOOKED_AT).astype(int))] if filled else []
    best, most, columns = _DIALECTS[0], 0, 0
    for dialect in _DIALECTS:
        widths = Counter(w for line in shown if (w := dialect.width(line)))
        width, count = max(widths.items(), key=lambda item: item[1], default=(0, 0))
        if count > most:
            best, most, columns = dialect, count, width
    return best, columns


def _names(source: Source, lines: Sequence[str], first: int, dialect: _Dialect, width: int) -> tuple[str, ...]:
    """Names of the columns from what stands above them; empty ones where nothing does."""
    above = [(i, lines[i].strip().lstrip(_MARKS).strip()) for i in range(first) if lines[i].strip().strip(_MARKS)]
    rows = [(i, _words(line, dialect, width)) for i, line in above[-2:]]
    if not rows:
        return ("",) * width
    line, nearest = rows[-1]
    if len(nearest) == width:
        if any(_NUMBER[dialect.decimal].fullmatch(cell) for cell in nearest):
            bad = next(cell for cell in nearest if not _NUMBER[dialect.decimal].fullmatch(cell))
            raise InputRefused(
                f"{source.name}: line {line + 1}: {bad[:40]!r} is not a number: correct or delete that row; if it is a "
                f"header, give every column a name in words"
            )
        if len(rows) == 2 and len(rows[0][1]) == width and all(_is_unit(cell) for cell in nearest):
            return tuple(_with_unit(name, unit) for name, unit in zip(rows[0][1], nearest, strict=True))
        return tuple(nearest)
    if any(parse_name(word) for word in nearest):
        _refuse_width(source, lines[first], first, dialect, len(nearest))
    return ("",) * width


def _words(line: str, dialect: _Dialect, width: int) -> list[str]:
    """The cells of a header. Between blanks, units in brackets belong to the word before them."""
    cells = dialect.cells(line)
    return _WORD.findall(line) if dialect.separator == " " and len(cells) != width else cells


def _is_unit(cell: str) -> bool:
    """Whether a cell is a unit, with or without brackets, or empty."""
    return not cell or (cell[0] in "([" and cell[-1] in ")]") or spelled(cell) in UNITS


def _with_unit(name: str, unit: str) -> str:
    """A column's name with the unit from the row below it, unless it has one."""
    known, bare = parse_name(name), unit.strip("()[] ")
    return name if not bare or (known is not None and known[1] is not None) else f"{name} [{bare}]"


def _refuse_width(source: Source, row: str, line: int, dialect: _Dialect, header: int) -> None:
    cells = dialect.cells(row)
    if dialect.separator == "," and len(cells) > header and all(_WHOLE.fullmatch(cell) for cell in cells):
        raise InputRefused(
            f"{source.name}: line {line + 1}: {row[:60]!r} has a comma as decimal sign, which here also separates the "
            f"columns: separate them by semicolons, or {REMEDY_COMMA}"
        )
    raise InputRefused(
        f"{source.name}: line {line + 1} has {len(cells)} cells, the header {header}: give every row the "
        f"header's columns"
    )


def _parse(source: Source, lines: Sequence[str], first: int, names: tuple[str, ...], dialect: _Dialect) -> Table:
    import pandas as pd

    try:
        frame = pd.read_csv(
            io.BytesIO("\n".join(lines[first:]).encode()),
            encoding="utf-8",
            header=None,
            sep=r"\s+" if dialect.separator == " " else dialect.separator,
            decimal=dialect.decimal,
            skipinitialspace=True,
            low_memory=False,
            skip_blank_lines=False,
        )
    except (pd.errors.ParserError, pd.errors.EmptyDataError, csv.Error) as error:
        found = re.search(r"line (\d+), saw (\d+)", str(error))
        if found is None:
            raise InputRefused(f"{source.name}: cannot be parsed ({error}): export it again") from error
        raise InputRefused(
            f"{source.name}: line {int(found[1]) + first} has {found[2]} cells, the rows before it {len(names)}: "
            f"delete the surplus cells; {REMEDY_COMMA}"
        ) from error
    shown = tuple(printable(name) for name in names)
    return Table(Where(source.name, first + 1), shown, tuple(_column(frame[i], dialect) for i in frame.columns))


def _column(column: object, dialect: _Dialect) -> np.ndarray:
    """One column; texts among the numbers leave these as they were written, with a point as decimal sign."""
    values = np.asarray(column)
    if values.dtype.kind != "O" or dialect.decimal == ".":
        return values
    return np.array([v.replace(",", ".") if isinstance(v, str) else v for v in values], dtype=object)
