"""The experiments of the paper's Sec. 3: ``python scripts/experiment.py [folder=recordings] [out=out/mine]``.

Refits the port-Hamiltonian and the Bouc–Wen model, prints Table 3 beside the paper's figures, draws Figs. 10–15.
"""

from __future__ import annotations

import sys
from pathlib import Path

import hydra
from omegaconf import DictConfig
from rich.console import Console

from phnn.configuration import checked
from phnn.errors import PhnnError
from phnn.experiment.recordings import Conditions
from phnn.experiment.run import run_folder, run_paper, show
from phnn.identification.base import quiet
from phnn.identification.options import Options


def run(config: DictConfig) -> None:
    """Run one experiment from a composed configuration."""
    progress = (lambda message: print(message, file=sys.stderr, flush=True)) if sys.stderr.isatty() else quiet
    options = Options.from_config(checked("identify", config.fit))
    out = Path(config.out)
    if config.folder is None:
        comparison = run_paper(out, Conditions(**config.recordings), options, progress)
    else:
        manifest = Path(config.manifest) if config.manifest else None
        comparison = run_folder(Path(config.folder), manifest, out, options, bool(config.published), progress)
    # A pipe has no width: the whole table fits there.
    show(comparison, Console() if sys.stdout.isatty() else Console(width=160))
    print(f"results: {out / 'experiment.md'}")


@hydra.main(version_base=None, config_path="../configs", config_name="experiment/paper")
def main(config: DictConfig) -> None:
    """Run, and refuse bad input in one line."""
    try:
        run(config)
    except PhnnError as error:
        print(f"experiment: {error}", file=sys.stderr)
        sys.exit(error.exit_status)


if __name__ == "__main__":
    main()
