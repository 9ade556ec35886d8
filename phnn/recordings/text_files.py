"""Reading text: columns of numbers, below whatever an instrument writes above them.

Separator and decimal sign are those under which most lines are rows: lines of one width whose columns of numbers hold
nothing else. Other columns hold dates or words. The names stand right above the first row, with a row of units between
them or none; what stands higher is left alone, and so is a footer.
"""

from __future__ import annotations

import codecs
import csv
import io
import itertools
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from phnn.errors import InputRefused
from phnn.intake import LIMITS, Source
from phnn.recordings.table import DATE, OF_DAY, REMEDY_COMMA, Table, Where, with_stamps
from phnn.recordings.units import find_unit, parse_name, same_kind, split_unit
from phnn.results import printable

if TYPE_CHECKING:
    import pandas as pd

# A text takes at most about so many times its size while it is read: twice while it is decoded; then itself and its
# numbers, four times as large where every cell is a digit.
_TIMES = 6
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f]")
_HEAD, _UTF16 = 4096, (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
# What `str.splitlines` takes for the end of a line.
_END = re.compile("\r\n|[\r\x0b\x0c\x85\u2028\u2029]")


class Lines:
    """The lines of a text; those of a file of this name are refused where one is longer than that of any table.

    Attributes:
        raw: the text in UTF-8, without white space at its end; starts: (n+1,) where its lines begin.
        ended: whether the last line ends as the others do.
    """

    def __init__(self, content: str, name: str) -> None:
        content = _END.sub("\n", content) if _END.search(content) else content
        self.ended = content.endswith("\n")
        self.raw = content.rstrip().encode("utf-8", "surrogatepass") + b"\n"
        ends = np.flatnonzero(np.frombuffer(self.raw, dtype=np.uint8) == ord("\n")) + 1
        self.starts = np.concatenate([[0], ends])
        sizes = np.diff(self.starts) - 1
        if sizes.max() > LIMITS.line_characters:
            i = int(np.argmax(sizes > LIMITS.line_characters))
            raise InputRefused(f"{name}: line {i + 1} has {sizes[i]} characters: write one row per sample")

    def __len__(self) -> int:
        return self.starts.size - 1

    def __getitem__(self, i: int) -> str:
        """Return the i-th line, without its end."""
        return self.raw[self.starts[i] : self.starts[i + 1] - 1].decode("utf-8", "surrogatepass")


def read_content(source: Source, most: int, what: str) -> str:
    """Return the text of a file of at most so many bytes in any usual encoding; messages say ``what`` it is."""
    raw = source.read(most, what)
    try:
        content = raw.decode("utf-16" if raw.startswith(_UTF16) else "utf-8-sig")
    except UnicodeDecodeError:
        content = raw.decode("latin-1")  # a micro sign written by older laboratory software
    del raw
    if not content or content.isspace():
        raise InputRefused(f"{source.name}: the file is empty: record it again or remove it")
    control = _CONTROL.search(content)
    if control is not None:
        cause = f"not a text file (byte 0x{ord(control[0]):02x} at position {control.start()})"
        raise InputRefused(f"{source.name}: {cause}: export it again as plain text, or remove it from the folder")
    return content


def read_lines(source: Source) -> Lines:
    """Return the lines of a file."""
    source.check_memory(_TIMES * source.size)
    return Lines(read_content(source, LIMITS.text_bytes, "a text file"), source.name)


NUMBER = {
    sign: re.compile(rf"[-+]?(\d+{re.escape(sign)}?\d*|{re.escape(sign)}\d+)(e[-+]?\d+|d[-+]\d+)?|[-+]?(nan|inf)", re.I)
    for sign in ".,"
}
# By the decimal sign, a number with the other sign between thousands; one that may be that, or have a decimal point.
_THOUSANDS = {
    sign: re.compile(rf"[-+]?\d{{1,3}}((\{other}\d{{3}})+\{sign}\d*|(\{other}\d{{3}}){{2,}})")
    for sign, other in (",.", ".,")
}
_DOUBTFUL = re.compile(r"[-+]?\d*\.\d+")
_MARKS = "#%"
_SHOWN = 40
# Lines that are looked at to recognise the columns; the share of them in which a column of numbers holds numbers.
_LOOKED_AT, _MOSTLY = 60, 0.8
# Share of its numbers that the first row has: what stands above may hold some too.
_FILLED = 0.5
# Lines below the last row that may be a footer.
_FOOTER = 20
_WHOLE = re.compile(r"\s*[-+]?\d+([eE][-+]?\d+)?\s*")
# A number whose comma stands not between thousands.
_CERTAIN = re.compile(r"[-+]?(0,\d+|\d+,(\d\d?|\d{4,}))([eE][-+]?\d+)?")
# The letter before an exponent of Fortran.
_FORTRAN = re.compile(r"(?<=[\d.,])[dD](?=[-+]\d+$)")
# The mark of a comment before a word; in a row of units, % may be one.
_COMMENT = re.compile(r"^ *[#%]+ *(?=[\w\"(\[])")
# Cells of a row of units where a column has none; of any row where a value is missing, as pandas reads them; of a row
# below the units that says how values were taken; the name of a last column without cells.
_NO_UNIT = ("", "-", "--")
_MISSING = ("", "null", "NULL", "NA", "N/A", "n/a", "#N/A", "None")
_TAKEN = frozenset({"", "smp", "avg", "min", "max", "tot", "std", "med"})
_COMMENTS = ("comment", "comments")
# A word, with a unit in brackets behind it.
_WORD = re.compile(r"\S+(?:\s*[\[(][^\])]*[\])])?")


@dataclass(frozen=True)
class Dialect:
    """How a text has its rows."""

    separator: str  # of columns; a blank stands for any white space
    decimal: str  # sign
    width: int = 0  # columns of a row; 0 where no line is one
    numeric: tuple[int, ...] = ()  # columns that hold numbers
    empty: tuple[int, ...] = ()  # columns that hold nothing
    dates: tuple[int, ...] = ()

    def cells(self, line: str) -> list[str]:
        """Return the cells of a line, quotes removed."""
        if self.separator == " ":
            return line.split()
        row = next(csv.reader([line], delimiter=self.separator, skipinitialspace=True), [])
        return [cell.strip() for cell in row]

    def is_number(self, cell: str) -> bool:
        """Return whether a cell is a number."""
        return bool(NUMBER[self.decimal].fullmatch(cell) or _THOUSANDS[self.decimal].fullmatch(cell))

    def is_row(self, line: str, share: float = 0.0) -> bool:
        """Return whether a line is a row: more than a share of its numbers, and with any share all dates, are there."""
        cells = self.cells(line)
        filled = [cells[i] for i in self.numeric if cells[i]] if len(cells) == self.width else []
        dated = not share or all(cells[i] for i in self.dates if filled)
        known = all(cell in _MISSING or self.is_number(cell) for cell in filled)
        return len(filled) > share * len(self.numeric) and dated and known

    def fitted(self, lines: Sequence[Sequence[str]]) -> Dialect:
        """Return the dialect with the columns that most of some lines, given as cells, have."""
        rows = [cells for cells in lines if any(map(self.is_number, cells))]
        widths = Counter(map(len, rows))
        width = max(widths, key=lambda count: widths[count], default=0)
        columns = list(zip(*(cells for cells in rows if len(cells) == width), strict=True))
        filled = [[cell for cell in column if cell not in _MISSING] for column in columns]
        numeric, dates = (
            tuple(i for i, cells in enumerate(filled) if cells and sum(map(test, cells)) >= _MOSTLY * len(cells))
            for test in (self.is_number, _is_date)
        )
        empty = tuple(i for i, cells in enumerate(filled) if not cells)
        return replace(self, width=width, numeric=numeric, empty=empty, dates=dates)


def _is_date(cell: str) -> bool:
    return bool(DATE.fullmatch(cell) or OF_DAY.fullmatch(cell))


# Of several that fit as well, the first is meant. Commas may be both where the cells are quoted.
_DIALECTS = tuple(Dialect(pair[0], pair[1]) for pair in (",.", ";.", ";,", "\t.", "\t,", ",,", " .", " ,"))


def read_text(source: Source) -> Table:
    """Return columns separated by commas, semicolons, tabulators or blanks, with a point or a comma as decimal sign."""
    return table_of_lines(source.name, read_lines(source))


def table_of_lines(name: str, text: Lines) -> Table:
    """Return the columns of a text; ``name`` is that of its file. Raises InputRefused as `read_text`."""
    dialect = _recognised(text)
    if not dialect.numeric:
        head = next(filter(None, (text[i].strip() for i in range(len(text)))))
        cause = f"no rows of numbers in it, it begins with {head[:60]!r}: the recording is empty or no table"
        raise InputRefused(f"{name}: {cause}: record it again or remove it")
    if dialect.width > LIMITS.text_columns:
        cause = f"{dialect.width} columns, at most {LIMITS.text_columns} are accepted"
        raise InputRefused(f"{name}: {cause}: write one row per sample")
    rows = (next((i for i in range(len(text)) if dialect.is_row(text[i], share)), None) for share in (_FILLED, 0.0))
    first = next(i for i in rows if i is not None)
    names, header, clock = _names(name, [text[i] for i in range(first + 1)], dialect)
    blocks = _blocks(name, text, first, header if any(names) else [], dialect)
    tables = [_rows(text, block, dialect) for block in blocks]
    notes: list[str] = []
    if len(tables) > 1:
        notes.append(f"{len(tables)} tables stand in the file, each below a header: each is a recording of its own")
    begin, end = blocks[-1].start, blocks[-1].stop
    if end == len(text):
        footer = _footer([text[i] for i in range(max(begin + 1, end - _FOOTER), end)], dialect)
        if footer:
            notes.append(f"below the last row stands {footer[0].strip()[:_SHOWN]!r}, which was left alone")
            end -= len(footer)
        elif not text.ended and end > begin + 1:
            last = text[end - 1]
            others = (text[i] for rows in [*tables[:-1], tables[-1][:-1]] for i in rows)
            ending = "has no end: if the file was cut there, its last number is wrong"
            if _breaks_off(others, last, dialect):
                ending, end = "was left out: the file ends within it", end - 1
            notes.append(f"its last line, {last.strip()[:_SHOWN]!r}, {ending}")
    tables[-1] = tables[-1][tables[-1] < end]
    if skipped := sum(int(rows[-1]) + 1 - int(rows[0]) - rows.size for rows in tables):
        notes.append(f"{skipped} lines between the rows, blank or behind the mark of a comment, were skipped")
    table = replace(_parsed(name, text, tables, names, dialect), notes=tuple(notes))
    if clock:
        times = clock[0] + clock[1] * np.arange(sum(map(len, tables)))
        table = replace(table, names=(*table.names, "time_s"), columns=(*table.columns, times))
    return with_stamps(table)


def looks_like_numbers(source: Source) -> bool:
    """Return whether a file is a text that holds columns of numbers rather than prose."""
    try:
        with source.open() as file:
            head = file.read(_HEAD)
        if b"\0" in head and not head.startswith(_UTF16):
            return False
        dialect = _recognised(read_lines(source))
        return dialect.width - len(dialect.empty) >= 2 and len(dialect.numeric) > 0.5 * dialect.width
    except InputRefused:
        return False


def _recognised(text: Lines) -> Dialect:
    """Return the dialect under which most cells of the lines are numbers in rows."""
    filled = np.flatnonzero(np.diff(text.starts) > 1)
    marked = np.isin(np.frombuffer(text.raw, dtype=np.uint8)[text.starts[filled]], [ord(c) for c in _MARKS])
    filled = filled[~marked]
    chosen = np.unique(np.linspace(0, max(filled.size - 1, 0), _LOOKED_AT).astype(int))[: filled.size]
    lines = [text[int(i)] for i in filled[chosen]]
    shown = [line for line in lines if line.strip() and line.strip()[0] not in _MARKS]
    best, most = _DIALECTS[0], (0, 0)
    tabs = 2 * sum("\t" in line for line in shown) > len(shown)
    for plain in _DIALECTS:
        # Where tabulators separate columns of numbers, blanks do not.
        if plain.separator == " " and tabs and len(best.numeric) > 1:
            continue
        dialect = plain.fitted([plain.cells(line) for line in shown])
        rows = sum(map(dialect.is_row, shown)) if dialect.numeric else 0
        # Lines of numbers alone speak for a dialect before those that hold words too.
        whole = len(dialect.numeric) + len(dialect.empty) == dialect.width
        score = (rows, 0) if whole else (0, rows * len(dialect.numeric))
        # Of as many, a comma that is the decimal sign counts before points, which may stand between thousands.
        tie = score == most and best.separator == plain.separator != ","
        if score > most or (tie and any(_CERTAIN.fullmatch(cell) for line in shown for cell in plain.cells(line))):
            best, most = dialect, score
    return best


def _footer(last: Sequence[str], dialect: Dialect) -> list[str]:
    """Return the lines below the last row that begin with words where numbers belong."""

    def is_footer(line: str) -> bool:
        cells = dialect.cells(line)
        head = next((cells[i] for i in dialect.numeric if i < len(cells) and cells[i]), cells[0] if cells else "")
        if not line.strip() or line.strip()[0] in _MARKS:
            return True
        few = sum(map(dialect.is_number, cells)) < max(len(dialect.numeric), 2)
        return few and any(c.isalpha() for c in head) and not dialect.is_row(line)

    count = len(list(itertools.takewhile(is_footer, reversed(last))))
    return list(last[len(last) - count :])


def _breaks_off(others: Iterable[str], row: str, dialect: Dialect) -> bool:
    """Return whether the last row lacks cells, or its last number digits that all other rows have in one number.

    What an instrument writes with a fixed number of digits shows it; of others nothing can be said.
    """
    last = dialect.cells(row) or [""]
    fewest, formats, words = LIMITS.text_columns + 1, set(), dialect.width - 1 not in dialect.numeric
    for other in others:
        cells = dialect.cells(other) or [""]
        fewest = min(fewest, len(cells))
        formats.add(_format(cells[-1], dialect.decimal))
    if len(last) < fewest or not (words or dialect.is_number(last[-1])):
        return True
    return not words and len(formats) == 1 and formats != {_format(last[-1], dialect.decimal)}


def _format(number: str, decimal: str) -> tuple[int, int]:
    """Return the digits behind the decimal sign and in the exponent."""
    mantissa, _, exponent = number.lower().partition("e")
    return len(mantissa.partition(decimal)[2]), len(exponent.lstrip("+-"))


def _names(name: str, lines: list[str], dialect: Dialect) -> tuple[tuple[str, ...], list[str], tuple[float, ...]]:
    """Return the names of the columns from the lines above the last one, the first row, and the lines of the names.

    Behind them stand start and interval [s] of the samples, where an oscilloscope states them with the names.
    """
    width, first = dialect.width, len(lines) - 1
    words = [{c.lower() for c in dialect.cells(line.strip(_MARKS))} for line in lines[:-1]]
    filled = [i for i in range(first) if words[i] and ("" not in words[i] or not words[i] <= _TAKEN)]
    rows = [_words(lines[i], dialect) for i in filled[-2:]]
    clock: tuple[float, ...] = ()
    stated = len(rows) == 2 and [c.lower() for c in rows[0][-2:]] == ["start", "increment"]
    if stated and len(rows[0]) == len(rows[1]) and all(map(dialect.is_number, rows[1][-2:])):
        clock = float(rows[1][-2]), float(rows[1][-1])
        # The first column may count the samples.
        rows = [[*("" if c == "Sequence" else c for c in row[:-2]), *[""] * width][:width] for row in rows]
    if not rows:
        return ("",) * width, [], ()
    nearest = rows[-1]
    header = lines[filled[-1] : first]
    place, cells = f"{name}: line {filled[-1] + 1}", dialect.cells(lines[filled[-1]])
    if len(nearest) != width:
        if not any(parse_name(word)[0] for word in nearest):
            return ("",) * width, header, ()
        row, cells = lines[first], dialect.cells(lines[first])
        if dialect.separator == "," and len(cells) > len(nearest) and all(_WHOLE.fullmatch(cell) for cell in cells):
            cause = f"line {first + 1}: {row[:60]!r} has a comma as decimal sign, which here also separates the columns"
            raise InputRefused(f"{name}: {cause}: separate them by semicolons, or {REMEDY_COMMA}")
        cause = f"line {first + 1} has {len(cells)} cells, the header {len(nearest)}"
        raise InputRefused(f"{name}: {cause}: give every row the header's columns")
    above = [nearest[i] for i in dialect.numeric]
    if any(map(dialect.is_number, above)):
        wrong = next((cell for cell in above if cell and not dialect.is_number(cell)), None)
        if wrong is None and len(cells) != width:
            raise InputRefused(f"{place} has {len(cells)} cells, the rows below it {width}: give every row as many")
        cause = f"{wrong[:40]!r} is not a number" if wrong else "a row of numbers that is unlike the rows below it"
        remedy = "correct or delete that row; if it is a header, give every column a name in words"
        raise InputRefused(f"{place}: {cause}: {remedy}")
    asked = [cell for i, cell in enumerate(nearest) if i not in dialect.empty and cell not in _NO_UNIT]
    # With or without brackets; where names stand above, most of them, for some may be unknown.
    units = [(c[0] in "([" and c[-1] in ")]") or find_unit(c) is not None for c in asked]
    titles = [w for i, w in enumerate(rows[0]) if i not in dialect.empty]
    if len(rows) == 2 and len(rows[0]) == width and (all(units) or (all(titles) and 2 * sum(units) > len(units))):
        units_below = ("" if i in dialect.empty else unit for i, unit in enumerate(nearest))
        nearest = [_with_unit(n, unit, place) for n, unit in zip(rows[0], units_below, strict=True)]
        header = lines[filled[-2] : first]
    return tuple(nearest), header, clock


def _words(line: str, dialect: Dialect) -> list[str]:
    """Return the cells of a header, without the mark of a comment before its first word: between blanks, units in
    brackets belong to the word before them; surplus separators at the end of header or rows stand for nothing."""
    line = _COMMENT.sub("", line)
    cells = dialect.cells(line)
    if len(cells) != dialect.width:
        cells = dialect.cells(line := line.lstrip(_MARKS + " \t"))
    if dialect.separator == " " and len(cells) != dialect.width:
        return _WORD.findall(line)
    while len(cells) > dialect.width and not cells[-1]:
        cells = cells[:-1]
    if len(cells) == dialect.width + 1 and cells[-1].lower() in _COMMENTS:
        cells = cells[:-1]
    while len(cells) < dialect.width and len(cells) in dialect.empty:
        cells = [*cells, ""]
    return cells


def _with_unit(name: str, unit: str, place: str) -> str:
    """Return a column's name with the unit from the row below it, unless it has one. Raises InputRefused for two."""
    bare, stated = unit.strip("()[] "), split_unit(name)[1] or parse_name(name)[1]
    known = find_unit(stated) if stated else None
    if not bare or bare in _NO_UNIT or (known is not None and known == find_unit(bare)):
        return name
    # A name such as flow_in ends with a word that is no unit of its own.
    if known is not None and stated and (name[-1] in ")]" or parse_name(name)[0] or same_kind(stated, bare)):
        cause = f"the row of units says {bare[:_SHOWN]} of {name[:_SHOWN]!r}"
        raise InputRefused(f"{place}: {cause}: correct the name or the unit, in the file")
    return f"{name} [{bare}]"


def _blocks(name: str, text: Lines, first: int, header: Sequence[str], dialect: Dialect) -> list[range]:
    """Return the lines of the tables of a text, the first of which begins at a line; one where no header is repeated.

    An instrument that writes a segment at a time repeats its header. The line of names tells such a header: it is the
    same in all. Each table is a segment, a recording. ``header`` is the line of names and what stands between it and
    the first row; empty where there are no names.
    """
    names = header[0].strip() if header else ""
    if not names or text.raw.count(names.encode("utf-8", "surrogatepass")) < 2:
        return [range(first, len(text))]
    blocks, begin = [], first
    wanted = [line.strip() for line in header[1:] if line.strip()]
    for is_row, run in itertools.groupby(range(first, len(text)), lambda i: dialect.is_row(text[i])):
        lines = {} if is_row else {i: text[i].strip() for i in run}
        at = next((i for i, line in lines.items() if line == names), None)
        if at is None:
            continue
        under = [line for i, line in lines.items() if line and i > at]
        if under != wanted:
            differs = next((line for line in under if line not in wanted), "nothing")
            first_has = f"{' '.join(wanted)[:_SHOWN]!r} under those of the first"
            cause = f"line {at + 2}: {differs[:_SHOWN]!r} stands under the names of this table, {first_has}"
            raise InputRefused(f"{name}: {cause}: give all tables of a file the same units, or split the file")
        blocks.append(range(begin, min(lines)))
        begin = max(lines) + 1
        if len(blocks) >= LIMITS.recordings:
            raise InputRefused(f"{name}: more than {LIMITS.recordings} tables in one file: divide them among files")
    # Nothing is measured under a header at the end.
    return [block for block in [*blocks, range(begin, len(text))] if block]


def _rows(text: Lines, block: range, dialect: Dialect) -> np.ndarray:
    """Return the lines of a table but blank ones and comments; in one column, a blank line is a missing value."""
    heads = np.frombuffer(text.raw, dtype=np.uint8)[text.starts[block.start : block.stop]]
    marks = _MARKS if dialect.width == 1 else _MARKS + "\n"
    doubtful = np.flatnonzero(np.isin(heads, [ord(c) for c in marks])) + block.start
    return np.setdiff1d(np.asarray(block), [i for i in doubtful.tolist() if not dialect.is_row(text[i])])


def _parsed(name: str, text: Lines, tables: Sequence[np.ndarray], names: tuple[str, ...], dialect: Dialect) -> Table:
    """Return the columns of some lines."""
    frames = [list(_frames(name, text, block, dialect)) for block in tables]
    rows = np.cumsum([0, *(sum(map(len, some)) for some in frames)]).tolist()
    every = [frame for some in frames for frame in some]
    shown = tuple(printable(n) for n in names)
    lines = np.concatenate(tables)
    before = lines - lines[0] - np.arange(lines.size)
    between = tuple((int(i), int(before[i])) for i in np.flatnonzero(np.diff(before, prepend=0)))
    columns = []
    for i in range(dialect.width):
        parts = [_column(frame[i], dialect) for frame in every]
        words = any(part.dtype.kind == "O" for part in parts)
        columns.append(np.concatenate([part.astype(object if words else float) for part in parts]))
    return Table(Where(name, int(lines[0]) + 1, between=between), shown, tuple(columns), segments=tuple(rows[1:-1]))


# Rows that are parsed at once: cells take many times the memory of their numbers.
_ROWS = 20_000


def _frames(name: str, text: Lines, lines: np.ndarray, dialect: Dialect) -> Iterator[pd.DataFrame]:
    """Yield the rows of a table."""
    import pandas as pd

    starts = text.starts[lines[0] : lines[-1] + 2]
    raw, inside = memoryview(text.raw)[starts[0] : starts[-1]], np.isin(np.arange(lines[0], lines[-1] + 1), lines)
    file = io.BytesIO(raw if inside.all() else np.frombuffer(raw, np.uint8)[np.repeat(inside, np.diff(starts))].data)
    try:
        yield from pd.read_csv(
            file, header=None, sep=r"\s+" if dialect.separator == " " else dialect.separator, decimal=dialect.decimal,
            skipinitialspace=True, skip_blank_lines=False, nrows=lines.size, chunksize=_ROWS, encoding_errors="replace",
        )  # fmt: skip
    except (pd.errors.ParserError, pd.errors.EmptyDataError, csv.Error) as error:
        counts = re.search(r"line (\d+), saw (\d+)", str(error))
        if counts is None:
            raise InputRefused(f"{name}: cannot be parsed ({error}): export it again") from error
        cause = f"line {int(lines[int(counts[1]) - 1]) + 1} has {counts[2]} cells, the rows before it {dialect.width}"
        raise InputRefused(f"{name}: {cause}: delete the surplus cells; {REMEDY_COMMA}") from error


def _column(column: pd.Series, dialect: Dialect) -> np.ndarray:
    """Return one column; texts among the numbers leave these as they were written, with a point as decimal sign."""
    values = np.asarray(column)
    if values.dtype.kind in "iuf":
        return values
    texts = (values.astype(str) if values.dtype.kind == "b" else values).astype(object)
    return np.array([_pointed(v, dialect.decimal) if isinstance(v, str) else v for v in texts], dtype=object)


def _pointed(cell: str, decimal: str) -> str:
    """Return a number with a decimal comma as one with a point; one with a point already is marked as no number."""
    cell = _FORTRAN.sub("e", cell.strip())
    if _THOUSANDS[decimal].fullmatch(cell):
        return cell.replace(",", "") if decimal == "." else cell.replace(".", "").replace(",", ".")
    if decimal == ".":
        return cell
    return f"{cell}?" if _DOUBTFUL.fullmatch(cell) else cell.replace(",", ".")
