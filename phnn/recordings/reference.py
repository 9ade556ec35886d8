"""A file with a reference: what an output is to follow, over time."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from phnn.errors import InputRefused
from phnn.intake.files import named_file
from phnn.recordings import checks
from phnn.recordings.channels import select
from phnn.recordings.folder import reader_of
from phnn.recordings.sampling import on_grid
from phnn.recordings.units import known_unit

# Columns that may hold a reference, the first that is there counts.
_QUANTITIES = ("displacement", "output")


class Reference(NamedTuple):
    """Attributes:
    t: (N,) time, equally spaced, s.
    y: (N,) what is to be followed, SI.
    unit: SI unit of ``y``.
    notes: what was done to the samples, in sentences.
    """

    t: np.ndarray
    y: np.ndarray
    unit: str
    notes: tuple[str, ...]


def read_reference(path: Path, allow_outside: bool = False) -> Reference:
    """Read a table with a time and a displacement, of any format that recordings may have.

    Args:
        path: of the file; allow_outside: it may be a link, or refer to other files.

    Raises:
        InputRefused: with one message naming file, column, row, cause and remedy.
    """
    reader = reader_of(path)
    table = reader(named_file(path, (path.parent,), outside=allow_outside))
    channels = select(table, {}, {})
    quantity = next((q for q in _QUANTITIES if q in channels), None)
    columns = ", ".join(n for n in table.names if n) or "none with a name"
    for name, found, example in (("time", "time" in channels, "s"), ("displacement", quantity is not None, "um")):
        if not found:
            raise InputRefused(
                f"{table.where}: no {name} column among its columns ({columns}): name one {name}_{example}"
            )
    assert quantity is not None
    channel, time = channels[quantity], channels["time"]
    checks.enough_samples(channel.values.size, table.where)
    checks.output_moves(channel.values, f"{quantity} ({channel.label})", table.where)
    factor = known_unit(time.unit).factor
    dt, values, note = on_grid(time.values, factor, {quantity: channel.values}, table.where)
    y = values[quantity]
    notes = (f"The reference: {note}.",) if note else ()
    return Reference(time.values[0] + dt * np.arange(y.size), y, known_unit(channel.unit).si, notes)
