"""Compare all models: ``python scripts/compare.py [folder=recordings] [out=out/mine] [compare.models=[phs,linear]]``.

Without a folder it makes recordings that also go beyond the identified range of frequency and amplitude.
"""

from __future__ import annotations

import sys
from pathlib import Path

import hydra
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from phnn.commands.compare import compare
from phnn.comparison.run import compare_on_made, show
from phnn.comparison.settings import Settings
from phnn.configuration import checked
from phnn.errors import PhnnError
from phnn.experiment.recordings import Conditions
from phnn.identification.base import quiet


def run(config: DictConfig) -> None:
    """Run one comparison from a composed configuration."""
    chosen = checked("compare", OmegaConf.to_container(config.compare, resolve=True))
    out = Path(config.out)
    if config.folder is not None:
        compare(Path(config.folder), out, Path(config.manifest) if config.manifest else None, chosen)
        return
    progress = (lambda message: print(message, file=sys.stderr, flush=True)) if sys.stderr.isatty() else quiet
    table = compare_on_made(out, Conditions(**config.recordings), Settings.from_config(chosen), progress)
    show(table, Console() if sys.stdout.isatty() else Console(width=200))
    print(f"results: {out / 'compare.md'}")


@hydra.main(version_base=None, config_path="../configs", config_name="experiment/compare")
def main(config: DictConfig) -> None:
    """Run, and refuse bad input in one line."""
    try:
        run(config)
    except PhnnError as error:
        print(f"compare: {error}", file=sys.stderr)
        sys.exit(error.exit_status)


if __name__ == "__main__":
    main()
