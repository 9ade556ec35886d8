"""A proof decides its cases, seals first, keeps what is finished and notices a broken seal."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from phnn.configuration import compose
from phnn.errors import InputRefused, PhnnError
from phnn.parallel import Executor
from phnn.results import Place
from studies.generator import open_seal
from studies.proof import prove
from studies.proof.cases import STRATA, Settings, family, tasks
from studies.proof.grade import EXACT, Outcome
from studies.proof.page import write_proof

FEW = {"fast_none": 2, "fast_weak": 1, "executor": "serial", "fast_plan": "few"} | dict.fromkeys((*STRATA, "few"), 0)
NULLS = {"only": ["nulls"], "executor": "serial", "null_families": ["white", "ramp+process:0.1"], "nulls": 2}


def settings(**changes: Any) -> Settings:
    return Settings.from_config(compose("prove") | changes)


def proved(chosen: Settings, out: Path, say: prove.Say = lambda line: None) -> tuple[list[Outcome], str]:
    """A proof in a folder that is claimed for it."""
    with prove.claimed(out, chosen) as place:
        return prove.prove(chosen, place, say)


def test_cases_stay_when_their_numbers_and_families_grow() -> None:
    few, many = tasks(settings(**FEW | {"same": 2})), tasks(settings(**FEW | {"same": 5, "other": 1}))
    assert set(few) <= set(many)
    assert len({t.seed for t in many}) == len({t.name for t in many}) == len(many)
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
    said: list[str] = []
    chosen = settings(**FEW)
    outcomes, digest = proved(chosen, tmp_path, said.append)
    order = [line.split()[0] for line in said]
    assert order == ["sealed"] * 4 + ["diagnosed"] * 3
    assert digest in said[3]
    assert [o.verdict for o in outcomes[:2]] == ["none", "none"]
    assert all(o.grade == EXACT for o in outcomes[:2])
    assert outcomes[2].delta > 0.9
    assert not list((tmp_path / "recordings").iterdir())

    # Nothing is done twice, and one more case does only itself.
    made: list[str] = []
    monkeypatch.setattr(prove, "score_folder", lambda folder, seed: made.append(folder.name) or {"verdict": "none"})
    proved(chosen, tmp_path)
    assert made == []
    again, _ = proved(settings(**FEW | {"fast_none": 3}), tmp_path)
    assert made == ["fast_fast_none_0002"]
    assert [repr(o) for o in again[:2]] == [repr(o) for o in outcomes[:2]]

    write_proof(outcomes, chosen, digest, Place(tmp_path))
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert digest in page
    assert "false alarms" in page
    assert len((tmp_path / "cases.csv").read_text(encoding="utf-8").splitlines()) == 4

    with pytest.raises(InputRefused, match="was made with other settings"):
        proved(settings(**FEW | {"seed": 1}), tmp_path)


@pytest.mark.slow
def test_work_that_is_done_twice_counts_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A cluster does again what a worker had finished, but not handed over, when it died.
    class Twice(Executor):
        def each(self, function: Any, items: Any) -> Iterator[tuple[int, Any]]:
            for index, item in enumerate(items):
                function(item)
                if (tmp_path / "twice" / "answers" / f"{item.name}.json").exists():
                    # It died while it removed the recordings.
                    left = tmp_path / "twice" / "recordings" / item.name
                    left.mkdir()
                    (left / "left.csv").touch()
                yield index, function(item)

    def count(folder: Path, seed: int) -> dict[str, Any]:
        return {"verdict": "none", "seconds": len(list(folder.iterdir()))}

    monkeypatch.setattr(prove, "score_folder", count)
    once, seals = proved(settings(**FEW), tmp_path / "once")
    monkeypatch.setattr(prove, "executor", lambda choice: Twice())
    twice, same_seals = proved(settings(**FEW), tmp_path / "twice")
    assert seals == same_seals
    assert [repr(o) for o in twice] == [repr(o) for o in once]
    assert all(not o.failure for o in twice)
    assert not list((tmp_path / "twice" / "recordings").iterdir())


def test_a_seal_broken_during_the_diagnosis_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def cheat(folder: Path, seed: int) -> dict[str, Any]:
        path = tmp_path / "sealed" / f"{folder.name}.json"
        content = json.loads(path.read_text(encoding="utf-8"))
        assert open_seal(path).effects == ()
        path.write_text(json.dumps(content | {"noise": 1.0}), encoding="utf-8")
        return {"verdict": "none"}

    monkeypatch.setattr(prove, "score_folder", cheat)
    with pytest.raises(PhnnError, match="an answer was changed"):
        proved(settings(**FEW | {"fast_none": 1, "fast_weak": 0}), tmp_path)


def test_a_diagnosis_that_fails_is_an_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(folder: Path, seed: int) -> dict[str, Any]:
        raise PhnnError("no root")

    monkeypatch.setattr(prove, "score_folder", fail)
    outcomes, _ = proved(settings(**FEW | {"fast_none": 1, "fast_weak": 0}), tmp_path)
    assert (outcomes[0].grade, outcomes[0].failure, outcomes[0].reason) == ("wrong", "no root", "the diagnosis failed")
