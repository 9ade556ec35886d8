"""Compare models on a folder of recordings: ``python scripts/compare.py folder=recordings out=out/mine``."""

from __future__ import annotations

from pathlib import Path

import hydra
from omegaconf import DictConfig

from phnn import commands


@hydra.main(version_base=None, config_path="../configs", config_name="experiment/folder")
def main(config: DictConfig) -> None:
    """Fit and score all models from a composed configuration."""
    manifest = Path(config.manifest) if config.manifest else None
    commands.compare(Path(config.folder), Path(config.out), manifest, config.compare)


if __name__ == "__main__":
    main()
