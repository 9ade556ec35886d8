"""The comparison of trainers: what its table says, and the slow run that has to bear it out."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from scripts_example import script

from studies.trainers import Case, Outcome, Way, table

WAYS = {
    "gauss_newton": Way("Gauss–Newton", {"name": "discrete_gradient"}, "gauss_newton"),
    "adjoint": Way("adjoint", {"name": "torchdiffeq"}, "lbfgs"),
    "unrolled": Way("unrolled", {"name": "torchdiffeq"}, "lbfgs"),
}
CASES = {"dead": Case("dead zones", {"kind": "hrc"}, "table", 1, 1, tuple(WAYS), 60.0, 1e-7)}
OUTCOMES = [
    Outcome("dead", "gauss_newton", ((0.0, 100.0), (2.0, 1.0)), 10, True, 1.01, 1.02),
    Outcome("dead", "adjoint", ((0.0, 100.0), (6.0, 1.0)), 60, True, 1.01, None),
    Outcome("dead", "unrolled", ((0.0, 100.0), (60.0, 40.0)), 30, False, 6.0, 7.0),
]


def test_times_are_multiples_of_the_first_trainer() -> None:
    rows = table(OUTCOMES, CASES, WAYS).splitlines()[2:]
    assert rows[0].endswith("| 1.01 | 1.02 | 10 | 200 | 1.0 |")
    assert rows[1].endswith("| 1.01 | – | 60 | 100 | 3.0 |")
    assert rows[2].endswith("| 6 | 7 | 30 | 2000 | > 30, stopped |")


@pytest.mark.slow
def test_the_adjoint_trains_table_1_to_the_noise(tmp_path: Path) -> None:
    # Times are for the table of the script to tell: a test does not know what else the machine does.
    script(
        "trainers", f"out={tmp_path}", "only=[parametric,refined]", "cases.parametric.ways=[gauss_newton,adjoint]",
        "cases.refined.ways=[adjoint]",
    )  # fmt: skip
    found = json.loads((tmp_path / "trainers.json").read_text())["outcomes"]
    assert [(o["case"], o["way"]) for o in found] == [
        ("parametric", "gauss_newton"), ("parametric", "adjoint"), ("refined", "adjoint"),
    ]  # fmt: skip
    assert all(o["inside"] <= 1.1 for o in found)
    assert found[1]["curve"][-1][1] == pytest.approx(found[0]["curve"][-1][1], rel=1e-5)
    assert found[1]["beyond"] <= 1.1
    for name in ("trainers.md", "curves.csv", "curves.png"):
        assert (tmp_path / name).stat().st_size > 0
