"""The files of a proof: ``report.html``, ``cases.csv``, ``rates.csv``, ``nulls.csv`` and its figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
import pandas as pd

from phnn.report.formatting import DASH, number
from phnn.report.plain import plain_page
from phnn.results import Place
from studies.proof.figures import draw_all
from studies.proof.grades import WRONG
from studies.proof.nulls import counts
from studies.proof.outcome import Outcome
from studies.proof.settings import FULL, Settings
from studies.proof.tally import Rate, detection, quantiles, rates, strong
from studies.results import write_results


def write_proof(outcomes: Sequence[Outcome], settings: Settings, digest: str, place: Place) -> list[Rate]:
    """Write tables, figures and the page; returns the rates."""
    found = rates(outcomes)
    drawings = draw_all(outcomes)
    table = [(r.label, r.target, r.hits, r.cases, *r.interval) for r in found]
    columns = ["what", "target", "hits", "cases", "low", "high"]
    tables = {
        "cases.csv": pd.DataFrame([o.row() for o in outcomes]),
        "rates.csv": pd.DataFrame(table, columns=columns),
    }
    nulls = counts(outcomes)
    if nulls:
        tables["nulls.csv"] = pd.DataFrame([asdict(c) for c in nulls])
    page = plain_page(
        "studies.proof",
        "page.html",
        outcomes=outcomes,
        settings=settings,
        digest=digest,
        failed=sum(bool(o.failure) for o in outcomes),
        rates=found,
        numbers=numbers(outcomes),
        drawings=drawings,
        nulls=nulls,
        wrong=[o for o in outcomes if o.grade == WRONG and o.group != "fast_weak"],
    )
    texts = {name: table.to_csv(index=False) for name, table in tables.items()}
    write_results(place, {**texts, "report.html": page.decode()}, drawings=drawings)
    return found


def numbers(outcomes: Sequence[Outcome]) -> list[tuple[str, str, str]]:
    """Figures that are no rates, with their targets: label, value, target."""
    found: list[tuple[str, str, str]] = []
    curve = detection(outcomes)
    if curve is not None:
        limit, seen, named = curve.half
        found += [
            ("strength detected in half the cases, over the limit's", _shown(seen / limit), "≤ 2"),
            ("strength named rightly in half the cases, over the limit's", _shown(named / limit), "≤ 3"),
        ]
    same = [o for o in outcomes if o.tier == FULL and o.stratum == "same" and o.group != "few" and strong(o)]
    right = [o for o in same if o.grade != WRONG]
    if same:
        median, ninth = quantiles((o.held_after for o in same), (0.5, 0.9))
        before = quantiles((o.held_before for o in same), (0.5,))[0]
        errors = [quantiles((getattr(o, n) for o in right), (0.5, 0.9)) for n in ("worst_before", "worst_after")]
        found += [
            ("held-out residual over noise before, median", _shown(before), DASH),
            ("held-out residual over noise after, median", _shown(median), "≤ 1.1"),
            ("held-out residual over noise after, 90th percentile", _shown(ninth), "≤ 1.5"),
            ("worst scale-free group of the base model, median error", _percent(errors[0][0]), DASH),
            ("worst scale-free group after a right diagnosis, median error", _percent(errors[1][0]), "≤ 1 %"),
            ("worst scale-free group after a right diagnosis, 90th percentile", _percent(errors[1][1]), "≤ 1 %"),
        ]
    spread = [abs(e) for o in outcomes if o.tier == FULL and o.grade != WRONG for e in o.effect_errors]
    if spread:
        found.append(
            ("effect parameters: median error over its standard error", _shown(float(np.median(spread))), "≤ 1")
        )
    for tier in ("fast", FULL):
        seconds = [o.seconds for o in outcomes if o.tier == tier and np.isfinite(o.seconds)]
        if seconds:
            found.append((f"seconds a case, {tier} tier: median", number(float(np.median(seconds))), DASH))
    return found


def _shown(value: float) -> str:
    return number(value) if np.isfinite(value) else DASH


def _percent(value: float) -> str:
    return f"{100.0 * value:.2g} %" if np.isfinite(value) else DASH
