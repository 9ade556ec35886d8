"""Reading text: columns of numbers, below whatever an instrument writes above them.

Separator and decimal sign are those under which most lines are nothing but numbers; the rows begin with the first such
line. The names stand right above, with a row of units between them or none; what stands higher is left alone.
"""

from __future__ import annotations

import csv
import io
import itertools
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from phnn.errors import InputRefused
from phnn.intake.files import Source
from phnn.intake.limits import LIMITS
from phnn.recordings.lines import Lines, read_lines
from phnn.recordings.table import REMEDY_COMMA, Table, Where
from phnn.recordings.units import find_unit, parse_name
from phnn.results import printable

# An instrument that writes a segment at a time repeats its header: lines of ``name: value``, the names of the
# columns, a line of units. The line of names tells such a header: it is the same in all. Each table is a segment, a
# recording.

# A line that may be a row of numbers; whether it is one is seen when it is converted.
_ROW = re.compile(r"[-+0-9.,;eE\s\"naifNAIF]*[0-9naifNAIF\"][-+0-9.,;eE\s\"naifNAIF]*")
_SHOWN = 40


class Block(NamedTuple):
    """Lines ``[first, last)`` of a text that hold the rows of one table, counted from 0."""

    first: int
    last: int


def blocks(name: str, text: Lines, first: int, header: Sequence[str]) -> list[Block]:
    """The tables of a text, the first of which begins at a line; one where no header is repeated.

    Args:
        name: of the file, for messages.
        header: the line of names and what stands between it and the first row; empty where there are no names.

    Raises:
        InputRefused: a repeated header has other units, or there are more tables than recordings in a folder.
    """
    names = header[0].strip() if header else ""
    if not names or text.content.count(names) < 2:
        return [Block(first, text.count)]
    found, begin = [], first
    for above, below, lines in _headers(text, first, names):
        at = next(i for i, line in enumerate(lines) if line.strip() == names)
        under = [line.strip() for line in lines[at + 1 :] if line.strip()]
        wanted = [line.strip() for line in header[1:] if line.strip()]
        if under != wanted:
            differs = next((line for line in under if line not in wanted), "nothing")
            raise InputRefused(
                f"{name}: line {above + at + 2}: {differs[:_SHOWN]!r} stands under the names of this table, "
                f"{' '.join(wanted)[:_SHOWN]!r} under those of the first: give all tables of a file the same units, or "
                f"split the file"
            )
        found.append(Block(begin, above))
        begin = below
        if len(found) >= LIMITS.recordings:
            raise InputRefused(f"{name}: more than {LIMITS.recordings} tables in one file: divide them among files")
    return [b for b in [*found, Block(begin, text.count)] if b.last > b.first]


def _headers(text: Lines, first: int, names: str) -> list[tuple[int, int, list[str]]]:
    """Runs of lines that are no rows and hold the names: the first line, the one behind, and the lines."""
    found: list[tuple[int, int, list[str]]] = []
    run: list[str] = []
    begin, number = 0, 0
    for number, line in enumerate(text):
        if number < first:
            continue
        if not _ROW.fullmatch(line):
            begin = begin if run else number
            run.append(line)
            continue
        if run and any(other.strip() == names for other in run):
            found.append((begin, number, run))
        run = []
    # Nothing is measured under the last header.
    if run and any(other.strip() == names for other in run):
        found.append((begin, number + 1, run))
    return found


_MARKS = "#%"
# Lines that are looked at to recognise the columns.
_LOOKED_AT = 60
_WHOLE = re.compile(r"\s*[-+]?\d+([eE][-+]?\d+)?\s*")
# A word, with a unit in brackets behind it.
_WORD = re.compile(r"\S+(?:\s*[\[(][^\])]*[\])])?")


@dataclass(frozen=True)
class Dialect:
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
        return len(cells) if filled and all(NUMBER[self.decimal].fullmatch(cell) for cell in filled) else 0


