"""Compare all models: ``python scripts/compare.py [folder=recordings] [out=out/mine] [compare.models=[phs,linear]]``.

Without a folder it makes recordings that also go beyond the identified range of frequency and amplitude. The rivals of
``studies/rival_models`` are among the models.
"""

from __future__ import annotations

import sys
from pathlib import Path

import hydra
from omegaconf import DictConfig, OmegaConf

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # studies/ is not installed

from phnn.commands.compare import compare
from phnn.commands.terminal import console, refusals, status
from phnn.comparison.models import Settings
from phnn.comparison.run import show
from phnn.configuration import checked, number
from studies.comparison.run import compare_on_made
from studies.recordings import Conditions
from studies.rival_models.names import register_rivals


def run(config: DictConfig) -> None:
    """Run one comparison from a composed configuration."""
    register_rivals()
    chosen = checked("compare", OmegaConf.to_container(config.compare, resolve=True))
    out = Path(config.out)
    if config.folder is not None:
        compare(Path(config.folder), out, Path(config.manifest) if config.manifest else None, chosen)
        return
    conditions, inputs = Conditions(**config.recordings), int(number("inputs", config.inputs, 1))
    with status() as progress:
        results = compare_on_made(out, conditions, Settings.from_config(chosen), inputs, progress)
    show(results, console())
    print(f"results: {out / 'comparison.md'}")


@hydra.main(version_base=None, config_path="../configs", config_name="experiment/compare")
def main(config: DictConfig) -> None:
    """Run, and refuse bad input in one line."""
    with refusals("compare"):
        run(config)


if __name__ == "__main__":
    main()
