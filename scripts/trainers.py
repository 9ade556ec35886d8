"""Compare trainers: ``python scripts/trainers.py [out=out/mine] [only=[parametric]] [seed=1]``.

Gauss–Newton, `odeint_adjoint` and backpropagation: loss curves, errors held out, and times, one after another on one
processor.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import hydra
from omegaconf import DictConfig, OmegaConf

from phnn.cli import ONE_THREAD

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # studies/ is not installed

# Times are those of one processor. Before numpy and torch are loaded.
os.environ.update(ONE_THREAD)


@hydra.main(version_base=None, config_path="../configs", config_name="experiment/trainers")
def main(config: DictConfig) -> None:
    """Run, and refuse bad input in one line."""
    from phnn.commands import refusals
    from phnn.results import claim
    from studies.trainers import RESULTS, run

    settings = OmegaConf.to_container(config, resolve=True)
    with refusals("trainers"), claim(Path(config.out), "trainers", (), RESULTS) as place:
        table = run(place, settings, lambda line: print(line, file=sys.stderr, flush=True))
    print(table)


if __name__ == "__main__":
    main()
