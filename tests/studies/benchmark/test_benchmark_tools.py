"""Tools that answer cases, and the command that runs and scores them."""

from __future__ import annotations

import json
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from phnn.cli import main
from phnn.effects import catalogue
from phnn.errors import InputRefused, SolverFailed
from phnn.recordings.recording import unrecorded
from studies.benchmark import run
from studies.benchmark.answer import Answer
from studies.benchmark.settings import GROUPS
from studies.benchmark.time_limit import limited
from studies.benchmark.tools import TOOLS, TRAINED, tool
from studies.benchmark.tools.harmonics import TABLE, _band
from studies.generator import draw_case, generate, make_case
from studies.generator.effects import LISTED

T = np.arange(4000) / 4000.0
SINE = unrecorded("sine", T, 75.0 * np.sin(2.0 * np.pi * 10.0 * T))


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in TOOLS if name.startswith("phnn_")])
def test_a_diagnosis_without_a_part_answers(name: str, tmp_path: Path) -> None:
    case = draw_case(6, "same", "one_exam", (8.0, 12.0))
    make_case(case, tmp_path / "case")
    # The same recordings serve as the examination.
    shutil.copytree(tmp_path / "case", tmp_path / "copy")
    shutil.move(tmp_path / "copy", tmp_path / "case" / "exam")
    found = tool(name)(tmp_path / "case", 0)
    assert found.claims
    assert sum(found.probabilities.values()) <= 1.0 + 1e-9


def test_every_tool_can_be_had_and_others_are_refused() -> None:
    assert all(callable(tool(name, Path("t") if name in TRAINED else None)) for name in TOOLS)
    with pytest.raises(InputRefused, match=r"nothing is called 'stepwize' .did you mean stepwise\?"):
        tool("stepwize")


def test_the_rule_of_thumb_names_effects_of_the_catalogue() -> None:
    assert set(TABLE.values()) <= set(catalogue())
    assert set(TABLE.values()) <= set(LISTED)


@pytest.mark.parametrize(
    ("band", "residual"),
    [
        ("fundamental", np.sin(2.0 * np.pi * 10.0 * T)),
        ("even", np.cos(2.0 * np.pi * 20.0 * T)),
        ("odd", np.sin(2.0 * np.pi * 30.0 * T)),
        ("fast", np.sin(2.0 * np.pi * 700.0 * T)),
        ("slow", np.sin(2.0 * np.pi * 2.0 * T)),
        ("line", np.sin(2.0 * np.pi * 54.0 * T)),
        ("trend", T - 0.5),
    ],
)
def test_the_band_of_a_residual_is_found_in_noise(band: str, residual: np.ndarray) -> None:
    noise = np.random.default_rng(0).normal(size=T.size)
    assert _band(SINE, noise) == ""
    assert _band(SINE, noise + 5.0 * residual) == band


@pytest.mark.slow
def test_stepwise_selection_finds_a_strong_effect(tmp_path: Path) -> None:
    sealed = generate(7, tmp_path / "case", "quadratic_drag", "short")
    (tmp_path / "case" / "exam").mkdir()
    for file in ("sine_100Hz_75V.csv", "recordings.yaml"):
        content = (tmp_path / "case" / file).read_text()
        if file.endswith("yaml"):
            content = "setup: {model: piezo_actuator, hysterons: 2}\n"
        (tmp_path / "case" / "exam" / file).write_text(content)
    found = tool("stepwise")(tmp_path / "case", 0)
    assert sealed.effects == ("quadratic_drag",)
    assert "quadratic_drag" in found.claims
    assert found.predictions["sine_100Hz_75V"].size == 2500


