"""The test whether the output of an earlier run came from the same recordings and settings."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from phnn.errors import OutputRefused

# What keys stand for whose values are hashes, in words; the values themselves say nothing to people.
_HASHES = {
    "recordings": "other recordings",
    "base": "another model to start from",
    "schema": "another version of phnn",
}


def same(
    where: Path, before: Mapping[str, Any], now: Mapping[str, Any], remedy: str, free: Collection[str] = ()
) -> None:
    """Refuse to go on with, or to use, what was made of something else.

    Args:
        where: the folder or file that was made.
        before, now: what it was made of, and what it would be made of.
        remedy: what the user can do.
        free: keys that make no other result.

    Raises:
        OutputRefused: a value differs; the message names it.
    """
    for key in sorted((set(before) | set(now)) - set(free)):
        old, new = before.get(key), now.get(key)
        if old != new:
            shown = "" if key in _HASHES else f" ({key}: {old} before, {new} now)"
            raise OutputRefused(f"{where}: was made with {_HASHES.get(key, 'other settings')}{shown}: {remedy}")
