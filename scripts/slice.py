"""Prove a few fresh cases and diagnose a real recording: ``python scripts/slice.py [out=DIR] [folder=DIR] [seed=7]``.

The seed is drawn and printed, so that every run asks something new and can be repeated.
"""

from __future__ import annotations

import json
import secrets
import sys
from pathlib import Path

import hydra
from omegaconf import DictConfig, OmegaConf

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # studies/ is not installed

from phnn.commands import diagnose, refusals
from phnn.configuration import checked, config_folder
from studies.proof.cases import NULLS, Settings
from studies.proof.page import claimed, is_right, prove, row
from studies.sealed.grade import Case


def said(case: Case) -> str:
    """One line on a case."""
    r = row(case)
    held = f"{r['held_before']:.3g} → {r['held_after']:.3g} × noise"
    return (
        f"{r['group']} {r['seed']}: concealed {r['truth'] or 'none'}; {r['verdict']}: {r['named'] or '–'}; "
        f"held out {held}; {r['grade']}"
    )


def proof(config: DictConfig) -> list[str]:
    """Carry the small proof out; what is wrong with it."""
    stated = checked("prove", OmegaConf.to_container(config.prove, resolve=True))
    stated["seed"] = secrets.randbelow(10**6) if config.seed is None else int(config.seed)
    print(f"seed {stated['seed']}", flush=True)
    settings = Settings.from_config(stated)
    with claimed(Path(config.out) / "proof", settings) as place:
        cases, _ = prove(settings, place, lambda _: None)
    print("\n".join(said(c) for c in cases), flush=True)
    nulls = [c for c in cases if c.row["group"] == NULLS]
    right = sum(is_right(c) for c in cases if c not in nulls)
    false = sum(not is_right(c) for c in nulls)
    wrong = []
    if right < config.fewest_right:
        wrong.append(f"{right} of {len(cases) - len(nulls)} effects were found, at least {config.fewest_right} wanted")
    if false > config.most_false:
        wrong.append(f"{false} of {len(nulls)} nulls were taken for physics, at most {config.most_false} may be")
    return wrong


def real(config: DictConfig) -> list[str]:
    """Diagnose a real folder where it is present; what is wrong with the answer."""
    folder = Path(config.folder) / config.study
    if not folder.is_dir():
        print(f"skipped: {folder} is no folder; folder=DIR names where the recordings lie")
        return []
    out, manifest = Path(config.out) / config.study, config_folder() / "recordings" / config.study / "recordings.yaml"
    diagnose(folder, out, manifest, checked("diagnose", {}))
    found = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    held = found["fit"]["held_out"]
    before, after = (
        max((found["fit"][which][n]["residual_over_noise"] for n in held), default=0.0) for which in ("before", "after")
    )
    print(f"{config.study}: {found['verdict']}; held out {before:.4g} → {after:.4g} × noise")
    worse = after > 1.05 * before
    return [f"{config.study}: the model that is handed over is worse on held-out recordings"] if worse else []


@hydra.main(version_base=None, config_path="../configs", config_name="experiment/slice")
def main(config: DictConfig) -> None:
    """Run both; exit status 1 where something is wrong."""
    with refusals("slice"):
        wrong = proof(config) + real(config)
    for line in wrong:
        print(f"slice: {line}", file=sys.stderr)
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
