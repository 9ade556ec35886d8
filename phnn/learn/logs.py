"""Logs of a run: one row an epoch, as csv and for TensorBoard."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from phnn.output import Place

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
        self.place, self.rows = place / FILE, list(rows)
        self._write()
        self.board = _board((place / "tensorboard").own_folder(), len(rows)) if tensorboard else None

    def _write(self) -> None:
        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, COLUMNS)
        writer.writeheader()
        writer.writerows(self.rows)
        self.place.write(text.getvalue().encode())

    def add(self, row: Row) -> None:
        """One epoch."""
        self.rows.append(row)
        self._write()
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
