"""The studies of rivals: what they make, write and conclude."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from phnn.comparison import models
from phnn.comparison.models import Settings
from phnn.configuration import compose
from phnn.errors import InputRefused
from phnn.recordings import read
from phnn.results import Place
from studies.comparison.rivals import register_rivals
from studies.generator.plans import sine
from studies.rival_models.contest import (
    COUNTS,
    FOLDERS,
    contest,
    held_out,
    one_to_one,
    real,
    real_page,
    run,
    scarcity_page,
    truths_page,
)
from studies.rival_models.names import NAMES
from studies.rival_models.truths import TRUTHS, write_truth

ROOT = Path(__file__).resolve().parents[3]
PLAN = ({"sine_050Hz_75V": "identification", "sine_020Hz_40V": "confirmation"}, (sine(50.0), sine(20.0, 40.0)))
QUICK = ("starts=1", "workers=1", "budget=1.5")


@pytest.fixture(autouse=True)
def _registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(models, "_RIVALS", {})
    register_rivals()


def settings(*overrides: str) -> Settings:
    return Settings.from_config(compose("compare", [*QUICK, *overrides]))


@pytest.mark.parametrize("truth", TRUTHS)
def test_a_truth_is_drawn_by_its_seed(truth: str, tmp_path: Path) -> None:
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        write_truth(tmp_path / name, truth, seed, PLAN, 0.05)
    a, b, c = (read(tmp_path / name).recordings for name in "abc")
    assert np.array_equal(a[0].y, b[0].y)
    assert np.ptp(a[0].y - c[0].y) > 1e-7
    assert 5e-6 < 0.5 * np.ptp(a[0].y) < 500e-6
    # The loop is open, at 20 Hz far below the resonance: its area is many times what noise does to it.
    slow = next(r for r in a if "020Hz" in r.name)
    part = slow.last_periods(1.0)
    area = abs(float(np.sum(slow.u[part][1:] * np.diff(slow.y[part]))))
    noise = slow.noise * float(np.linalg.norm(np.diff(slow.u[part])))  # by parts; the input is zero at both ends
    assert area > 10.0 * noise


def test_an_unknown_truth_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match="jiles_atherton"):
        write_truth(tmp_path / "x", "jiles_atherton", 0, PLAN, 0.05)


def test_the_study_of_truths_writes_its_table(tmp_path: Path) -> None:
    chosen = settings("models=[hammerstein,dahl]")
    rows = contest("truths", Place(tmp_path), chosen, ["prandtl_ishlinskii"], [4], 0.05)
    assert list(rows["model"]) == ["dahl", "hammerstein"]
    with (tmp_path / "truths.csv").open() as file:
        written = list(csv.DictReader(file))
    assert {(r["truth"], r["seed"], r["budget"]) for r in written} == {("prandtl_ishlinskii", "4", "1.5")}
    assert float(written[0]["confirmation"]) == pytest.approx(rows["confirmation"][0])
    text = (tmp_path / "truths.md").read_text()
    assert "seeds 4" in text and "1.5 processor seconds" in text and "Hammerstein" in text


def row(model: str, count: int, inside: float, outside: float, seed: int = 0) -> dict[str, Any]:
    scores = {"identification": 1.0, "confirmation": inside, "outside": outside, "processor_seconds": 1.0}
    return {"truth": "phs", "seed": seed, "recordings": count, "model": model} | scores


def test_recordings_needed_are_the_fewest_from_which_on_all_stay_near_the_noise() -> None:
    rows = [row("phs", c, v, v) for c, v in zip(COUNTS, (9.0, 1.1, 1.0, 1.0), strict=True)]
    rows += [row("narx", c, v, v) for c, v in zip(COUNTS, (1.1, 3.0, 1.1, 2.0), strict=True)]
    lines = scarcity_page(pd.DataFrame(rows), settings("models=[phs]"), "").splitlines()
    assert next(x for x in lines if x.startswith("| PHS")).endswith("| 2 |")
    assert next(x for x in lines if x.startswith("| NARX")).endswith("| > 7 |")


def test_scores_held_out_are_medians_over_seeds() -> None:
    rows = [row("phs", 4, 3.0, 4.0, seed) for seed in (0, 1)] + [row("phs", 4, float("nan"), 100.0, 2)]
    assert held_out(pd.DataFrame(rows)) == pytest.approx(np.sqrt(12.5))
    assert held_out(pd.DataFrame([row("phs", 1, float("nan"), float("nan"))])) == float("inf")
    lost = truths_page(pd.DataFrame([row("narx", 4, 2.0, float("inf"))]), settings("models=[phs]"), "")
    assert "| phs | held out, outside | diverged |" in lost
    lines = truths_page(pd.DataFrame(rows), settings("models=[phs]"), "").splitlines()
    assert "| phs | processor seconds | 1.00 |" in lines
    assert "| phs | held out, inside | 3.00 |" in lines and "| phs | held out, outside | 4.00 |" in lines


def test_the_ratio_is_best_of_phnn_over_best_rival() -> None:
    nan = float("nan")
    columns = ["recordings", "model", "held_out", "identified", "processor_seconds", "budget", "why_not"]
    rows = [
        ("tanks", "base", 6.0, 5.0, 1.0, nan, ""), ("tanks", "diagnosed", 2.0, 2.0, 1.0, nan, ""),
        ("tanks", "narx", 4.0, 4.0, 1.0, 2.0, ""), ("tanks", "gru", nan, nan, 1.0, 2.0, "no time"),
    ]  # fmt: skip
    text = real_page(pd.DataFrame(rows, columns=columns), settings("models=[phs]"))
    line = next(x for x in text.splitlines() if x.startswith("| tanks"))
    assert line.endswith("| NARX | 0.50 |")
    assert "tanks, gru: no time" in text
    assert "A diagnosis took 1 to 1 processor seconds, and each rival had as many" in text


@pytest.mark.parametrize(
    ("change", "needle"),
    [
        ({"study": "beauty"}, "beauty"), ({"study": "real"}, "folder"), ({"seeds": []}, "seeds"),
        ({"study": "real", "folder": "nowhere"}, "nowhere"),
        ({"study": "real", "folder": "x", "only": ["moon"]}, "moon"),
        ({"study": "real", "folder": "x", "only": "moon"}, "moon"),
        ({"study": "real", "folder": "x", "diagnoses": "no"}, "neither true nor false"),
        ({"noise_um": "x"}, "noise_um=x"), ({"noise_um": -1}, "noise_um=-1"), ({"seeds": [-1]}, "seeds=-1"),
        ({"seeds": "x"}, "seeds=x"), ({"study": "loops", "runs": "x"}, "runs=x"), ({"samples": 0.5}, "samples=0.5"),
    ],
)  # fmt: skip
def test_studies_refuse_what_they_cannot_use(change: dict[str, object], needle: str, tmp_path: Path) -> None:
    config = {
        "study": "truths", "out": str(tmp_path / "out"), "truths": ["phs"], "seeds": [0], "noise_um": 0.05,
        "folder": None, "only": [], "diagnoses": False,
        "runs": 2, "samples": 20000, "drives": 1, "compare": compose("compare", QUICK),
    }  # fmt: skip
    with pytest.raises(InputRefused, match=needle):
        run({**config, **change})


def test_names_of_rivals_are_models_of_a_comparison() -> None:
    assert settings("models=all").models[-len(NAMES) :] == NAMES
    assert settings("models=[gru]").of("gru") == {"seed": 0, "budget": 1.5}
    with pytest.raises(InputRefused, match="budget"):
        settings("budget=0")


def test_public_recordings_are_read_with_one_input_and_one_output() -> None:
    home = Path(os.environ.get("PHNN_RECORDINGS", Path(__file__).parents[4] / "shared" / "recordings"))
    there = [n for n in FOLDERS if (home / n).is_dir()]
    if not there:
        pytest.skip(f"{home}: no public recordings")
    for name in there:
        campaign = one_to_one(home / name, name)
        assert not any(r.further or r.measures for r in campaign.recordings)
        uses = {p.use for r in campaign.recordings for p in r.parts}
        assert {"identification", "confirmation"} <= uses


@pytest.mark.slow
def test_rivals_and_the_base_model_on_the_tanks(tmp_path: Path) -> None:
    home = Path(os.environ.get("PHNN_RECORDINGS", Path(__file__).parents[4] / "shared" / "recordings"))
    if not (home / "tanks").is_dir():
        pytest.skip(f"{home / 'tanks'}: is not there")
    rows = real(Place(tmp_path), settings("models=[hammerstein,narx]"), home, ["tanks"], False)
    assert list(rows["model"]) == ["base", "hammerstein", "narx"]
    assert np.isfinite(rows["held_out"]).all()
    assert (tmp_path / "real.md").read_text().count("| tanks") == 1


def script(*arguments: str) -> None:
    done = subprocess.run([sys.executable, "scripts/rivals.py", *arguments], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_no_passive_model_diverges_with_a_compliant_load(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- begin loops -->\n<!-- end loops -->\n")
    models = "compare.models=[phs,hammerstein]"
    script("study=loops", f"out={tmp_path / 'out'}", f"page={page}", "seeds=[1]", "runs=3", models, "compare.budget=4")
    assert "| PHS | 3 | 0 | 0 | 0 |" in page.read_text()


@pytest.mark.slow
def test_one_recording_is_enough_for_a_network_that_is_the_truth(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- begin scarcity -->\n<!-- end scarcity -->\n")
    small = ["seeds=[1]", "compare.models=[phs,linear]", "compare.starts=2"]
    script("study=scarcity", f"out={tmp_path / 'out'}", f"page={page}", *small)
    rows = [[cell.strip() for cell in line.split("|")] for line in page.read_text().splitlines()]
    needed = {row[1]: row[-2] for row in rows if len(row) > 3}
    assert needed["PHS"] == "1" and needed["linear"] == "> 7"


@pytest.mark.slow
def test_a_passive_model_repeats_itself_over_a_long_run(tmp_path: Path) -> None:
    page, out = tmp_path / "page.md", tmp_path / "out"
    page.write_text("<!-- begin long -->\n<!-- end long -->\n")
    small = ["seeds=[1]", "samples=200000", "drives=2", "compare.models=[phs,hammerstein]", "compare.budget=4"]
    script("study=long", f"out={out}", f"page={page}", *small)
    assert "| PHS | 0.1 | 2 | 0 | – | 0 |" in page.read_text()
    assert "| Hammerstein | 0.1 | 2 | 0 | – |" in page.read_text()
    assert len((out / "long.csv").read_text().splitlines()) == 5
