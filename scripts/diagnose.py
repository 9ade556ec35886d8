"""Diagnose a folder of recordings: ``python scripts/diagnose.py folder=recordings out=out/mine [key=value ...]``."""

from __future__ import annotations

from pathlib import Path

import hydra
from omegaconf import DictConfig

from phnn.commands import diagnose, refusals


@hydra.main(version_base=None, config_path="../configs", config_name="experiment/folder")
def main(config: DictConfig) -> None:
    """Run one diagnosis from a composed configuration."""
    manifest = Path(config.manifest) if config.manifest else None
    with refusals("diagnose"):
        diagnose(Path(config.folder), Path(config.out), manifest, config.diagnose)


if __name__ == "__main__":
    main()
