"""Names from files, folders and commands, made fit for terminals, reports and json."""

from __future__ import annotations

import re

from phnn.intake.limits import LIMITS

# Control characters (C0 without the line feed, DEL, C1), marks that reverse the direction of writing, line and
# paragraph separators, and lone surrogates, which stand for bytes of a name that is no UTF-8.
_UNPRINTABLE = re.compile(
    "[\x00-\x09\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff]"
)
# Python's stand-ins for the bytes 0x80 to 0xff.
_FIRST_BYTE, _LAST_BYTE, _STAND_IN = 0xDC80, 0xDCFF, 0xDC00


def printable(text: str, lines: bool = False) -> str:
    """A text in which every character that a terminal or a file would not take as written is spelled out.

    Escape codes lose their effect, bytes that are no UTF-8 become ``\\xff``, other characters ``\\u202e``.

    Args:
        lines: keep line feeds, for a text of several lines; a name has one line.
    """
    shown = _UNPRINTABLE.sub(_spelled, text)
    return shown if lines else shown.replace("\n", "\\x0a")


def message(text: str) -> str:
    """A message of one printable line; of a long one the beginning and the end."""
    line, most = printable(text), LIMITS.message_characters
    return line if len(line) <= most else f"{line[: most // 2]} … {line[-most // 2 :]}"


def _spelled(found: re.Match[str]) -> str:
    code = ord(found[0])
    if _FIRST_BYTE <= code <= _LAST_BYTE:
        code -= _STAND_IN
    return f"\\x{code:02x}" if code <= 0xFF else f"\\u{code:04x}"
