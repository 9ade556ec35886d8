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

from phnn.ensemble.processes import ONE_THREAD
from phnn.errors import PhnnError

# Times are those of one processor. Before numpy and torch are loaded.
os.environ.update(ONE_THREAD)


@hydra.main(version_base=None, config_path="../configs", config_name="experiment/trainers")
def main(config: DictConfig) -> None:
    """Run, and refuse bad input in one line."""
    from phnn.comparison.trainers_page import RESULTS, run
    from phnn.output import claim

    try:
        with claim(Path(config.out), "trainers", (), RESULTS) as place:
            table = run(
                place,
                OmegaConf.to_container(config, resolve=True),
                lambda line: print(line, file=sys.stderr, flush=True),
            )
    except PhnnError as error:
        print(f"trainers: {error}", file=sys.stderr)
        sys.exit(error.exit_status)
    print(table)


if __name__ == "__main__":
    main()
