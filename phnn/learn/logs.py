"""Logs of a run: one row an epoch, as csv and for TensorBoard."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from phnn.results import Place

FILE = "log.csv"
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
        self.place, self.text = place / FILE, io.StringIO(newline="")
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
