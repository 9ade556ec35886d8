"""Compare all models: ``python scripts/compare.py [folder=recordings] [out=out/mine] [compare.models=[phs,linear]]``.

Without a folder it makes recordings that also go beyond the identified range of frequency and amplitude.
"""

from __future__ import annotations

import sys
from pathlib import Path

import hydra
from omegaconf import DictConfig, OmegaConf

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # studies/ is not installed

from phnn.commands.compare import compare
from phnn.commands.terminal import console, refusals, status
from phnn.comparison.run import compare_on_made, show
from phnn.comparison.settings import Settings
from phnn.configuration import checked
from studies.recordings import Conditions


def run(config: DictConfig) -> None:
    """Run one comparison from a composed configuration."""
    chosen = checked("compare", OmegaConf.to_container(config.compare, resolve=True))
    out = Path(config.out)
    if config.folder is not None:
        compare(Path(config.folder), out, Path(config.manifest) if config.manifest else None, chosen)
        return
    with status() as progress:
        table = compare_on_made(out, Conditions(**config.recordings), Settings.from_config(chosen), progress)
    show(table, console())
    print(f"results: {out / 'compare.md'}")


@hydra.main(version_base=None, config_path="../configs", config_name="experiment/compare")
def main(config: DictConfig) -> None:
    """Run, and refuse bad input in one line."""
    with refusals("compare"):
        run(config)


if __name__ == "__main__":
    main()