def test_the_command_answers_and_scores(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cases, answers = tmp_path / "cases", tmp_path / "base"
    nothing = ["none=1", *(f"{group}=0" for group in GROUPS if group != "none")]
    assert main(["bench", "write", "--executor", "serial", "--out", str(cases), *nothing]) == 0
    run = ["bench", "answer", "--cases", str(cases), "--tool", "base", "--out", str(answers), "--executor", "serial"]
    assert main(run) == 0
    assert "base: 1 of 1" in capsys.readouterr().out
    assert main(run) == 0
    assert "1 of 1" not in capsys.readouterr().out
    score = ["bench", "score", "--cases", str(cases), "--answers", str(answers), "--out", str(tmp_path / "s")]
    assert main(score) == 0
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
    assert main(score) == 2
    assert "a case or a seal is not as bench.json" in capsys.readouterr().err


def test_the_first_cases_alone_are_answered_and_scored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cases, answers = tmp_path / "cases", tmp_path / "base"
    nothing = ["none=2", *(f"{group}=0" for group in GROUPS if group != "none")]
    assert main(["bench", "write", "--executor", "serial", "--out", str(cases), *nothing]) == 0
    run = ["bench", "answer", "--cases", str(cases), "--tool", "base", "--out", str(answers), "--executor", "serial"]
    assert main([*run, "--first", "1"]) == 0
    assert "base: 1 of 1, case_000" in capsys.readouterr().out
    score = ["bench", "score", "--cases", str(cases), "--answers", str(answers), "--out", str(tmp_path / "s")]
    assert main([*score, "--first", "1"]) == 0
    assert "| cases | 1 |" in capsys.readouterr().out
    assert main(score) == 2
    assert "case_001" in capsys.readouterr().err


def test_answers_to_another_benchmark_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = [tmp_path / name for name in ("first", "second")]
    for seed, cases in enumerate(folders):
        settings = [f"seed={seed}", "none=1", *(f"{group}=0" for group in GROUPS if group != "none")]
        assert main(["bench", "write", "--executor", "serial", "--out", str(cases), *settings]) == 0
    out = tmp_path / "answers"
    answer = ["bench", "answer", "--tool", "base", "--executor", "serial", "--out", str(out)]
    assert main([*answer, "--cases", str(folders[0])]) == 0
    assert main([*answer, "--cases", str(folders[1])]) == 2
    score = ["bench", "score", "--cases", str(folders[1]), "--answers", str(out), "--out", str(tmp_path / "s")]
    assert main(score) == 2
    assert "answers are to another benchmark" in capsys.readouterr().err
    shutil.rmtree(folders[1] / "sealed")
    assert main(score) == 2
    assert "cannot be scored without all that was written" in capsys.readouterr().err


def test_a_tool_that_cannot_solve_a_case_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(folder: Path, seed: int) -> Answer:
        raise SolverFailed("the step at 0.1 s has no solution")

    nothing = ["none=1", *(f"{group}=0" for group in GROUPS if group != "none")]
    assert main(["bench", "write", "--executor", "serial", "--out", str(tmp_path / "c"), *nothing]) == 0
    monkeypatch.setattr(run, "tool", lambda name, training: fails)
    options = ["--cases", str(tmp_path / "c"), "--tool", "base", "--executor", "serial", "--out", str(tmp_path / "a")]
    assert main(["bench", "answer", *options]) == 0
    assert "no answer, the step at 0.1 s" in capsys.readouterr().out
    (score,) = run.scores_of(tmp_path / "c", tmp_path / "a")
    assert score.failed
    assert not score.right


def test_a_tool_has_no_answer_after_the_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def never_ends(folder: Path, seed: int) -> Answer:
        while True:
            with suppress(Exception):
                np.linalg.svd(np.ones((50, 50)))

    nothing = ["none=1", *(f"{group}=0" for group in GROUPS if group != "none")]
    assert main(["bench", "write", "--executor", "serial", "--out", str(tmp_path / "c"), *nothing]) == 0
    monkeypatch.setattr(run, "tool", lambda name, training: never_ends)
    options = ["--cases", str(tmp_path / "c"), "--tool", "base", "--executor", "serial", "--out", str(tmp_path / "a")]
    assert main(["bench", "answer", *options, "--limit", "0.2"]) == 0
    assert "no answer, stopped after 0.2 processor seconds" in capsys.readouterr().out
    (score,) = run.scores_of(tmp_path / "c", tmp_path / "a")
    assert score.failed
    assert json.loads((tmp_path / "a" / "tool.json").read_text())["limit"] == 0.2
    # With more time the case may have an answer: the same folder does not take both.
    assert main(["bench", "answer", *options, "--limit", "5"]) == 2


def test_a_limit_ends_with_what_it_limits() -> None:
    with limited(0.05):
        pass
    end = time.process_time() + 0.2
    while time.process_time() < end:
        pass


def test_a_thread_cannot_keep_a_limit() -> None:
    def inside() -> None:
        with limited(1.0):
            pass

    with ThreadPoolExecutor(1) as pool, pytest.raises(InputRefused, match="--executor processes"):
        pool.submit(inside).result()


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["score", "--cases", "c", "--answers", "a", "--limit", "3"], "--limit 3: answer alone takes it"),
        (["answer", "--cases", "c", "--tool", "base", "--limit", "0"], "--limit 0: answer alone takes it"),
        (["answer", "--cases", "c", "--tool", "base", "--limit", "1e30"], "--limit 1e+30: answer alone takes it"),
        (["write", "--tool", "phnn"], "phnn bench write does not take --tool"),
        (["answer", "--tool", "phnn"], "phnn bench answer needs --cases"),
        (["answer", "--cases", "c"], "phnn bench answer needs --tool"),
        (["score", "--cases", "c", "--tool", "phnn", "--answers", "a"], "phnn bench score does not take --tool"),
        (["score", "--cases", "c", "--answers", "x/a", "--answers", "y/a"], "called alike, a, a"),
        (["answer", "--cases", "c", "--tool", "base", "seed=3"], "phnn bench answer does not take seed=3"),
        (["write", "--first", "3"], "--first 3: answer and score take"),
        (["score", "--cases", "c", "--answers", "a", "--first", "0"], "--first 0: answer and score take"),
        (["answer", "--cases", "c", "--tool", "bse"], "did you mean base?"),
        (["answer", "--cases", "c", "--tool", "nearest"], "tool nearest needs --training: give the folder that"),
        (["answer", "--cases", "c", "--tool", "base", "--training", "t"], "tool base takes no --training"),
        (["train", "--training", "t"], "phnn bench train does not take --training"),
        (["train", "--tool", "base"], "phnn bench train does not take --tool"),
        (["train", "none=3"], "phnn bench train does not take none=3: settings are those of write"),
        (["write", "size=30"], "phnn bench write does not take size=30: settings are those of train"),
        (["train", "size=3"], "size"),
        (["write", "none=0", *(f"{g}=0" for g in GROUPS if g != "none")], "no cases"),
    ],
)
def test_wrong_usage_is_refused(
    argv: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", *argv, "--out", str(tmp_path / "o")]) == 2
    assert words in capsys.readouterr().err
