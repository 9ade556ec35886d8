"""Conceal many effects, seal the answers, diagnose all, count: ``python scripts/prove.py out=DIR [same=60]``.

Settings are those of configs/prove.yaml. Writes ``report.md``, tables, and a log with a row for each case; repeated in
the same place, a proof goes on where it stopped.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import hydra
from omegaconf import DictConfig, OmegaConf

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # studies/ is not installed

from phnn.cli import ONE_THREAD

# Sums over several threads round otherwise: answers would depend on the number of cores. Before numpy is loaded.
os.environ.update({name: os.environ.get(name, count) for name, count in ONE_THREAD.items()})


def run(out: Path, given: Mapping[str, Any]) -> None:
    """Carry a proof out and print its page."""
    from phnn.configuration import checked
    from studies.proof.cases import Settings
    from studies.proof.page import claimed, prove, write_proof

    settings = Settings.from_config(checked("prove", given))
    print(f"seed {settings.seed}", flush=True)
    with claimed(out, settings) as place:
        cases, digest = prove(settings, place, lambda message: print(message, flush=True))
        print(write_proof(cases, settings, digest, place))
    print(f"report: {out / 'report.md'}")


@hydra.main(version_base=None, config_path="../configs", config_name="experiment/prove")
def main(config: DictConfig) -> None:
    """Run, and refuse bad input in one line."""
    from phnn.commands import refusals

    given = OmegaConf.to_container(config, resolve=True)
    with refusals("prove"):
        run(Path(given.pop("out")), given)


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        print("prove: interrupted; the same command continues", file=sys.stderr)
        sys.exit(130)
