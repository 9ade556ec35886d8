"""The benchmark and the studies of rivals as commands that fill a page."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path
from unittest import mock

import pytest

from studies.benchmark.settings import GROUPS
from studies.benchmark.tools import TOOLS, TRAINED

ROOT = Path(__file__).resolve().parents[3]


def run(script: str, *arguments: str) -> str:
    done = subprocess.run([sys.executable, f"scripts/{script}", *arguments], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--tools", "base", "seed=2"], "nothing is called 'seed=2'"),
        (["--tools", "fingerprints"], "needs --training"),
        (["--tools", "base", "--page", "README.md"], "has no lines <!-- begin bench -->"),
    ],
)
def test_bad_input_is_refused_before_cases_are_made(arguments: list[str], words: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "scripts/bench.py", "--out", str(tmp_path / "out"), *arguments],
        cwd=ROOT, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 2 and words in done.stderr and not (tmp_path / "out").exists()


def test_all_tools_that_need_no_training_answer_by_default(tmp_path: Path) -> None:
    asked: list[str] = []
    script = runpy.run_path(str(ROOT / "scripts" / "bench.py"))
    with mock.patch.dict(script["run"].__globals__, bench=lambda step, out, *_, **__: asked.append(out.name)):
        script["run"](script["arguments"](["--out", str(tmp_path)]))
    assert asked == ["benchmark", *(name for name in TOOLS if name not in TRAINED), "scores"]


@pytest.mark.slow
def test_one_command_makes_answers_scores_and_fills_a_page(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("".join(f"<!-- begin {name} -->\n<!-- end {name} -->\n" for name in ("bench", "fewer")))
    sizes = [f"{group}={int(group in ('none', 'same'))}" for group in GROUPS]
    asked = ["--tools", "harmonics", "base", "--page", str(page), "--executor", "serial", "seed=5"]
    said = run("bench.py", "--out", str(tmp_path / "out"), *asked, *sizes)
    assert "seed 5" in said
    text = page.read_text()
    assert "\n### Wrong answers of harmonics\n" in text
    assert "| cases | 2 | 2 |" in text
    assert (tmp_path / "out" / "scores" / "scores.csv").exists()
    # A second table of fewer cases leaves the first as it is, and answers nothing twice.
    run("bench.py", "--out", str(tmp_path / "out"), *asked, *sizes, "--first", "1", "--table", "fewer")
    assert page.read_text().startswith(text.partition("<!-- begin fewer")[0])
    assert "| cases | 1 | 1 |" in page.read_text().partition("<!-- begin fewer")[2]
    assert (tmp_path / "out" / "fewer" / "scores.csv").exists()


@pytest.mark.slow
def test_no_passive_model_diverges_with_a_compliant_load(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- begin loops -->\n<!-- end loops -->\n")
    models = "compare.models=[phs,hammerstein]"
    run(
        "rivals.py",
        "study=loops",
        f"out={tmp_path / 'out'}",
        f"page={page}",
        "seeds=[1]",
        "runs=3",
        models,
        "compare.budget=4",
    )
    assert "| PHS | 3 | 0 | 0 | 0 |" in page.read_text()


@pytest.mark.slow
def test_one_recording_is_enough_for_a_network_that_is_the_truth(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- begin scarcity -->\n<!-- end scarcity -->\n")
    small = ["seeds=[1]", "compare.models=[phs,linear]", "compare.starts=2", "compare.inputs=2"]
    run("rivals.py", "study=scarcity", f"out={tmp_path / 'out'}", f"page={page}", *small)
    rows = [[cell.strip() for cell in line.split("|")] for line in page.read_text().splitlines()]
    needed = {row[1]: row[-2] for row in rows if len(row) > 3}
    assert needed["PHS"] == "1" and needed["linear"] == "> 7"


@pytest.mark.slow
def test_a_passive_model_repeats_itself_over_a_long_run(tmp_path: Path) -> None:
    page, out = tmp_path / "page.md", tmp_path / "out"
    page.write_text("<!-- begin long -->\n<!-- end long -->\n")
    small = ["seeds=[1]", "samples=200000", "drives=2", "compare.models=[phs,hammerstein]", "compare.budget=4"]
    run("rivals.py", "study=long", f"out={out}", f"page={page}", *small)
    assert "| PHS | 0.1 | 2 | 0 | – | 0 |" in page.read_text()
    assert "| Hammerstein | 0.1 | 2 | 0 | – |" in page.read_text()
    assert len((out / "long.csv").read_text().splitlines()) == 5
