"""``phnn demo``: conceal an effect, seal it, diagnose, compare."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from phnn.commands.diagnose import diagnose_into
from phnn.demo import EFFECTS, make, open_seal, seal
from phnn.errors import PhnnError
from phnn.identification.options import Options
from phnn.integrate.cache import compile_ahead
from phnn.recordings import read
from phnn.report.provenance import command_line, provenance
from phnn.results import claim

# Members of a class beyond which it names nothing.
_CLASS = 3


def demo(seed: int | None, out: Path, config: Mapping[str, Any], overwrite: bool = False) -> None:
    """Conceal an effect, seal it, diagnose the recordings, open the seal.

    Raises:
        PhnnError: the sealed effect was neither named nor in a stated class of at most three.
    """
    chosen = secrets.randbelow(10_000) if seed is None else seed
    compile_ahead()
    print(f"seed {chosen} (repeat with SEED={chosen}); one of {', '.join(EFFECTS)} is concealed", flush=True)
    with claim(out, "demo", (), ("recordings", "seal", "diagnosis"), overwrite=overwrite) as place:
        made = make(chosen)
        for name, content in made.files.items():
            (place / "recordings" / name).write(content)
        answer, digest = seal(made.sealed)
        sealed_file = place / "seal" / "sealed.json"
        sealed_file.write(answer)
        print(f"sealed the answer in {out / 'seal' / 'sealed.json'}, SHA-256 {digest}", flush=True)
        campaign, result = read(place.path / "recordings"), out / "diagnosis"
        # The seed that was drawn, where none was given: only so the command gives the same again.
        made_of = provenance(campaign, command_line(["demo", "--seed", str(chosen), "--out", str(out)]))
        diagnosis = diagnose_into(campaign, place / "diagnosis", Options.from_config(config), result, made_of)
    if diagnosis.ended.interruption is not None:
        raise diagnosis.ended.interruption
    sealed = open_seal(sealed_file.path, digest)
    claimed = diagnosis.outcome.claimed
    named = list(dict.fromkeys(c.name for c in claimed))
    members = list(dict.fromkeys([*named, *(e.title for c in claimed for e in c.alike)]))
    held = diagnosis.before.over_noise("confirmation"), diagnosis.after.over_noise("confirmation")
    print(f"opened the seal: {sealed.effect}, residual {sealed.strength_over_noise:.3g} × noise, {sealed.parameters}")
    print(f"held-out residual over noise: {held[0]:.3g} -> {held[1]:.3g}")
    words = ("+".join(named) or diagnosis.verdict, ",".join(members) or "-")
    print(f"sealed: {sealed.effect}  verdict: {diagnosis.verdict}  named: {words[0]}  class: {words[1]}", flush=True)
    if sealed.effect not in named and not (sealed.effect in members and len(members) <= _CLASS):
        raise PhnnError(f"the sealed effect {sealed.effect} was not found; see {out / 'diagnosis' / 'report.html'}")
