"""Recordings that are objects in memory: one adapter for each library, and tables of columns as a file would give.

No library is loaded: an object can only be given where its library is loaded already.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from phnn.errors import InputRefused
from phnn.recordings.adapters.collected import given
from phnn.recordings.adapters.given import Given
from phnn.recordings.manifest import Entry, Manifest
from phnn.recordings.table import Table, beside
from phnn.recordings.values import shown


def described(found: Sequence[Given], said: Manifest) -> tuple[list[tuple[Entry, Table]], list[str]]:
    """Every recording that the manifest asks for, and the names of the others; all where it lists none.

    ``file`` in the manifest is the name of a recording. What the manifest says wins over what an object says.

    Raises:
        InputRefused: the manifest names a recording that was not given, or two have one name.
    """
    by_name: dict[str, Given] = {}
    for one in found:
        if one.name in by_name:
            raise InputRefused(f"two recordings are called {one.name!r}: give a mapping from names to recordings")
        by_name[one.name] = one
    if said.entries is None:
        return [_described(replace(said.common, file=one.name), by_name) for one in found], []
    for i, entry in enumerate(said.entries):
        if unknown := [file for file in entry.files if file not in by_name]:
            cause = f"no recording is called {shown(unknown[0])}, there are {', '.join(by_name)}"
            raise InputRefused(f"recordings[{i}]: {cause}: correct `file`")
    asked = {file for entry in said.entries for file in entry.files}
    return [_described(e, by_name) for e in said.entries], [name for name in by_name if name not in asked]


def _described(entry: Entry, by_name: Mapping[str, Given]) -> tuple[Entry, Table]:
    several = [by_name[file] for file in entry.files]
    table = beside([one.table for one in several])
    if entry.axes:
        raise InputRefused(f"{table.where}: `axes` describe a .npy array: leave them out, and give columns")
    first = several[0]
    return replace(
        entry,
        name=entry.name or first.name,
        use=entry.use or first.use,
        sample_rate_hz=entry.sample_rate_hz or first.sample_rate_hz,
    ), table


__all__ = ["Given", "described", "given"]
