"""A runner decides its cases, diagnoses each once, and keeps a row of each; a proof tells first what it conceals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from phnn.configuration import compose
from phnn.errors import InputRefused, PhnnError
from phnn.identification.plan import Options
from phnn.results import Place
from studies.proof.cases import STRATA, Settings, family, tasks
from studies.proof.page import claimed, prove, write_proof
from studies.sealed import run
from studies.sealed.grade import Case, cases_in

FEW = {"fast_none": 2, "fast_weak": 1, "executor": "serial", "fast_plan": "few"} | dict.fromkeys((*STRATA, "few"), 0)
NULLS = {"only": ["nulls"], "executor": "serial", "null_families": ["white", "ramp+process:0.1"], "nulls": 2}


def settings(**changes: Any) -> Settings:
    return Settings.from_config(compose("prove") | changes)


def proved(chosen: Settings, out: Path, say: run.Say = lambda line: None) -> tuple[list[Case], str]:
    """A proof in a folder that is claimed for it."""
    with claimed(out, chosen) as place:
        return prove(chosen, place, say)


def test_cases_stay_when_their_numbers_and_families_grow() -> None:
    few, many = tasks(settings(**FEW | {"same": 2})), tasks(settings(**FEW | {"same": 5, "other": 1}))
    assert set(few) <= set(many)
    assert len({t.seed for t in many}) == len({(t.group, t.seed) for t in many}) == len(many)
    others = NULLS | {"nulls": 5, "null_families": ["stair", "ramp+process:0.1", "white"]}
    assert set(tasks(settings(**NULLS))) <= set(tasks(settings(**others)))
    # Nor do nulls move the cases of other groups.
    plain = settings()
    assert tasks(plain) == [t for t in tasks(replace(plain, nulls=3)) if not t.family]
    assert {t.group for t in tasks(replace(plain, only=("same", "few")))} == {"same", "few"}


def test_a_family_is_an_input_a_noise_or_both() -> None:
    assert [family(n, "short") for n in ("ramp", "pink:0.2", "process:0.1+stair")] == [
        ("short_ramp", ""), ("short", "pink:0.2"), ("short_stair", "process:0.1")
    ]  # fmt: skip
    for wrong, needle in (("ramp+stair", "two inputs"), ("sawtooth", "is no family"), ("pink:2", "between 0 and 1")):
        with pytest.raises(InputRefused, match=needle):
            family(wrong, "full")


def test_conditions_reach_every_case_and_name_another_proof() -> None:
    assert set(settings().changes_cases) == {"seed", "fast_plan", "plan", "starts", "max_effects"}
    asked = {"noise": "process:0.1", "background": True, "hysterons": 3, "anchor_error": True, "wrong_order": True}
    chosen = settings(**asked, only=["same", "pair", "nulls"], nulls=1)
    assert asked.items() <= chosen.changes_cases.items()
    for task in tasks(chosen):
        case = task.case()
        assert case.conditions == chosen.conditions
        assert case.hysterons == 3
        assert task.family or case.family == "process"
    another = settings(base="prandtl_ishlinskii", only=["none", "same"])
    assert another.changes_cases["base"] == "prandtl_ishlinskii"
    assert all("c_play_1" in task.case().base for task in tasks(another)[:3])


@pytest.mark.parametrize(
    ("wrong", "needle"),
    [
        ({"none": -1}, "0 or more"),
        (FEW | {"fast_none": 0, "fast_weak": 0}, "give numbers of cases"),
        (NULLS | {"nulls": 0}, "give numbers of cases"),
        ({"only": ["everything"]}, "no group is called 'everything'"),
        ({"null_families": ["violet"]}, "is no family"),
        ({"noise": "violet"}, "noise = 'violet'"),
        ({"hysterons": 3}, "fast tier fits two hysterons"),
        ({"base": "preisach"}, "base = 'preisach'"),
        ({"base": "bouc_wen"}, "fast tier fits two hysterons"),
        ({"base": "bouc_wen", "only": ["nulls"], "nulls": 1}, "nothing must be missing in nulls"),
        ({"base": "bouc_wen", "only": ["same"], "wrong_order": True}, "no number of hysterons"),
    ],
)
def test_settings_that_make_no_sense_are_refused(wrong: dict[str, Any], needle: str) -> None:
    with pytest.raises(InputRefused, match=needle):
        settings(**wrong)


def test_a_proof_of_three_cases(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[str] = []
    chosen = settings(**FEW)
    cases, digest = proved(chosen, tmp_path, lines.append)
    assert [line.split()[0] for line in lines] == ["sealed"] + ["diagnosed"] * 3
    assert digest in lines[0]
    assert [c.answer.word for c in cases[:2]] == ["none", "none"]
    assert all(c.grade == "exact" for c in cases[:2])
    assert cases[2].row["delta"] > 0.9

    # Nothing is done twice, and one more case does only itself, also after a kill within a line.
    made: list[str] = []
    monkeypatch.setattr(run, "scored", lambda campaign, seed: made.append(campaign) or {"verdict": "none"})
    proved(chosen, tmp_path)
    assert made == []
    log = tmp_path / "log" / "cases.jsonl"
    whole = log.read_bytes()
    log.write_bytes(whole + whole[:50])
    again, other = proved(settings(**FEW | {"fast_none": 3}), tmp_path)
    assert len(made) == 1
    assert other != digest
    assert [again[i].row for i in (0, 1, 3)] == [c.row for c in cases]
    assert log.read_bytes().startswith(whole + b"{")
    assert len(cases_in(log)[0]) == 4

    page = write_proof(cases, chosen, digest, Place(tmp_path))
    assert digest in page
    assert "false alarms" in page
    assert len((tmp_path / "cases.csv").read_text(encoding="utf-8").splitlines()) == 4

    with pytest.raises(InputRefused, match="was made with other settings"):
        proved(settings(**FEW | {"seed": 1}), tmp_path)


def test_a_diagnosis_that_fails_is_an_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(campaign: object, seed: int) -> dict[str, Any]:
        raise PhnnError("no root")

    monkeypatch.setattr(run, "scored", fail)
    cases, _ = proved(settings(**FEW | {"fast_none": 1, "fast_weak": 0}), tmp_path)
    assert (cases[0].grade, cases[0].row["failure"]) == ("wrong", "no root")


@pytest.mark.slow
def test_a_row_has_all_that_its_readers_need(tmp_path: Path) -> None:
    (task,) = tasks(settings(**FEW | {"fast_none": 0, "fast_weak": 0, "same": 1, "plan": "short"}))
    (row,) = run.run([task], tmp_path / "log.jsonl", Options(starts=1), "serial", lambda line: None)
    (own,), failures = cases_in(tmp_path / "log.jsonl")
    assert failures == 0
    assert json.loads(json.dumps(row)) == own.row
    assert own.answer.alternatives
    assert own.answer.word in ("named", "equivalent", "unknown")
    assert all(m.fitted and m.held_out for m in own.models)
    assert set(own.row["errors"]) == {"base", "base_by_noise", "effect", "effect_by_noise"}
    assert len(own.row["held_out"]) == 2
