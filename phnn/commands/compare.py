"""``phnn compare``."""

from __future__ import annotations

from pathlib import Path

from phnn.commands.terminal import Config, console, status
from phnn.comparison.models import Settings
from phnn.comparison.run import compare as run_comparison
from phnn.comparison.run import show
from phnn.recordings import read


def compare(
    folder: Path, out: Path, manifest: Path | None, config: Config, outside: bool = False, overwrite: bool = False
) -> None:
    """Fit several kinds of model to a folder; see `phnn.comparison.run.compare` for what it writes."""
    settings = Settings.from_config(config)
    with status() as progress:
        campaign = read(folder, manifest, allow_outside=outside)
        results = run_comparison(campaign, out, settings, progress, overwrite)
    show(results, console())
    print(f"results: {out / 'compare.md'}   seed: {settings.options.seed}")
