"""Labels that people chose, as names of files."""

from __future__ import annotations

import hashlib
import re
import unicodedata
from collections.abc import Iterable

# Bytes of a name; file systems take 255 for the whole, temporary names add some.
_LONGEST = 180
_DIGEST = 8
# Letters, digits and marks of any script stay; separators, controls, quotes and wildcards do not.
_UNSAFE = re.compile(r"[^\w.+=@,()\[\] -]")
# Windows takes these for devices, whatever ending follows.
_DEVICES = re.compile(r"(?i)(con|prn|aux|nul|com\d|lpt\d)(\..*)?")


def file_name(label: str, ending: str = "") -> str:
    """The label as the name of a file: one component, printable, at most 180 bytes, never empty, ``.`` or hidden.

    Args:
        ending: follows the label whatever that is, such as ``.csv``.

    Labels that need no change stay as they are; where something had to be replaced or cut off, two different labels
    may give the same name, see `unique_names`.
    """
    # Surrogates are what Python makes of bytes that are no UTF-8.
    text = unicodedata.normalize("NFC", label.encode("utf-8", "replace").decode("utf-8"))
    text = _UNSAFE.sub("_", text).strip(" .")
    if _DEVICES.fullmatch(text) or not text:
        text = f"_{text}"
    if len(f"{text}{ending}".encode()) > _LONGEST:
        mark = hashlib.sha256(label.encode("utf-8", "surrogatepass")).hexdigest()[:_DIGEST]
        kept = text.encode()[: _LONGEST - _DIGEST - 1 - len(ending.encode())].decode("utf-8", "ignore")
        text = f"{kept}_{mark}"
    return text + ending


def unique_names(labels: Iterable[str], ending: str = "") -> dict[str, str]:
    """File names of different labels that differ from one another even where letters' case does not count.

    Returns:
        The name of each label, in their order.
    """
    found: dict[str, str] = {}
    taken: set[str] = set()
    for label in labels:
        name, number = file_name(label, ending), 2
        while name.casefold() in taken:
            name, number = file_name(label, f"_{number}{ending}"), number + 1
        taken.add(name.casefold())
        found[label] = name
    return found
