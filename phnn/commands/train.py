"""``phnn train``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from phnn.commands.terminal import Config, status
from phnn.learn import Settings, train_folder


def train(config: Config) -> None:
    """Train a model on a folder; see `phnn.learn.run.train_folder` for what it writes."""
    settings = Settings.from_config(config)
    with status() as progress:
        content = train_folder(settings, progress)
    table = Table("recording", "use", "fit %", "residual over noise", title=f"{settings.named}, trained")
    for name, row in content["recordings"].items():
        use = "held out" if row["held_out"] else "stopped the training" if row["validation"] else "trained on"
        columns = (
            _with_spread(row, key, form) for key, form in (("fit_percent", ".2f"), ("residual_over_noise", ".3g"))
        )
        table.add_row(escape(name), use, *columns)
    Console().print(table)
    seeds = settings.seeds or (settings.seed,)
    Console().print(f"results: {settings.home}   seed: {', '.join(map(str, seeds))}")


def _with_spread(row: Mapping[str, Any], key: str, form: str) -> str:
    """A figure, with its standard deviation over several seeds."""
    spread = row.get(f"{key}_spread")
    return f"{row[key]:{form}}" + ("" if spread is None else f" ± {spread:.2g}")
