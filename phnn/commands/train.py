"""``phnn train``."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from phnn.commands.terminal import Config, status
from phnn.learn import Settings
from phnn.learn import train as run_training


def train(config: Config) -> None:
    """Train a model on a folder; see `phnn.learn.run.train` for what it writes."""
    settings = Settings.from_config(config)
    with status() as progress:
        content = run_training(settings, progress)
    table = Table("recording", "use", "fit %", "residual over noise", title=f"{settings.model['kind']}, trained")
    for name, row in content["recordings"].items():
        use = "held out" if row["held_out"] else "stopped the training" if row["validation"] else "trained on"
        table.add_row(escape(name), use, f"{row['fit_percent']:.2f}", f"{row['residual_over_noise']:.3g}")
    Console().print(table)
    Console().print(f"results: {settings.home}   seed: {settings.seed}")
