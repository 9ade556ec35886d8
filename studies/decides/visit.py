"""Search sealed cases and log every model that was visited, with what it leaves of each recording.

A row of the log is one case: what was concealed, and for each model its elements, their free parameters, and the
weighted sum of squares and the number of samples of every recording, fitted and held out. How the models would be
weighed can then be compared without a further fit.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from phnn.diagnose.diagnosis import Diagnosis, diagnose
from phnn.diagnose.number import Visited, family, is_learned, uid
from phnn.effects import catalogue
from phnn.identification.options import Options
from phnn.recordings import read
from studies.generator import Sealed, draw_case, make_case
from studies.generator.cases import BOUC_WEN, PLAIN, PRANDTL_ISHLINSKII, Conditions

Row = dict[str, Any]


@dataclass(frozen=True)
class Group:
    """Cases of one kind: a stratum, the noise, and what else is asked for."""

    name: str
    stratum: str
    noise: str = ""
    conditions: Conditions = PLAIN


GROUPS: tuple[Group, ...] = (
    Group("none", "none"),
    Group("none, process noise", "none", "process:0.1"),
    Group("none, pink noise", "none", "pink:0.1"),
    Group("none, heavy tails", "none", "heavy"),
    Group("listed", "same"),
    Group("listed, another form", "other"),
    Group("outside the catalogue", "outside"),
    Group("pair", "pair"),
    Group("triple", "triple"),
    Group("listed, with a background", "same", conditions=Conditions(background=True)),
    Group("listed, base of plays", "same", conditions=Conditions(base=PRANDTL_ISHLINSKII)),
    Group("listed, base of Bouc-Wen", "same", conditions=Conditions(base=BOUC_WEN)),
)


def groups_in_turn(shares: Sequence[int]) -> Iterator[Group]:
    """Yield the groups for ever, each as often in a round as its share."""
    while True:
        for group, share in zip(GROUPS, shares, strict=True):
            for _ in range(share):
                yield group


def visit(group: Group, seed: int, plan: str, levels: tuple[float, float], options: Options) -> Row:
    """Make a sealed case, diagnose it, and return the row of the log."""
    with TemporaryDirectory() as folder:
        case = draw_case(seed, group.stratum, plan, levels, noise=group.noise or None, conditions=group.conditions)
        sealed = make_case(case, Path(folder))
        campaign, began = read(Path(folder)), time.process_time()
        hidden = set(sealed.withheld)
        without = tuple(n for n, e in catalogue().items() if n in hidden or hidden & set(e.special_names))
        found = diagnose(campaign, replace(options, without=without))
        return {"group": group.name, "seed": seed, **_truth(sealed), **logged(found, time.process_time() - began)}


def _truth(sealed: Sealed) -> Row:
    return {
        "effects": list(sealed.effects), "withheld": list(sealed.withheld), "form": sealed.form,
        "locations": list(sealed.location), "level": sealed.strength_over_noise,
    }  # fmt: skip


def logged(found: Diagnosis, seconds: float) -> Row:
    """Return what a diagnosis says and all models that it visited."""
    return {
        "verdict": found.verdict,
        "probability": {n: p for n, p in found.probability.items() if p > 1e-4},
        "claims": [
            {
                "effect": c.name,
                "status": c.status,
                "probability": c.probability,
                "alike": [e.canonical for e in c.alike],
            }
            for c in found.claims
        ],
        "places": list(found.places),
        "rule": found.outcome.rules[-1].rule,
        "facts": {n: v for r in found.outcome.rules for n, v in r.numbers.items()},
        "held_out": [found.before.over_noise("confirmation"), found.after.over_noise("confirmation")],
        "seconds": seconds, "evaluations": found.ended.evaluations, "ended": found.ended.why,
        "models": [_model(m) for m in found.visited.models],
    }  # fmt: skip


def _model(model: Visited) -> Row:
    return {
        "elements": [
            {
                "name": family(e), "form": uid(e), "learned": is_learned(e), "location": e.location,
                "parameters": model.parameters_of(e),
            }
            for e in model.elements
        ],
        "nuisances": model.nuisances,
        "converged": model.converged,
        "fitted": {n: list(m) for n, m in model.fitted.items()},
        "held_out": {n: list(m) for n, m in model.held_out.items()},
    }  # fmt: skip
