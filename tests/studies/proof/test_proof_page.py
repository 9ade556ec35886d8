"""The figures of docs/proof.md are those of the runs whose tables lie beside the page."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

DOCS = Path(__file__).resolve().parents[3] / "docs"
PAGE = (DOCS / "proof.md").read_text(encoding="utf-8")
NULLS = pd.read_csv(DOCS / "proof-nulls.csv", keep_default_na=False)
CASES = pd.read_csv(DOCS / "proof-cases.csv", keep_default_na=False)


@pytest.mark.parametrize("row", list(NULLS.itertuples(index=False)), ids=lambda r: r.family)
def test_nulls_by_family(row: tuple[object, ...]) -> None:
    found = dict(zip(NULLS.columns, row, strict=True))
    assert f"| {found['family']} | {found['cases']} | {found['named']} | {found['unknown']} |" in PAGE


@pytest.mark.parametrize("group", ["same", "other", "outside"])
def test_cases_by_stratum(group: str) -> None:
    mine = CASES[CASES["group"] == group]
    right = int((mine["grade"] != "wrong").sum())
    assert any(line.startswith(f"| {group} |") and f"| {right} of {len(mine)} |" in line for line in PAGE.splitlines())


def test_wrong_answers_are_listed() -> None:
    wrong = CASES[CASES["grade"] == "wrong"]
    listed = next(line for line in PAGE.split("\n\n") if line.startswith("Wrong answers"))
    for truth in wrong["truth"]:
        assert truth.replace("+", " and ").replace("_", " ") in listed.replace("\n", " ")
