"""Logs of a run: one row an epoch, as csv and for TensorBoard."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

FILE = "log.csv"
COLUMNS = ("epoch", "method", "loss", "validation", "rate", "seconds")
Row = dict[str, Any]


class Log:
    """Rows are written as they come; a resumed run first writes again what its checkpoint knows.

    Args:
        folder: gets ``log.csv`` and, if wanted and installed, ``tensorboard/``.
        rows: of the epochs before.
        tensorboard: write for it as well.
    """

    def __init__(self, folder: Path, rows: Sequence[Row] = (), tensorboard: bool = True) -> None:
        self.path = folder / FILE
        folder.mkdir(parents=True, exist_ok=True)
        with self.path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            writer.writerows(rows)
        self.board = _board(folder / "tensorboard", len(rows)) if tensorboard else None

    def add(self, row: Row) -> None:
        """One epoch."""
        with self.path.open("a", newline="", encoding="utf-8") as file:
            csv.DictWriter(file, COLUMNS).writerow(row)
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
