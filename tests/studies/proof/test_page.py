"""What is counted over graded cases, and the figures of docs/proof.md."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_grade import BESIDE, CREEP, FEWER, NOTHING, OTHER, OTHER_CREEP, TASK, entry

from phnn.diagnose.criteria import Criteria
from studies.proof.cases import Task
from studies.proof.grade import graded
from studies.proof.page import Rate, confusion, counts, coverage, detection, half_point, rates, reliability

DOCS = Path(__file__).resolve().parents[3] / "docs"
PAGE = (DOCS / "proof.md").read_text(encoding="utf-8")
NULLS = pd.read_csv(DOCS / "proof-nulls.csv", keep_default_na=False)
CASES = pd.read_csv(DOCS / "proof-cases.csv", keep_default_na=False)
FALSE = "nothing missing: false alarms, whole command"


def named(*names: str) -> dict[str, Any]:
    """An answer with names, in which the held-out error falls from three times the noise to it."""
    before, after = ({n: {"residual_over_noise": v} for n in "ab"} for v in (3.0, 1.0))
    fit = {"before": before, "after": after, "held_out": ["b"]}
    verdict = "unknown" if names == ("unknown",) else "named" if names else "none"
    return {"verdict": verdict, "missing": [entry(n) for n in names], "fit": fit}


def test_rates_have_exact_intervals() -> None:
    assert Rate("", 0, 400, "").interval == pytest.approx((0.0, 0.00918), abs=1e-4)
    assert np.isnan(Rate("", 0, 0, "").share)
    outcomes = [graded(TASK, CREEP, named(n)) for n in ("creep", "creep", "delay", "creep")]
    by_label = {r.label: r for r in rates(outcomes)}
    assert by_label["same form: exactly right"].share == 0.75
    assert by_label["pairs: both"].cases == 0
    assert confusion(outcomes, "same") == {"creep": {"creep": 3, "delay": 1}}


def test_false_alarms_are_counted_by_grade() -> None:
    task = replace(TASK, group="none")
    answers = [named(), named("creep"), named("unknown"), named("delay")]
    by_label = {r.label: r for r in rates([graded(task, BESIDE, a) for a in answers])}
    assert by_label[FALSE].hits == 1
    assert not any("another hysteresis" in label for label in by_label)
    # A hysteron too few in the manifest is missing, so that to name it is no false alarm either.
    assert {r.label: r for r in rates([graded(task, FEWER, named("extra_hysteron"))])}[FALSE].cases == 0
    null = replace(TASK, group="nulls", family="white")
    (count,) = counts([graded(null, BESIDE, a) for a in answers])
    assert (count.cases, count.right, count.named, count.unknown, count.false) == (4, 3, 1, 0, "delay (1)")


def test_rates_of_another_hysteresis_stand_alone() -> None:
    task, here = replace(TASK, group="none"), named("unknown") | {"location": {"name": "hysteron"}}
    outcomes = [graded(task, OTHER, here), graded(task, OTHER, named()), graded(task, OTHER_CREEP, named("creep"))]
    by_label = {r.label: r for r in rates(outcomes)}
    assert by_label[FALSE].cases == by_label["same form: exactly right"].cases == 0
    alone, beside = (r for label, r in by_label.items() if label.startswith("another hysteresis"))
    assert (alone.hits, alone.cases, beside.hits, beside.cases) == (1, 2, 1, 1)
    assert [o.reason for o in outcomes] == ["", "not noticed", ""]
    assert outcomes[0].places == ("hysteron",)
    assert outcomes[2].effect_errors == ()


def test_intervals_of_normal_errors_are_covered_as_stated() -> None:
    outcome, rng = graded(TASK, CREEP, named("creep")), np.random.default_rng(0)
    many = [replace(outcome, base_errors=tuple(rng.standard_normal(9)), effect_errors=(3.0,)) for _ in range(1000)]
    by_label = {r.label: r for r in coverage(many)}
    assert by_label["base parameters inside their 68 % interval"].share == pytest.approx(0.68, abs=0.02)
    assert by_label["base parameters inside their 95 % interval"].share == pytest.approx(0.95, abs=0.01)
    effect = by_label["effect parameters inside their 95 % interval"]
    assert (effect.hits, effect.cases) == (0, 1000)


@given(st.floats(2.0, 30.0), st.integers(0, 2**31))
def test_half_point_is_where_half_the_hits_are(half: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    delta = np.exp(rng.uniform(np.log(half / 8.0), np.log(half * 8.0), 4000))
    hit = rng.random(delta.size) < 1.0 / (1.0 + (half / delta) ** 6)
    assert half_point(delta, hit.astype(float)) == pytest.approx(half, rel=0.1)
    assert np.isnan(half_point(delta, np.ones_like(delta)))


def test_detection_of_the_limit_itself_has_ratio_one() -> None:
    rng = np.random.default_rng(0)
    z = Criteria().score
    outcomes = []
    for number, delta in enumerate(np.exp(rng.uniform(0.0, np.log(30.0), 3000))):
        task = Task("fast", "fast_weak", number, number, "short")
        seen = bool(rng.standard_normal() + delta > z)
        outcomes.append(graded(task, replace(CREEP, delta=float(delta)), named(*["creep"] * seen)))
    curve = detection(outcomes)
    assert curve is not None
    assert curve.half[1] / curve.half[0] == pytest.approx(1.0, abs=0.12)
    assert np.abs(curve.found - curve.limit).max() < 0.12
    assert detection([]) is None


def test_reliability_counts_p_values() -> None:
    task = Task("fast", "fast_none", 0, 0, "short")
    tests = [{"test": {"statistic": 1.0, "p_value": p}} for p in (0.2, 0.6)]
    outcomes = [graded(task, NOTHING, named() | test) for test in tests]
    assert reliability(outcomes, [0.1, 0.3, 0.7]).tolist() == [0.0, 0.5, 1.0]


@pytest.mark.parametrize("row", list(NULLS.itertuples(index=False)), ids=lambda r: r.family)
def test_nulls_by_family_in_the_documentation(row: tuple[object, ...]) -> None:
    values = dict(zip(NULLS.columns, row, strict=True))
    assert f"| {values['family']} | {values['cases']} | {values['named']} | {values['unknown']} |" in PAGE


@pytest.mark.parametrize("group", ["same", "other", "outside"])
def test_cases_by_stratum_in_the_documentation(group: str) -> None:
    mine = CASES[CASES["group"] == group]
    right = int((mine["grade"] != "wrong").sum())
    assert any(line.startswith(f"| {group} |") and f"| {right} of {len(mine)} |" in line for line in PAGE.splitlines())


def test_wrong_answers_are_listed_in_the_documentation() -> None:
    wrong = CASES[CASES["grade"] == "wrong"]
    listed = next(line for line in PAGE.split("\n\n") if line.startswith("Wrong answers"))
    for truth in wrong["truth"]:
        assert truth.replace("+", " and ").replace("_", " ") in listed.replace("\n", " ")
