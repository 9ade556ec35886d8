"""The scores of a prediction as a table for a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.markup import escape
from rich.table import Table

from phnn.report.formatting import DASH, percent, quantity, ratio


def score_table(content: Mapping[str, Any]) -> Table | None:
    """Fit %, RMSE with its unit and residual over noise, recording by recording and in total; a dash where one is
    undefined. None where no output was recorded.

    Args:
        content: of ``predict.json``.
    """
    if not content["totals"]:
        return None
    table = Table("recording", "use", "fit %", "RMSE", "residual over noise")
    for name, row in content["recordings"].items():
        if row["samples"]:
            table.add_row(escape(name), "held out" if row["held_out"] else DASH, *_cells(row))
    table.add_section()
    for name, row in content["totals"].items():
        table.add_row(f"{name.replace('_', ' ')} ({row['recordings']})", "", *_cells(row))
    return table


def _cells(row: Mapping[str, Any]) -> tuple[str, str, str]:
    rmse = DASH if row["rmse"] is None else quantity(row["rmse"], row["unit"])
    return percent(row["fit_percent"], 2), rmse, ratio(row["residual_over_noise"])
