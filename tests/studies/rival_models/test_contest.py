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
from studies.generator.plans import sine
from studies.rival_models.contest import (
    COUNTS,
    FOLDERS,
    contest,
    one_to_one,
    real_page,
    run,
    scarcity_page,
)
from studies.rival_models.names import register_rivals
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
        ({"drives": 0}, "drives=0"),
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


def script(*arguments: str) -> None:
    done = subprocess.run([sys.executable, "scripts/rivals.py", *arguments], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_a_passive_model_repeats_itself_over_a_long_run(tmp_path: Path) -> None:
    page, out = tmp_path / "page.md", tmp_path / "out"
    page.write_text("<!-- begin long -->\n<!-- end long -->\n")
    small = ["seeds=[1]", "samples=200000", "drives=2", "compare.models=[phs,hammerstein]", "compare.budget=4"]
    script("study=long", f"out={out}", f"page={page}", *small)
    assert "| PHS | 0.1 | 2 | 0 | – | 0 |" in page.read_text()
    assert "| Hammerstein | 0.1 | 2 | 0 | – |" in page.read_text()
    assert len((out / "long.csv").read_text().splitlines()) == 5
