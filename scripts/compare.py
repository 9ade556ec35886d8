"""Compare models and rivals on a folder: ``python scripts/compare.py folder=DIR [compare.models=[phs,preisach]]``.

It is ``phnn compare`` with the rivals of ``studies/rival_models``. ``python scripts/rivals.py study=table`` makes the
recordings itself.
"""

from __future__ import annotations

import sys
from pathlib import Path

import hydra
from omegaconf import DictConfig, OmegaConf

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # studies/ is not installed

from phnn.commands import compare, refusals
from phnn.configuration import checked
from phnn.errors import InputRefused
from studies.rival_models.names import register_rivals


@hydra.main(version_base=None, config_path="../configs", config_name="experiment/compare")
def main(config: DictConfig) -> None:
    """Run, and refuse bad input in one line."""
    with refusals("compare"):
        if config.folder is None:
            raise InputRefused("no recordings: name their folder, folder=DIR")
        register_rivals()
        chosen = checked("compare", OmegaConf.to_container(config.compare, resolve=True))
        compare(Path(config.folder), Path(config.out), Path(config.manifest) if config.manifest else None, chosen)


if __name__ == "__main__":
    main()
