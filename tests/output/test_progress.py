"""What a run is doing, on disk: written while it goes on, gone at its end, never in the way of the run."""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path

import pytest

from phnn.errors import InputRefused, OutputFailed, SolverFailed
from phnn.output import PROGRESS, Place, claim, watched


def steps(folder: Path) -> list[str]:
    return [s["text"] for s in json.loads((folder / PROGRESS).read_text())["steps"]]


def quiet(text: str) -> None:
    pass


def test_steps_are_on_disk_while_a_run_goes_on_and_gone_at_its_end(tmp_path: Path) -> None:
    out = tmp_path / "o"
    with claim(out, "identify", results=("identify.json", PROGRESS)) as place:
        with watched(place, "identify", quiet) as progress:
            progress("read")
            progress("fit")
            content = json.loads((out / PROGRESS).read_text())
            assert (content["schema"], content["command"], steps(out)) == (
                "phnn.progress/1",
                "identify",
                ["read", "fit"],
            )
            assert datetime.fromisoformat(content["began"]) <= datetime.fromisoformat(content["steps"][1]["at"])
        assert not (out / PROGRESS).exists()
        (place / "identify.json").write_json({})
    assert {p.name for p in out.iterdir()} == {".phnn", "identify.json"}


def test_a_run_that_failed_says_where_it_stopped_and_the_next_one_begins_anew(tmp_path: Path) -> None:
    out = tmp_path / "o"
    with pytest.raises(SolverFailed), claim(out, "identify") as place, watched(place, "identify", quiet) as progress:
        progress("fit")
        raise SolverFailed("no solution")
    assert steps(out) == ["fit"]
    with claim(out, "identify", results=(PROGRESS,)) as place, watched(place, "identify", quiet) as progress:
        progress("again")
        assert steps(out) == ["again"]
    assert not (out / PROGRESS).exists()


def test_a_refused_run_leaves_nothing(tmp_path: Path) -> None:
    out = tmp_path / "o"
    with pytest.raises(InputRefused), claim(out, "identify") as place, watched(place, "identify", quiet) as progress:
        progress("look")
        raise InputRefused("no")
    assert not out.exists()


def test_of_many_steps_the_last_ones_are_kept(tmp_path: Path) -> None:
    with watched(Place(tmp_path), "diagnose", quiet) as progress:
        for number in range(203):
            progress(str(number))
        assert steps(tmp_path) == [str(number) for number in range(3, 203)]


def test_a_full_disk_stops_no_run_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OutputFailed("the disk is full")

    monkeypatch.setattr(Place, "write_json", full)
    said: list[str] = []
    with watched(Place(tmp_path), "diagnose", said.append) as progress:
        progress("fit")
    assert said == ["fit"]


def test_a_file_of_somebody_else_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / PROGRESS).write_text("mine")
    with watched(Place(tmp_path), "diagnose", quiet) as progress:
        progress("fit")
    assert (tmp_path / PROGRESS).read_text() == "mine"
