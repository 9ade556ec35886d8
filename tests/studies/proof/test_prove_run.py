"""A proof seals first, keeps what is finished and notices a broken seal."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from phnn.configuration import compose
from phnn.errors import InputRefused, PhnnError
from phnn.parallel import Executor
from phnn.results import Place
from studies.generator import open_seal
from studies.proof import run
from studies.proof.cases import tasks
from studies.proof.grades import EXACT
from studies.proof.outcome import Outcome
from studies.proof.page import write_proof
from studies.proof.settings import STRATA, Settings


def settings(**changes: Any) -> Settings:
    few = {"fast_none": 2, "fast_weak": 1, "executor": "serial", "fast_plan": "few"} | dict.fromkeys(
        (*STRATA, "few"), 0
    )
    return Settings.from_config(compose("prove") | few | changes)


def proved(chosen: Settings, out: Path, say: run.Say) -> tuple[list[Outcome], str]:
    """A proof in a folder that is claimed for it."""
    with run.claimed(out, chosen) as place:
        return run.prove(chosen, place, say)


def test_cases_of_a_group_stay_when_its_number_grows() -> None:
    few, many = tasks(settings(same=2)), tasks(settings(same=5, other=1))
    assert {t.name for t in few} <= {t.name for t in many}
    assert {(t.name, t.seed) for t in few} <= {(t.name, t.seed) for t in many}
    assert len({t.seed for t in many}) == len(many)


@pytest.mark.parametrize("wrong", [{"none": -1}, dict.fromkeys(("fast_none", "fast_weak"), 0)])
def test_numbers_of_cases_that_make_no_sense_are_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(InputRefused, match=r"give numbers of cases|0 or more"):
        settings(**wrong)


def test_a_proof_of_three_cases(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    outcomes, digest = proved(settings(), tmp_path, said.append)
    order = [line.split()[0] for line in said]
    assert order == ["sealed"] * 4 + ["diagnosed"] * 3
    assert digest in said[3]
    assert [o.verdict for o in outcomes[:2]] == ["none", "none"]
    assert all(o.grade == EXACT for o in outcomes[:2])
    assert outcomes[2].delta > 0.9
    assert not list((tmp_path / "recordings").iterdir())

    # Nothing is done twice, and one more case does only itself.
    made: list[str] = []
    monkeypatch.setattr(run, "score_folder", lambda folder, seed: made.append(folder.name) or {"verdict": "none"})
    proved(settings(), tmp_path, said.append)
    assert made == []
    again, _ = proved(settings(fast_none=3), tmp_path, said.append)
    assert made == ["fast_fast_none_0002"]
    assert [repr(o) for o in again[:2]] == [repr(o) for o in outcomes[:2]]

    write_proof(outcomes, settings(), digest, Place(tmp_path))
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert digest in page
    assert "false alarms" in page
    assert len((tmp_path / "cases.csv").read_text(encoding="utf-8").splitlines()) == 4

    with pytest.raises(InputRefused, match="was made with other settings"):
        proved(settings(seed=1), tmp_path, said.append)


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

    monkeypatch.setattr(
        run, "score_folder", lambda folder, seed: {"verdict": "none", "seconds": len(list(folder.iterdir()))}
    )
    once, seals = proved(settings(), tmp_path / "once", lambda line: None)
    monkeypatch.setattr(run, "executor", lambda choice: Twice())
    twice, same_seals = proved(settings(), tmp_path / "twice", lambda line: None)
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

    monkeypatch.setattr(run, "score_folder", cheat)
    with pytest.raises(PhnnError, match="an answer was changed"):
        proved(settings(fast_none=1, fast_weak=0), tmp_path, lambda line: None)


def test_a_diagnosis_that_fails_is_an_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(folder: Path, seed: int) -> dict[str, Any]:
        raise PhnnError("no root")

    monkeypatch.setattr(run, "score_folder", fail)
    outcomes, _ = proved(settings(fast_none=1, fast_weak=0), tmp_path, lambda line: None)
    assert (outcomes[0].grade, outcomes[0].failure, outcomes[0].reason) == ("wrong", "no root", "the diagnosis failed")
