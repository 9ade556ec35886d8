"""Train a model on recordings: ``python scripts/train.py folder=recordings out=out/mine [key=value ...]``.

With ``-m`` and lists of values a sweep: ``python scripts/train.py -m launcher=joblib folder=recordings seed=0,1,2``.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import hydra
from omegaconf import DictConfig, OmegaConf

from phnn import multirun
from phnn.cli import ONE_THREAD

# Sums over several threads round otherwise: a run would depend on the number of cores. Before numpy and torch are
# loaded, and for the processes of a sweep as well.
os.environ.update({name: os.environ.get(name, count) for name, count in ONE_THREAD.items()})


@hydra.main(version_base=None, config_path="../configs", config_name="train")
def main(config: DictConfig) -> None:
    """Run one training from a composed configuration."""
    if multirun.is_sweep():
        multirun.run(config)
        return
    from phnn.commands import refusals, train

    with refusals("train"):
        train({str(k): v for k, v in OmegaConf.to_container(config, resolve=True).items()})


def _tell(folder: Path) -> bool:
    """Print the table of a sweep's runs; tell whether one has failed."""
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    from gather import gather

    return gather(folder)


if __name__ == "__main__":
    with multirun.concluded(_tell):
        main()
