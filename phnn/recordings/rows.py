"""Rows of cells as columns of numbers."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from phnn.errors import InputRefused
from phnn.intake.files import Source
from phnn.recordings.lines import Lines
from phnn.recordings.table import REMEDY_COMMA, Table, Where
from phnn.results import printable

if TYPE_CHECKING:
    import pandas as pd

NUMBER = {
    sign: re.compile(rf"[-+]?(\d+{re.escape(sign)}?\d*|{re.escape(sign)}\d+)([eE][-+]?\d+)?|[-+]?(nan|inf)", re.I)
    for sign in ".,"
}


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