# Of several that fit as well, the first is meant. Commas may be both where the cells are quoted.
_DIALECTS = tuple(
    Dialect(*pair)
    for pair in ((",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), (",", ","), (" ", "."), (" ", ","))
)


def read_text(source: Source) -> Table:
    """Columns separated by commas, semicolons, tabulators or blanks, numbers with a point or a comma as decimal sign.

    Raises:
        InputRefused: not text, no columns of numbers, damaged rows, rows of unequal length, a header of another length.
    """
    text = read_lines(source)
    dialect, width = _recognised(text)
    if not width:
        head = next(line.strip() for line in text if line.strip())
        raise InputRefused(
            f"{source.name}: no rows of numbers in it, it begins with {head[:60]!r}: the recording is empty or no "
            f"table: record it again or remove it"
        )
    if width > LIMITS.text_columns:
        raise InputRefused(
            f"{source.name}: {width} columns, at most {LIMITS.text_columns} are accepted: write one row per sample"
        )
    first = next(i for i, line in enumerate(text) if dialect.width(line) == width)
    above = list(itertools.islice(text, first + 1))
    names = _names(source, above, first, dialect, width)
    tables = blocks(source.name, text, first, _header(above, first, dialect, width) if any(names) else ())
    notes: tuple[str, ...] = ()
    if len(tables) > 1:
        notes = (f"{len(tables)} tables stand in the file, each below a header: each is a recording of its own",)
    begin, end = tables[-1]
    if text.ended or end == begin + 1 or end < text.count:
        return replace(parsed(source, text, tables, names, dialect), notes=notes)
    *_, last = text
    others = (line for _, lines, _ in pieces(text, [*tables[:-1], Block(begin, end - 1)]) for line in lines)
    if _breaks_off(others, last, dialect):
        note = f"its last line, {last.strip()[:40]!r}, was left out: the file ends within it"
        tables = [*tables[:-1], Block(begin, end - 1)]
    else:
        note = f"its last line, {last.strip()[:40]!r}, has no end: if the file was cut there, its last number is wrong"
    return replace(parsed(source, text, tables, names, dialect), notes=(*notes, note))


def looks_like_numbers(source: Source) -> bool:
    """Whether a text file holds columns of numbers rather than prose."""
    try:
        return _recognised(read_lines(source))[1] >= 2
    except InputRefused:
        return False


def _breaks_off(others: Iterable[str], row: str, dialect: Dialect) -> bool:
    """Whether the last row lacks cells, or its last number digits that all other rows have in one number.

    What an instrument writes with a fixed number of digits shows it; of others nothing can be said.
    """
    last = dialect.cells(row) or [""]
    fewest, formats = LIMITS.text_columns + 1, set()
    for other in others:
        cells = dialect.cells(other) or [""]
        fewest = min(fewest, len(cells))
        formats.add(_format(cells[-1], dialect.decimal))
    if len(last) < fewest or not NUMBER[dialect.decimal].fullmatch(last[-1]):
        return True
    return len(formats) == 1 and formats != {_format(last[-1], dialect.decimal)}


def _format(number: str, decimal: str) -> tuple[int, int]:
    """Digits behind the decimal sign and in the exponent."""
    mantissa, _, exponent = number.lower().partition("e")
    return len(mantissa.partition(decimal)[2]), len(exponent.lstrip("+-"))


def _recognised(text: Lines) -> tuple[Dialect, int]:
    """The dialect under which most lines are rows of numbers, and how many columns these have; 0 where none are."""
    counts = [len(_filled(block)) for block in text.blocks()]
    count, before = sum(counts), 0
    chosen = np.unique(np.linspace(0, count - 1, _LOOKED_AT).astype(int)) if count else np.zeros(0, int)
    shown: list[str] = []
    for block, size in zip(text.blocks(), counts, strict=True):
        here = chosen[(chosen >= before) & (chosen < before + size)] - before
        if here.size:
            filled = _filled(block)
            shown += [filled[i] for i in here]
        before += size
    best, most, columns = _DIALECTS[0], 0, 0
    for dialect in _DIALECTS:
        widths = Counter(w for line in shown if (w := dialect.width(line)))
        width, count = max(widths.items(), key=lambda item: item[1], default=(0, 0))
        if count > most:
            best, most, columns = dialect, count, width
    return best, columns


def _filled(lines: Sequence[str]) -> list[str]:
    """Lines that are neither empty nor a remark."""
    return [line for line in lines if line.strip() and line.strip()[0] not in _MARKS]


def _names(source: Source, lines: Sequence[str], first: int, dialect: Dialect, width: int) -> tuple[str, ...]:
    """Names of the columns from what stands above them; empty ones where nothing does."""
    above = [(i, lines[i].strip().lstrip(_MARKS).strip()) for i in range(first) if lines[i].strip().strip(_MARKS)]
    rows = [(i, _words(line, dialect, width)) for i, line in above[-2:]]
    if not rows:
        return ("",) * width
    line, nearest = rows[-1]
    if len(nearest) == width:
        if any(NUMBER[dialect.decimal].fullmatch(cell) for cell in nearest):
            bad = next(cell for cell in nearest if not NUMBER[dialect.decimal].fullmatch(cell))
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


def _header(lines: Sequence[str], first: int, dialect: Dialect, width: int) -> Sequence[str]:
    """The line of names and what stands below it, above the first row."""
    filled = [i for i in range(first) if lines[i].strip().strip(_MARKS)]
    rows = [_words(lines[i].strip().lstrip(_MARKS).strip(), dialect, width) for i in filled[-2:]]
    units = len(rows) == 2 and all(len(row) == width for row in rows) and all(_is_unit(cell) for cell in rows[1])
    return lines[filled[-2 if units else -1] : first]


def _words(line: str, dialect: Dialect, width: int) -> list[str]:
    """The cells of a header. Between blanks, units in brackets belong to the word before them."""
    cells = dialect.cells(line)
    return _WORD.findall(line) if dialect.separator == " " and len(cells) != width else cells


def _is_unit(cell: str) -> bool:
    """Whether a cell is a unit, with or without brackets, or empty."""
    return not cell or (cell[0] in "([" and cell[-1] in ")]") or find_unit(cell) is not None


def _with_unit(name: str, unit: str) -> str:
    """A column's name with the unit from the row below it, unless it has one."""
    known, bare = parse_name(name), unit.strip("()[] ")
    return name if not bare or (known is not None and known[1] is not None) else f"{name} [{bare}]"


def _refuse_width(source: Source, row: str, line: int, dialect: Dialect, header: int) -> None:
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


if TYPE_CHECKING:
    import pandas as pd

NUMBER = {
    sign: re.compile(rf"[-+]?(\d+{re.escape(sign)}?\d*|{re.escape(sign)}\d+)([eE][-+]?\d+)?|[-+]?(nan|inf)", re.I)
    for sign in ".,"
}


def parsed(
    source: Source, text: Lines, tables: Sequence[tuple[int, int]], names: tuple[str, ...], dialect: Dialect
) -> Table:
    """The columns of the lines ``[first, last)`` of one or several tables of a text, counted from 0, ascending.

    They are parsed a few thousand at a time: cells take many times the memory of their numbers.

    Raises:
        InputRefused: rows of unequal length, or cells that cannot be told apart.
    """
    total = sum(last - first for first, last in tables)
    columns: list[np.ndarray] = []
    head, done = "", 0
    starts: list[tuple[int, int]] = []
    for begin, here, table in pieces(text, tables):
        if len(starts) <= table:
            starts.append((done, begin))
        # The first row of all stands above every block: it says how many cells the others have.
        head = head or here[0]
        frame = _frame(source, [head, *here], begin - 1, len(names), dialect).iloc[1:]
        columns = columns or [np.empty(total) for _ in frame.columns]
        found = [_column(frame[i], dialect) for i in frame.columns]
        for i, values in enumerate(found):
            if values.dtype.kind not in "iuf" and columns[i].dtype.kind != "O":
                columns[i] = columns[i].astype(object)
            columns[i][done : done + values.size] = values
        done += len(frame)
    shown = tuple(printable(name) for name in names)
    between = tuple((row, line - row - starts[0][1]) for row, line in starts[1:])
    where = Where(source.name, starts[0][1] + 1, between=between)
    # Cells in quotes may reach over several lines.
    return Table(where, shown, tuple(column[:done] for column in columns), segments=tuple(row for row, _ in between))


def pieces(text: Lines, tables: Sequence[tuple[int, int]]) -> Iterator[tuple[int, list[str], int]]:
    """Rows in blocks of some thousand lines: the number of the first line, the lines, and the number of their table."""
    line, table = 0, 0
    for block in text.blocks():
        end = line + len(block)
        while table < len(tables):
            first, last = tables[table]
            here = block[max(first - line, 0) : max(last - line, 0)]
            if here:
                yield max(line, first), here, table
            if last > end:
                break
            table += 1
        line = end


def _frame(source: Source, lines: list[str], before: int, width: int, dialect: Dialect) -> pd.DataFrame:
    """Some rows; ``before`` of the lines of the file stand above them."""
    import pandas as pd

    try:
        return pd.read_csv(
            io.StringIO("\n".join(lines)),
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
            f"{source.name}: line {int(found[1]) + before} has {found[2]} cells, the rows before it {width}: "
            f"delete the surplus cells; {REMEDY_COMMA}"
        ) from error


def _column(column: pd.Series, dialect: Dialect) -> np.ndarray:
    """One column; texts among the numbers leave these as they were written, with a point as decimal sign."""
    values = np.asarray(column)
    if values.dtype.kind in "iuf":
        return values
    texts = values.astype(object)
    if dialect.decimal == ".":
        return texts
    return np.array([v.replace(",", ".") if isinstance(v, str) else v for v in texts], dtype=object)
