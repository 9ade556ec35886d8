"""Several recordings one after another in one file."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from phnn.errors import InputRefused
from phnn.recordings import checks
from phnn.recordings.channels import Channel
from phnn.recordings.manifest import Entry
from phnn.recordings.table import Table, Where
from phnn.results import printable

# A step of time longer than this many usual ones begins a new recording.
_JUMP = 1.5


def segmented(entry: Entry, channels: Mapping[str, Channel], table: Table) -> list[Entry]:
    """An entry for every recording in its file, each with its slice and, where there are several, a number.

    The slice of an array with axes is taken of every realisation.

    Raises:
        InputRefused: a slice that leaves the file, samples that do not make whole segments, or no time to tell them by.
    """
    size, where = next(iter(channels.values())).values.size, table.where
    one = size // table.shape[0] if table.shape else size
    first, last = entry.slice or (0, one)
    checks.slice_inside((first, last), one, where)
    pieces = [(i + first, i + last) for i in range(0, max(size, 1), max(one, 1))]
    if entry.segments is not False and not table.shape:
        edges = [first, *(first + e for e in _edges(entry, channels, last - first, first, where)), last]
        pieces = list(itertools.pairwise(edges))
    elif table.segments:
        pieces = list(itertools.pairwise([first, *(row for row in table.segments if first < row < last), last]))
        if len(pieces) == 1:
            return [replace(entry, slice=pieces[0])]
    elif len(pieces) == 1:
        return [replace(entry, slice=pieces[0])]
    stem, digits = entry.name or printable(Path(entry.file).stem), len(str(len(pieces)))
    return [replace(entry, slice=piece, name=f"{stem}_{i:0{digits}d}") for i, piece in enumerate(pieces, start=1)]


def _edges(entry: Entry, channels: Mapping[str, Channel], size: int, first: int, where: Where) -> list[int]:
    """Where the second segment and every further one begins, counted from the first."""
    if entry.segments is not True:
        count = int(entry.segments)
        if size % count:
            raise InputRefused(
                f"{where}: {size} samples are no whole number of segments of {count}: correct `segments` in "
                f"recordings.yaml, or cut the rest off with `slice`"
            )
        return list(range(count, size, count))
    if "time" not in channels:
        raise InputRefused(
            f"{where}: no time column to tell segments by: write the number of samples of each, segments: 8192"
        )
    steps = np.diff(channels["time"].values[first : first + size])
    usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    return [int(i) + 1 for i in np.flatnonzero((steps < 0.0) | (steps > _JUMP * usual))]
