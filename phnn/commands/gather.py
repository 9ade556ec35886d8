"""The table of the training runs in a folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
from rich.markup import escape
from rich.table import Table

from phnn.commands.terminal import console
from phnn.learn.gather import gather as gather_runs
from phnn.results import INDEX, Place, write_index


def gather(folder: Path) -> pd.DataFrame:
    """Print the table of the training runs in a folder, and return it.

    Writes ``runs.csv`` and ``index.html``, which links the runs, into the folder.
    """
    found, place = gather_runs(folder), Place(folder.resolve())
    (place / "runs.csv").write(found.to_csv(index=False).encode())
    cells = [[_text(value) for value in row] for row in found.astype(object).to_numpy().tolist()]
    links = {f"{run}/{INDEX}" if (folder / run / INDEX).is_file() else f"{run}/": (run, *row) for run, *row in cells}
    write_index(place, "Runs of phnn train", list(found.columns), links)
    columns = [c for c in found.columns if c not in ("run", "reason")]
    table = Table(*columns, title=f"runs in {folder}")
    for row in found[columns].astype(object).to_numpy().tolist():
        table.add_row(*(escape(_text(value)) for value in row))
    console(160).print(table)
    for name, reason in found.loc[found["state"] == "failed", ["run", "reason"]].to_numpy().tolist():
        print(f"{name}: {reason}")
    print(f"results: {folder / 'runs.csv'}")
    return found


def _text(value: Any) -> str:
    return "–" if pd.isna(value) else f"{value:.4g}" if isinstance(value, float) else str(value)
