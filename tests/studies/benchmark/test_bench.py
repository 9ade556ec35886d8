"""Cases of a benchmark: what is drawn, what a tool sees, what is sealed, and the script that makes and scores them."""

from __future__ import annotations

import json
import runpy
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phnn.errors import SolverFailed
from phnn.recordings import read
from studies.benchmark import bench
from studies.benchmark.bench import GROUPS, NOISES, PLANS, STRENGTHS, Answer, Entry, Settings, card_of, entries, opened
from studies.benchmark.score import scores_of

SMALL = {"none": 9, "same": 9, "other": 4, "outside": 4, "pair": 4, "background": 4}
ROOT = Path(__file__).resolve().parents[3]
# The script as a function that returns its exit status.
_MAIN: Callable[[list[str]], None] = runpy.run_path(str(ROOT / "scripts" / "bench.py"))["main"]
NOTHING = ["none=2", *(f"{group}=0" for group in GROUPS if group != "none")]


def main(*words: object) -> int:
    try:
        _MAIN([str(word) for word in words])
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


def written(out: Path, none: int = 1, seed: int = 1) -> Path:
    """A benchmark of cases with nothing concealed."""
    nothing = [f"none={none}", *NOTHING[1:]]
    assert main("write", "--executor", "serial", "--out", out, f"seed={seed}", *nothing) == 0
    return out


def test_names_and_order_do_not_tell_the_group() -> None:
    found = entries(Settings(seed=3, **SMALL))
    assert [e.name for e in found] == [f"case_{i:03d}" for i in range(len(found))]
    assert Counter(e.group for e in found) == SMALL
    groups = [e.group for e in found]
    # As many neighbours are alike as chance gives, not nearly all.
    assert sum(a == b for a, b in pairwise(groups)) < len(groups) // 2
    assert not {e.seed for e in found} & {e.seed for e in entries(Settings(seed=4, **SMALL))}


def test_strengths_plans_and_noises_take_turns() -> None:
    found = entries(Settings(**SMALL))
    same = [e for e in found if e.group == "same"]
    assert {(e.strength, e.plan) for e in same} == {(s, p) for s in STRENGTHS for p in PLANS}
    assert {e.noise for e in found if e.group == "none"} == set(NOISES)
    # With another seed an effect is met in another strength or plan.
    orders = [[(e.strength, e.plan) for e in sorted(of, key=lambda e: e.seed)] for of in (same, others("same", 2))]
    assert orders[0] != orders[1]


def others(group: str, seed: int) -> list[Entry]:
    return [e for e in entries(Settings(seed=seed, **SMALL)) if e.group == group]


@pytest.mark.parametrize("group", GROUPS)
def test_a_case_is_what_its_group_says(group: str) -> None:
    (entry,) = entries(Settings(**{g: int(g == group) for g in GROUPS}))
    case = entry.case()
    assert len(case.effects) == {"none": 0, "pair": 2}.get(group, 1)
    assert case.conditions.background is (group == "background")
    assert case.withheld == ()
    assert case.form == ("unlisted" if group == "outside" else case.form)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("bench") / "b"
    return written(out, 2)


def test_a_tool_sees_inputs_of_the_examination_alone(folder: Path) -> None:
    for name in card_of(folder)["cases"]:
        home = folder / "cases" / name
        known, exam = read(home), read(home / "exam", need_output=False)
        assert all(np.isfinite(r.y).all() for r in known.recordings)
        assert all(np.isnan(r.y).all() for r in exam.recordings)
        assert not {r.name for r in known.recordings} & {r.name for r in exam.recordings}
        assert known.known == exam.known
        _, sealed, tables = opened(folder, name)
        assert sealed.effects == ()
        assert set(tables) == {r.name for r in exam.recordings}
        for r in exam.recordings:
            np.testing.assert_allclose(tables[r.name]["voltage_V"], r.u)
            assert "displacement_um" in tables[r.name]


