"""``phnn predict``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.markup import escape
from rich.table import Table

from phnn.commands.terminal import console
from phnn.parameters import quantity
from phnn.prediction import document
from phnn.predictor import load, predictions
from phnn.recordings import read
from phnn.report.formatting import DASH, percent, ratio
from phnn.results import claim, printable, unique_names


def predict(
    model: Path, folder: Path, out: Path, manifest: Path | None, outside: bool = False, overwrite: bool = False
) -> None:
    """Simulate the recordings of a folder with a stored model; writes one ``NAME.csv`` per recording and
    ``predict.json`` with fit %, RMSE and residual over noise wherever the output was recorded.

    Where the input jumps between two samples, a further column says how uncertain that makes the output.
    """
    loaded = load(model, outside)
    campaign = read(folder, manifest, need_output=False, allow_outside=outside)
    found = predictions(loaded, campaign)
    files, entries = unique_names((r.name for r in campaign.recordings), ".csv"), []
    results = (*files.values(), "predict.json")
    with claim(out, "predict", [model, folder], results, overwrite=overwrite) as place:
        for one in found:
            name = files[one.recording.name]
            (place / name).write(one.table.to_csv(index=False).encode())
            entries.append(one)
            print(out / name)
        content = document(entries, files, printable(str(model)))
        (place / "predict.json").write_json(content)
    table = _score_table(content)
    if table is not None:
        console().print(table)
    print(f"results: {out / 'predict.json'}")


def _score_table(content: Mapping[str, Any]) -> Table | None:
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
