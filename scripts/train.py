"""Train a model on recordings: ``python scripts/train.py folder=recordings out=out/mine [key=value ...]``."""

from __future__ import annotations

import sys

import hydra
from omegaconf import DictConfig, OmegaConf

from phnn import commands
from phnn.errors import PhnnError


@hydra.main(version_base=None, config_path="../configs", config_name="train")
def main(config: DictConfig) -> None:
    """Run one training from a composed configuration."""
    try:
        commands.train({str(k): v for k, v in OmegaConf.to_container(config, resolve=True).items()})
    except PhnnError as error:
        print(f"train: {error}", file=sys.stderr)
        sys.exit(error.exit_status)


if __name__ == "__main__":
    main()
