"""Tables that stand one below the other in a text, each below a header of its own.

An instrument that writes a segment at a time repeats its header: lines of ``name: value``, the names of the columns, a
line of units. The line of names tells such a header: it is the same in all. Each table is a segment, a recording.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from phnn.errors import InputRefused
from phnn.intake.limits import LIMITS
from phnn.recordings.lines import Lines

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
