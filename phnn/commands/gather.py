"""The table of the training runs in a folder."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from rich.markup import escape
from rich.table import Table

from phnn.commands.terminal import console
from phnn.learn.gather import gather as gather_runs
from phnn.results import Place


def gather(folder: Path) -> pd.DataFrame:
    """Print the table of the training runs in a folder; writes ``runs.csv`` there."""
    found = gather_runs(folder)
    (Place(folder.resolve()) / "runs.csv").write(found.to_csv(index=False).encode())
    columns = [c for c in found.columns if c not in ("run", "reason")]
    table = Table(*columns, title=f"runs in {folder}")
    for row in found[columns].astype(object).to_numpy().tolist():
        table.add_row(*("–" if pd.isna(v) else f"{v:.4g}" if isinstance(v, float) else escape(str(v)) for v in row))
    console(160).print(table)
    for name, reason in found.loc[found["state"] == "failed", ["run", "reason"]].to_numpy().tolist():
        print(f"{name}: {reason}")
    print(f"results: {folder / 'runs.csv'}")
    return found
