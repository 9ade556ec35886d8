"""``phnn prove``: conceal many effects, seal the answers, diagnose, count."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from studies.proof.nulls import Count, counts
from studies.proof.page import numbers, write_proof
from studies.proof.run import claimed
from studies.proof.run import prove as run_proof
from studies.proof.settings import Settings


def prove(out: Path, config: Mapping[str, Any], overwrite: bool = False) -> None:
    """Conceal many effects, seal the answers, diagnose all, count; writes ``report.html``, tables and figures."""
    settings = Settings.from_config(config)
    print(f"seed {settings.seed}", flush=True)
    with claimed(out, settings, overwrite) as place:
        outcomes, digest = run_proof(settings, place, lambda message: print(message, flush=True))
        found = write_proof(outcomes, settings, digest, place)
    table = Table("what", "share", "cases", "95 % interval", "target", title="proof")
    for r in found:
        if r.cases:
            low, high = (f"{100 * v:.1f}" for v in r.interval)
            table.add_row(r.label, f"{100 * r.share:.1f} %", f"{r.hits} of {r.cases}", f"{low} – {high} %", r.target)
    Console().print(table)
    nulls = counts(outcomes)
    if nulls:
        Console().print(_null_table(nulls))
    for label, value, target in numbers(outcomes):
        Console().print(f"{label}: {value} (target {target})")
    print(f"report: {out / 'report.html'}")


def _null_table(nulls: Sequence[Count]) -> Table:
    table = Table("nulls of", "cases", "right", "false names", "unknown", "failed", "seconds", title="nulls by family")
    for c in nulls:
        named = f"{c.named}: {c.false}" if c.named else "0"
        table.add_row(c.family, *map(str, (c.cases, c.right, named, c.unknown, c.failed)), f"{c.seconds:.0f}")
    return table
