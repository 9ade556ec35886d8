"""A text as lines, without a copy of each in memory."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator

import numpy as np

from phnn.errors import InputRefused
from phnn.intake.files import Source
from phnn.intake.limits import LIMITS

# A text takes at most about so many times its size while it is read: twice while it is decoded; then itself and its
# numbers, four times as large where every cell is a digit.
_TIMES = 6
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f]")
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
# What `str.splitlines` takes for the end of a line.
_END = re.compile("\r\n|[\r\x0b\x0c\x85\u2028\u2029]")


class Lines:
    """The lines of a text.

    Attributes:
        raw: the text in UTF-8, without white space at its end; starts: (n+1,) where its lines begin.
        ended: whether the last line ends as the others do.
    """

    def __init__(self, content: str) -> None:
        content = _END.sub("\n", content) if _END.search(content) else content
        self.ended = content.endswith("\n")
        self.raw = content.rstrip().encode("utf-8", "surrogatepass") + b"\n"
        ends = np.flatnonzero(np.frombuffer(self.raw, dtype=np.uint8) == ord("\n")) + 1
        self.starts = np.concatenate([[0], ends])

    def __len__(self) -> int:
        return self.starts.size - 1

    def __getitem__(self, i: int) -> str:
        """Return the i-th line, without its end."""
        return self.raw[self.starts[i] : self.starts[i + 1] - 1].decode("utf-8", "surrogatepass")

    def of(self, first: int, last: int) -> Iterator[str]:
        """Yield some lines."""
        return (self[i] for i in range(first, min(last, len(self))))


def read_content(source: Source, most: int, what: str) -> str:
    """Return the text of a file in any of the usual encodings.

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
    """Return the lines of a file.

    Raises:
        InputRefused: as `read_content`, or it has a line that no table has.
    """
    source.check_memory(_TIMES * source.size)
    lines = Lines(read_content(source, LIMITS.text_bytes, "a text file"))
    sizes = np.diff(lines.starts) - 1
    if sizes.max() > LIMITS.line_characters:
        i = int(np.argmax(sizes > LIMITS.line_characters))
        raise InputRefused(f"{source.name}: line {i + 1} has {sizes[i]} characters: write one row per sample")
    return lines
