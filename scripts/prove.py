"""Conceal many effects and count what the diagnosis finds: ``python scripts/prove.py [out=DIR] [prove.same=60]``."""

from __future__ import annotations

import sys
from pathlib import Path

import hydra
from omegaconf import DictConfig, OmegaConf

from phnn.commands.prove import prove
from phnn.configuration import checked
from phnn.errors import PhnnError


@hydra.main(version_base=None, config_path="../configs", config_name="experiment/prove")
def main(config: DictConfig) -> None:
    """Run, and refuse bad input in one line."""
    try:
        prove(Path(config.out), checked("prove", OmegaConf.to_container(config.prove, resolve=True)))
    except PhnnError as error:
        print(f"prove: {error}", file=sys.stderr)
        sys.exit(error.exit_status)


if __name__ == "__main__":
    main()
