"""Nulls by family: which cases they are, and how their answers are counted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from phnn.configuration import compose
from phnn.errors import InputRefused, PhnnError
from phnn.results import Place
from studies.proof import run
from studies.proof.cases import tasks
from studies.proof.families import family
from studies.proof.nulls import counts
from studies.proof.outcome import Outcome
from studies.proof.page import write_proof
from studies.proof.settings import Settings
from studies.proof.tally import rates


def settings(**changes: Any) -> Settings:
    few = {"only": ["nulls"], "executor": "serial", "null_families": ["white", "ramp+process:0.1"], "nulls": 2}
    return Settings.from_config(compose("prove") | few | changes)


def proved(chosen: Settings, out: Path, say: run.Say) -> tuple[list[Outcome], str]:
    """A proof in a folder that is claimed for it."""
    with run.claimed(out, chosen) as place:
        return run.prove(chosen, place, say)


def test_a_family_is_an_input_a_noise_or_both() -> None:
    found = [family(n, "short") for n in ("ramp", "pink:0.2", "process:0.1+stair")]
    assert [(f.plan, f.noise) for f in found] == [
        ("short_ramp", ""), ("short", "pink:0.2"), ("short_stair", "process:0.1")
    ]  # fmt: skip
    for wrong, needle in (("ramp+stair", "two inputs"), ("sawtooth", "is no family"), ("pink:2", "between 0 and 1")):
        with pytest.raises(InputRefused, match=needle):
            family(wrong, "full")


def test_every_family_of_the_settings_can_be_made() -> None:
    default = Settings.from_config(compose("prove") | {"nulls": 2, "only": ["nulls"]})
    todo = tasks(default)
    assert len(todo) == 2 * len(default.null_families) == 28
    assert len({t.seed for t in todo}) == len({t.name for t in todo}) == len(todo)
    for task in todo:
        case = task.case()
        assert case.effects == ()
        assert len(case.recordings) == 4
        if task.noise:
            assert task.noise.startswith(case.family)


def test_nulls_stay_the_same_when_families_and_numbers_grow() -> None:
    few, many = tasks(settings()), tasks(settings(nulls=5, null_families=["stair", "ramp+process:0.1", "white"]))
    assert set(few) <= set(many)
    # Nor do they move the cases of other groups.
    plain = Settings.from_config(compose("prove"))
    assert tasks(plain) == [t for t in tasks(replace(plain, nulls=3)) if not t.family]
    assert {t.group for t in tasks(replace(plain, only=("same", "few")))} == {"same", "few"}


@pytest.mark.parametrize(
    ("wrong", "needle"),
    [
        ({"only": ["everything"]}, "no group is called 'everything'"),
        ({"null_families": ["violet"]}, "is no family"),
        ({"nulls": 0}, "give numbers of cases"),
    ],
)
def test_settings_that_make_no_sense_are_refused(wrong: dict[str, Any], needle: str) -> None:
    with pytest.raises(InputRefused, match=needle):
        settings(**wrong)


@pytest.mark.slow
def test_answers_are_counted_by_family(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answers = iter(
        [
            {"verdict": "none", "seconds": 7.0},
            {"verdict": "named", "missing": [{"effect": "second_mode", "location": "mechanical"}], "seconds": 9.0},
            {"verdict": "unknown", "missing": [{"effect": "unknown", "location": "amplifier"}], "seconds": 30.0},
            PhnnError("no root"),
        ]
    )
    asked: list[tuple[str, dict[str, Any]]] = []

    def answer(folder: Path, out: Path, without: Any, options: dict[str, Any], keep: bool) -> dict[str, Any]:
        asked.append((folder.name, options))
        said = next(answers)
        if isinstance(said, PhnnError):
            raise said
        return said

    monkeypatch.setattr(run, "diagnose_folder", answer)
    chosen = settings(null_plan="short")
    outcomes, digest = proved(chosen, tmp_path, lambda line: None)
    assert [name for name, _ in asked] == [
        "full_nulls_white_0000", "full_nulls_white_0001",
        "full_nulls_ramp+process-0.1_0000", "full_nulls_ramp+process-0.1_0001",
    ]  # fmt: skip
    assert all(options["max_effects"] == 3 for _, options in asked)
    white, ramp = counts(outcomes)
    assert (white.family, white.cases, white.right, white.named, white.unknown, white.failed) == (
        "white",
        2,
        1,
        1,
        0,
        0,
    )
    assert (white.false, white.seconds) == ("second_mode (1)", 8.0)
    assert (ramp.right, ramp.named, ramp.unknown, ramp.failed, ramp.seconds) == (0, 0, 1, 1, 30.0)
    everything = {r.label: r for r in rates(outcomes)}
    assert everything["nothing missing: false alarms, nulls of all families"].hits == 3
    assert everything["nothing missing: false alarms, whole command"].cases == 0
    write_proof(outcomes, chosen, digest, Place(tmp_path))
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Nulls by family" in page
    assert "second_mode (1)" in page
    assert (tmp_path / "nulls.csv").read_text(encoding="utf-8").splitlines()[1].startswith("white,2,1,1,0,0,")
    # What is finished is not repeated, and another plan is another proof.
    again, _ = proved(chosen, tmp_path, lambda line: None)
    assert [repr(o) for o in again] == [repr(o) for o in outcomes]
    with pytest.raises(InputRefused, match="was made with other settings"):
        proved(settings(null_plan="full"), tmp_path, lambda line: None)
