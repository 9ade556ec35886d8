"""A run on disk: its state, whole or not at all, so that it goes on as if it had never been stopped; and its log.

The log has one row an epoch, as csv and for TensorBoard.
"""

from __future__ import annotations

import csv
import io
import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from phnn.errors import InputRefused
from phnn.intake.files import named_file
from phnn.intake.limits import LIMITS
from phnn.results import Place

FILE = "checkpoint.pt"
_SCHEMA = "phnn.checkpoint/1"


def save(place: Place, state: Mapping[str, Any]) -> None:
    """Write a state of tensors, numbers, texts, lists and dictionaries, and that of torch's random generator."""
    place.write(as_bytes({"schema": _SCHEMA, "random": torch.get_rng_state(), **state}))


def as_bytes(content: Mapping[str, Any]) -> bytes:
    """What ``torch.load(..., weights_only=True)`` reads back."""
    buffer = io.BytesIO()
    torch.save(content, buffer)
    return buffer.getvalue()


def load(path: Path, keys: Sequence[str] = ()) -> dict[str, Any] | None:
    """The state that `save` wrote, with torch's random generator set back to it; None where there is none.

    Args:
        keys: what the state must hold.

    Raises:
        InputRefused: the file is damaged, too large or no checkpoint.
    """
    if not os.path.lexists(path):
        return None
    source = named_file(path, (path.parent,))
    source.check_size(LIMITS.checkpoint_bytes, "a checkpoint")
    source.check_memory(source.size)
    try:
        with source.open() as file, warnings.catch_warnings():
            # What torch finds odd in a file is refused below.
            warnings.simplefilter("ignore", UserWarning)
            state = torch.load(file, weights_only=True, map_location="cpu")
    except InputRefused:
        raise
    except Exception as error:
        raise InputRefused(f"{path}: cannot be read ({type(error).__name__}): delete it to begin anew") from error
    if not isinstance(state, dict) or state.get("schema") != _SCHEMA:
        raise InputRefused(f"{path}: is no {_SCHEMA} file: delete it to begin anew")
    missing = [key for key in ("random", *keys) if key not in state]
    if missing:
        raise InputRefused(f"{path}: holds no {missing[0]!r}: delete it to begin anew")
    try:
        torch.set_rng_state(state["random"])
    except (TypeError, RuntimeError) as error:
        raise InputRefused(f"{path}: its state of the random generator is none: delete it to begin anew") from error
    return state


LOG = "log.csv"
COLUMNS = ("epoch", "method", "loss", "validation", "rate", "seconds")
Row = dict[str, Any]


class Log:
    """Rows are written as they come; a resumed run first writes again what its checkpoint knows.

    Args:
        place: gets ``log.csv`` and, if wanted and installed, ``tensorboard/``.
        rows: of the epochs before.
        tensorboard: write for it as well.
    """

    def __init__(self, place: Place, rows: Sequence[Row] = (), tensorboard: bool = True) -> None:
        self.place, self.text = place / LOG, io.StringIO(newline="")
        self.writer = csv.DictWriter(self.text, COLUMNS)
        self.writer.writeheader()
        self._write(rows)
        self.board = _board((place / "tensorboard").own_folder(), len(rows)) if tensorboard else None

    def _write(self, rows: Sequence[Row]) -> None:
        self.writer.writerows(rows)
        self.place.write(self.text.getvalue().encode())

    def add(self, row: Row) -> None:
        """One epoch."""
        self._write([row])
        if self.board is not None:
            for name in ("loss", "validation", "rate"):
                if row[name] is not None:
                    self.board.add_scalar(name, row[name], row["epoch"])

    def close(self) -> None:
        """Write what TensorBoard has not yet."""
        if self.board is not None:
            self.board.close()


def _board(folder: Path, first: int) -> Any:
    """A writer whose earlier points from ``first`` on are void; None where TensorBoard is not installed."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return None
    return SummaryWriter(str(folder), purge_step=first)
