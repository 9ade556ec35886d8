"""The experiments of the paper's Sec. 3: ``python scripts/experiment.py [folder=recordings] [out=out/mine]``.

Refits the port-Hamiltonian and the Bouc–Wen model, prints Table 3 beside the paper's figures, draws Figs. 10–15.
"""

from __future__ import annotations

import sys
from pathlib import Path

import hydra
from omegaconf import DictConfig

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # studies/ is not installed

from phnn.commands import refusals, status
from phnn.configuration import checked
from phnn.identification.plan import Options
from studies import paper
from studies.recordings import Conditions


def run(config: DictConfig) -> None:
    """Run one experiment from a composed configuration."""
    options = Options.from_config(checked("identify", config.fit))
    out, manifest = Path(config.out), Path(config.manifest) if config.manifest else None
    folder = None if config.folder is None else (Path(config.folder), manifest)
    with status() as progress:
        recorded, published = folder or Conditions(**config.recordings), folder is None or bool(config.published)
        paper.run(recorded, out, options, published, progress)
    print((out / "experiment.md").read_text(encoding="utf-8"))
    print(f"results: {out / 'experiment.md'}")


@hydra.main(version_base=None, config_path="../configs", config_name="experiment/paper")
def main(config: DictConfig) -> None:
    """Run, and refuse bad input in one line."""
    with refusals("experiment"):
        run(config)


if __name__ == "__main__":
    main()
