"""Conceal many effects and count what the diagnosis finds: ``python scripts/prove.py [out=DIR] [prove.same=60]``."""

from __future__ import annotations

import sys
from pathlib import Path

import hydra
from omegaconf import DictConfig, OmegaConf

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # studies/ is not installed

from phnn.commands.prove import prove
from phnn.commands.terminal import refusals
from phnn.configuration import checked


@hydra.main(version_base=None, config_path="../configs", config_name="experiment/prove")
def main(config: DictConfig) -> None:
    """Run, and refuse bad input in one line."""
    with refusals("prove"):
        prove(Path(config.out), checked("prove", OmegaConf.to_container(config.prove, resolve=True)))


if __name__ == "__main__":
    main()
