"""Conceal many effects, seal the answers, diagnose all, count: ``python scripts/prove.py out=DIR [same=60]``.

Settings are those of configs/prove.yaml. Writes ``report.html``, tables and figures; repeated in the same place, a
proof goes on where it stopped.
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

from phnn.threads import ONE_THREAD

# Sums over several threads round otherwise: answers would depend on the number of cores. Before numpy is loaded.
os.environ.update({name: os.environ.get(name, count) for name, count in ONE_THREAD.items()})


def run(out: Path, given: Mapping[str, Any]) -> None:
    """Carry a proof out and print its rates and numbers."""
    from rich.table import Table

    from phnn.commands.terminal import console
    from phnn.configuration import checked
    from studies.proof.cases import Settings
    from studies.proof.page import counts, numbers, write_proof
    from studies.proof.prove import claimed, prove

    settings = Settings.from_config(checked("prove", given))
    print(f"seed {settings.seed}", flush=True)
    with claimed(out, settings) as place:
        outcomes, digest = prove(settings, place, lambda message: print(message, flush=True))
        rates = write_proof(outcomes, settings, digest, place)
    table = Table("what", "share", "cases", "95 % interval", "target", title="proof")
    for r in (r for r in rates if r.cases):
        low, high = (f"{100 * v:.1f}" for v in r.interval)
        table.add_row(r.label, f"{100 * r.share:.1f} %", f"{r.hits} of {r.cases}", f"{low} – {high} %", r.target)
    console().print(table)
    if nulls := counts(outcomes):
        names = ("nulls of", "cases", "right", "false names", "unknown", "failed", "seconds")
        table = Table(*names, title="nulls by family")
        for c in nulls:
            named = f"{c.named}: {c.false}" if c.named else "0"
            table.add_row(c.family, *map(str, (c.cases, c.right, named, c.unknown, c.failed)), f"{c.seconds:.0f}")
        console().print(table)
    for label, value, target in numbers(outcomes):
        print(f"{label}: {value} (target {target})")
    print(f"report: {out / 'report.html'}")


@hydra.main(version_base=None, config_path="../configs", config_name="experiment/prove")
def main(config: DictConfig) -> None:
    """Run, and refuse bad input in one line."""
    from phnn.commands.terminal import refusals

    given = OmegaConf.to_container(config, resolve=True)
    with refusals("prove"):
        run(Path(given.pop("out")), given)


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        print("prove: interrupted; the same command continues", file=sys.stderr)
        sys.exit(130)