def test_what_was_made_is_not_made_again(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {p: p.stat().st_mtime_ns for p in (folder / "sealed").rglob("*")}
    written(folder, 2)
    assert before == {p: p.stat().st_mtime_ns for p in (folder / "sealed").rglob("*")}
    assert card_of(folder)["sha256"] in capsys.readouterr().out
    # Other settings are other cases; the seed is told to no tool.
    assert main("write", "--executor", "serial", "--out", folder, "none=3", *NOTHING[1:]) == 2
    assert len(card_of(folder)["cases"]) == 2
    assert "settings" not in card_of(folder)


def answered(cases: Path, out: Path, *more: object) -> int:
    return main("answer", "--cases", cases, "--tool", "base", "--executor", "serial", "--out", out, *more)


def test_the_script_answers_and_scores(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cases, answers = written(tmp_path / "cases"), tmp_path / "base"
    assert answered(cases, answers) == 0
    assert "base: 1 of 1" in capsys.readouterr().out
    assert answered(cases, answers) == 0
    assert "1 of 1" not in capsys.readouterr().out
    score = ("score", "--cases", cases, "--answers", answers, "--out", tmp_path / "s")
    assert main(*score) == 0
    page = capsys.readouterr().out
    assert "| balanced accuracy of claims | 1.00 |" in page
    assert page.split("results: ")[0] == (tmp_path / "s" / "leaderboard.md").read_text()
    answer = next((answers / "answers").rglob("answer.json"))
    content = json.loads(answer.read_text())
    assert content["none"] == 1.0
    assert content["seconds"] > 0.0
    # A seal that was changed is noticed.
    seal = next((cases / "sealed").rglob("seal.json"))
    seal.write_text(seal.read_text().replace('"effect": "none"', '"effect": "creep"'))
    assert main(*score) == 2
    assert "a case or a seal is not as bench.json" in capsys.readouterr().err


def fails(case: Path, seed: int) -> Answer:
    raise SolverFailed("the step at 0.1 s has no solution")


def never_ends(case: Path, seed: int) -> Answer:
    while True:
        with suppress(Exception):
            np.linalg.svd(np.ones((50, 50)))


@pytest.mark.parametrize(
    ("tool", "words"), [(fails, "the step at 0.1 s"), (never_ends, "stopped after 0.2 processor seconds")]
)
def test_a_tool_that_cannot_solve_a_case_or_takes_too_long_has_no_answer(
    tool: Any, words: str, folder: Path, tmp_path: Path, monkeypatch: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bench, "tool", lambda name: tool)
    assert answered(folder, tmp_path / "a", "--first", 1, "--limit", 0.2) == 0
    assert f"no answer, {words}" in capsys.readouterr().out
    (score,) = scores_of(folder, tmp_path / "a", 1)
    assert score.failed and not score.right
    assert json.loads((tmp_path / "a" / "tool.json").read_text())["limit"] == 0.2
    # With more time the case may have an answer: the same folder does not take both.
    assert answered(folder, tmp_path / "a", "--first", 1, "--limit", 5) == 2


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["score", "--cases", "c", "--answers", "a", "--limit", "3"], "unrecognized arguments: --limit 3"),
        (["answer", "--cases", "c", "--tool", "base", "--limit", "0"], "--limit 0: give processor seconds above 0"),
        (["score", "--cases", "c", "--answers", "x/a", "--answers", "y/a"], "called alike, a, a"),
        (["score", "--cases", "c", "--answers", "a", "--first", "0"], "--first 0: give a number of cases"),
        (["answer", "--cases", "c", "--tool", "bse"], "did you mean base?"),
        (["write", "nane=3"], "unknown setting 'nane=3' (did you mean none?)"),
        (["write", "none=-3"], "setting none=-3: give a whole number"),
        (["write", "none=0", *NOTHING[1:]], "no cases"),
        (["all", "--tools", "base", "--page", str(ROOT / "README.md")], "has no lines <!-- begin bench -->"),
    ],
)
def test_wrong_usage_is_refused_before_anything_is_made(
    argv: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(*argv, "--out", tmp_path / "o") == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


@pytest.mark.slow
def test_one_command_makes_answers_scores_and_fills_a_page(tmp_path: Path) -> None:
    page, out = tmp_path / "page.md", tmp_path / "out"
    page.write_text("".join(f"<!-- begin {name} -->\n<!-- end {name} -->\n" for name in ("bench", "fewer")))
    sizes = [f"{group}={int(group in ('none', 'same'))}" for group in GROUPS]
    asked = ["seed=5", *sizes, "--out", str(out), "--page", str(page), "--executor", "serial"]
    asked += ["--tools", "phnn_scores_only", "base"]

    def run(*more: str) -> str:
        words = [sys.executable, "scripts/bench.py", "all", *asked, *more]
        done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert "seed 5" in run()
    text = page.read_text()
    assert "\n### Wrong answers of phnn_scores_only\n" in text
    assert "| cases | 2 | 2 |" in text
    assert (out / "scores" / "scores.csv").exists()
    # A second table of fewer cases leaves the first as it is, and answers nothing twice.
    run("--first", "1", "--table", "fewer")
    assert page.read_text().startswith(text.partition("<!-- begin fewer")[0])
    assert "| cases | 1 | 1 |" in page.read_text().partition("<!-- begin fewer")[2]
    assert (out / "fewer" / "scores.csv").exists()
