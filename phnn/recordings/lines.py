"""A text as lines, without a copy of each in memory."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from phnn.errors import InputRefused
from phnn.intake.files import Source
from phnn.intake.limits import LIMITS

# A text takes at most about so many times its size while it is read: twice while it is decoded; then itself and its
# numbers, four times as large where every cell is a digit.
_TIMES = 6
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f]")
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
# What `str.splitlines` takes for the end of a line; characters that are split into lines at once.
_END = re.compile("\r\n|[\n\r\x0b\x0c\x85\u2028\u2029]")
_BLOCK = 2**20


@dataclass(frozen=True, eq=False)
class Lines:
    """Attributes:
    content: the whole text; size: characters of it without white space at its end.
    """

    content: str
    size: int

    def blocks(self) -> Iterator[list[str]]:
        """All lines, some thousands at a time."""
        begin = 0
        while begin < self.size:
            end = _END.search(self.content, min(begin + _BLOCK, self.size), self.size)
            stop = end.end() if end else self.size
            yield self.content[begin:stop].splitlines()
            begin = stop

    def __iter__(self) -> Iterator[str]:
        for block in self.blocks():
            yield from block

    @cached_property
    def count(self) -> int:
        """How many lines there are."""
        return sum(len(block) for block in self.blocks())

    @property
    def ended(self) -> bool:
        """Whether the last line ends as the others do."""
        return self.content.endswith(("\n", "\r"))


def read_content(source: Source, most: int, what: str) -> str:
    """The text of a file in any of the usual encodings.

    Args:
        most: bytes; what: of a kind of file, for the message.

    Raises:
        InputRefused: it is empty, no text, or too large.
    """
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
        raise InputRefused(
            f"{source.name}: not a text file (byte 0x{ord(control[0]):02x} at position {control.start()}): "
            f"export it again as plain text, or remove it from the folder"
        )
    return content


def read_lines(source: Source) -> Lines:
    """The lines of a file.

    Raises:
        InputRefused: as `read_content`, or it has a line that no table has.
    """
    source.check_memory(_TIMES * source.size)
    content = read_content(source, LIMITS.text_bytes, "a text file")
    size = len(content)
    while content[size - 1].isspace():
        size -= 1
    lines = Lines(content, size)
    before = 0
    for block in lines.blocks():
        if max(map(len, block)) > LIMITS.line_characters:
            i = next(i for i, line in enumerate(block) if len(line) > LIMITS.line_characters)
            raise InputRefused(
                f"{source.name}: line {before + i + 1} has {len(block[i])} characters: write one row per sample"
            )
        before += len(block)
    return lines
