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
from test_grade import BESIDE, CREEP, FEWER, HERE, NOTHING, OTHER, OTHER_CREEP, UNKNOWN, case, said

from phnn.criteria import Criteria
from phnn.results import Place
from studies.proof.cases import Settings
from studies.proof.page import detection, half_point, nulls, rates, write_proof
from studies.sealed.grade import Case, share_interval

DOCS = Path(__file__).resolve().parents[3] / "docs"
PAGE = (DOCS / "proof.md").read_text(encoding="utf-8")
NULLS = pd.read_csv(DOCS / "proof-nulls.csv", keep_default_na=False)
CASES = pd.read_csv(DOCS / "proof-cases.csv", keep_default_na=False)
FALSE = "nothing missing: false alarms, whole command"


def named(*names: str) -> dict[str, Any]:
    """An answer with names, in which the held-out error falls from three times the noise to it."""
    answer = said("named" if names else "none", *((n,) for n in names), held=(3.0, 1.0))
    return answer | {"base": 3.0, "p_value": 0.01, "seconds": 1.0}


def by_label(cases: list[Case]) -> dict[str, Any]:
    return {r.what: r for r in rates(cases).itertuples()}


def test_rates_have_exact_intervals() -> None:
    assert share_interval(0, 400) == pytest.approx((0.0, 0.00918), abs=1e-4)
    found = by_label([case(CREEP, named(n)) for n in ("creep", "creep", "delay", "creep")])
    exactly, pairs = found["same form: exactly right"], found["pairs: right, or in a stated class of at most 4"]
    assert (exactly.share, exactly.low) == (0.75, pytest.approx(0.194, abs=1e-3))
    assert pairs.cases == 0 and np.isnan(pairs.share)


def test_false_alarms_are_counted_by_grade() -> None:
    answers = [named(), named("creep"), UNKNOWN, named("delay")]
    assert by_label([case(BESIDE, a) for a in answers])[FALSE].hits == 1
    # A hysteron too few in the manifest is missing, so that to name it is no false alarm either.
    assert by_label([case(FEWER, named("extra_hysteron"))])[FALSE].cases == 0
    (count,) = nulls([case(BESIDE, a, group="nulls", family="white") for a in answers]).itertuples()
    assert (count.cases, count.right, count.named, count.unknown, count.false) == (4, 3, 1, 0, "delay (1)")


def test_p_values_of_nothing_are_counted() -> None:
    found = by_label([case(NOTHING, named() | {"p_value": p}, group="fast_none") for p in (0.04, 0.2, 0.6)])
    assert found["nothing missing: stated p-value at most 5 %"].hits == 1


def test_rates_of_another_hysteresis_stand_alone() -> None:
    cases = [case(OTHER, HERE), case(OTHER, named()), case(OTHER_CREEP, named("creep"))]
    found = by_label(cases)
    assert found[FALSE].cases == found["same form: exactly right"].cases == 0
    alone, beside = (r for label, r in found.items() if label.startswith("another hysteresis"))
    assert (alone.hits, alone.cases, beside.hits, beside.cases) == (1, 2, 1, 1)


def test_intervals_of_normal_errors_are_covered_as_stated() -> None:
    rng = np.random.default_rng(0)
    many = [
        case(CREEP, named("creep"), errors={"base": dict(enumerate(rng.standard_normal(9))), "effect": {"k_s": 3.0}})
        for _ in range(1000)
    ]
    found = by_label(many)
    assert found["base parameters inside their 68 % interval"].share == pytest.approx(0.68, abs=0.02)
    assert found["base parameters inside their 95 % interval"].share == pytest.approx(0.95, abs=0.01)
    effect = found["effect parameters inside their 95 % interval"]
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
    cases = []
    for delta in np.exp(rng.uniform(0.0, np.log(30.0), 3000)):
        noticed = bool(rng.standard_normal() + delta > Criteria().score)
        cases.append(case(replace(CREEP, delta=float(delta)), named(*["creep"] * noticed), group="fast_weak"))
    assert detection(cases) == pytest.approx((1.0, 1.0), abs=0.12)
    assert detection([]) is None


def test_the_page_lists_what_is_wrong(tmp_path: Path) -> None:
    cases = [case(CREEP, named("creep")), case(CREEP, named("delay"), seed=2), case(CREEP, {"failure": "no"}, seed=3)]
    page = write_proof(cases, Settings(), "abc", Place(tmp_path))
    assert "from the seed 2026. The SHA-256" in page
    assert "1 diagnoses ended without an answer" in page
    wrong = page.partition("## Wrong answers")[2]
    assert "| same | 1 |" not in wrong
    assert "| same | 2 | creep | 4.00 | named | delay | mechanical | mechanical | wrong |  |" in wrong
    table = pd.read_csv(tmp_path / "cases.csv", keep_default_na=False)
    assert table["grade"].tolist() == ["exact", "wrong", "wrong"]
    assert float(table["held_before"][0]) == 3.0
    assert page.strip() == (tmp_path / "report.md").read_text(encoding="utf-8").strip()


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
