"""The console commands `demo` and `prove`: they conceal effects, diagnose them and count the outcomes."""

from __future__ import annotations

import secrets
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from phnn.commands import diagnose_into
from phnn.errors import PhnnError
from phnn.identification.options import Options
from phnn.output import claim, write_atomic
from phnn.recordings import read

if TYPE_CHECKING:
    from phnn.prove.nulls import Count

# Members of a class beyond which it names nothing.
_CLASS = 3


def demo(seed: int | None, out: Path, config: Mapping[str, Any], overwrite: bool = False) -> None:
    """Conceal an effect, seal it, diagnose the recordings, open the seal.

    Raises:
        PhnnError: the sealed effect was neither named nor in a stated class of at most three.
    """
    from phnn.demo import EFFECTS, generate, open_seal, write_seal

    chosen = secrets.randbelow(10_000) if seed is None else seed
    print(f"seed {chosen} (repeat with SEED={chosen}); one of {', '.join(EFFECTS)} is concealed", flush=True)
    with claim(out, "demo", (), ("recordings", "seal", "diagnosis"), overwrite=overwrite) as place:
        folder, seal_file = (place / "recordings").own_folder(), (place / "seal").own_folder() / "sealed.json"
        digest = write_seal(generate(chosen, folder, write=write_atomic), seal_file, write_atomic)
        print(f"sealed the answer in {seal_file}, SHA-256 {digest}", flush=True)
        diagnosis = diagnose_into(read(folder), place / "diagnosis", Options.from_config(config), out / "diagnosis")
    sealed = open_seal(seal_file)
    j = diagnosis.judgement
    claimed = j.claimed
    named = [f.effect.name for f in claimed]
    members = list(dict.fromkeys(t.candidate.effect.name for f in claimed for t in f.members))
    held = diagnosis.before.over_noise("confirmation"), diagnosis.after.over_noise("confirmation")
    print(f"opened the seal: {sealed.effect}, residual {sealed.strength_over_noise:.3g} × noise, {sealed.parameters}")
    print(f"held-out residual over noise: {held[0]:.3g} -> {held[1]:.3g}")
    words = ("+".join(named) or j.verdict, ",".join(members) or "-")
    print(f"sealed: {sealed.effect}  verdict: {j.verdict}  named: {words[0]}  class: {words[1]}", flush=True)
    if sealed.effect not in named and not (sealed.effect in members and len(members) <= _CLASS):
        raise PhnnError(f"the sealed effect {sealed.effect} was not found; see {out / 'diagnosis' / 'report.html'}")


def prove(out: Path, config: Mapping[str, Any], overwrite: bool = False) -> None:
    """Conceal many effects, seal the answers, diagnose all, count; writes ``report.html``, tables and figures."""
    from phnn.prove.nulls import counts
    from phnn.prove.page import numbers, write_proof
    from phnn.prove.run import claimed
    from phnn.prove.run import prove as run_proof
    from phnn.prove.settings import Settings as ProofSettings

    settings = ProofSettings.from_config(config)
    print(f"seed {settings.seed}", flush=True)
    with claimed(out, settings, overwrite) as place:
        outcomes, digest = run_proof(settings, place, lambda message: print(message, flush=True))
        found = write_proof(outcomes, settings, digest, place)
    table = Table("what", "share", "cases", "95 % interval", "target", title="proof")
    for r in found:
        if r.cases:
            low, high = (f"{100 * v:.1f}" for v in r.interval)
            table.add_row(r.label, f"{100 * r.share:.1f} %", f"{r.hits} of {r.cases}", f"{low} – {high} %", r.target)
    console = Console()
    console.print(table)
    nulls = counts(outcomes)
    if nulls:
        console.print(_null_table(nulls))
    for label, value, target in numbers(outcomes):
        console.print(f"{label}: {value} (target {target})")
    print(f"report: {out / 'report.html'}")


def _null_table(nulls: Sequence[Count]) -> Table:
    table = Table("nulls of", "cases", "right", "false names", "unknown", "failed", "seconds", title="nulls by family")
    for c in nulls:
        named = f"{c.named}: {c.false}" if c.named else "0"
        table.add_row(c.family, *map(str, (c.cases, c.right, named, c.unknown, c.failed)), f"{c.seconds:.0f}")
    return table
