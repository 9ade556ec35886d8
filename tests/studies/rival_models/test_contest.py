"""The studies of rivals: what they make and conclude; models in a closed loop and free over many samples."""

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
from scipy.linalg import expm

from phnn.comparison import models
from phnn.comparison.models import Settings
from phnn.configuration import compose
from phnn.errors import InputRefused, OutputFailed, SolverFailed
from phnn.model import Model
from phnn.models.actuator import hrc
from phnn.recordings import read
from phnn.results import Place
from phnn.setup import Setup
from studies.generator.plans import sine
from studies.rival_models.contest import COUNTS, FOLDERS, contest, one_to_one, real_page, run, scarcity_page
from studies.rival_models.names import register_rivals
from studies.rival_models.rival import State, Stepper
from studies.rival_models.runs import (
    DRIFTED,
    CompiledStepper,
    Drive,
    Loop,
    closed,
    closed_path,
    drawn_drive,
    drawn_loops,
    long,
    long_run,
)
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


DT, M, K, ALPHA = 1e-4, 1e-3, 5e4, 5.0


class Oscillator(Stepper):
    """``m q̈ + b q̇ + k q = α u`` with ``u`` straight between samples, exactly."""

    def __init__(self, b: float) -> None:
        self.dt = DT
        a = np.zeros((4, 4))
        a[0, 1], a[1, :3], a[2, 3] = 1.0, [-K / M, -b / M, ALPHA / M], 1.0 / DT
        self._next = expm(a * DT)[:2]

    def rest(self, u: float) -> State:
        return np.array([ALPHA * u / K, 0.0, u])

    def step(self, state: State, u: float) -> tuple[State, float]:
        x = self._next @ np.append(state, u - state[2])
        return np.append(x, u), float(x[0])


def test_a_loop_with_a_spring_is_a_stiffer_oscillator_once_it_rests() -> None:
    run = Loop(np.full(20_000, 40.0), 0.0, 2.0 * K / ALPHA)
    y, solved = closed_path(Oscillator(2.0), run, 1.0)
    assert solved
    assert y[-1] == pytest.approx(ALPHA * 40.0 / (3.0 * K), rel=1e-6)


def test_a_model_that_gives_energy_is_found_out() -> None:
    gain = ALPHA / K
    runs = drawn_loops(5, (0.4, DT), 75.0, 150.0, K / ALPHA, 3)
    assert closed(Oscillator(2.0), runs, gain).diverged == 0
    assert closed(Oscillator(2.0), runs, gain).gained == 0
    # Negative damping: some runs leave the range, slower ones only grow.
    assert closed(Oscillator(-2.0), runs, gain).diverged == 5
    slow = closed(Oscillator(-0.01), [Loop(r.v, r.before, 0.0) for r in runs], gain)
    assert slow.diverged + slow.gained == 5


def test_runs_end_without_drive_and_follow_the_seed() -> None:
    first, again, other = (drawn_loops(2, (0.1, DT), 75.0, 150.0, K / ALPHA, s) for s in (1, 1, 2))
    assert all(np.array_equal(a.v, b.v) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0].v, other[0].v)
    assert all(not r.v[500:].any() and np.abs(r.v).max() <= 75.0 for r in first)
    assert all(0.1 * K / ALPHA <= r.pull <= 3.0 * K / ALPHA for r in first)


def compiled_stepper() -> CompiledStepper:
    try:
        return CompiledStepper(Model(Setup(hrc())), DT)
    except OutputFailed as error:
        pytest.skip(str(error))


def test_a_compiled_model_steps_as_it_is_simulated() -> None:
    stepper, t = compiled_stepper(), np.arange(400) * DT
    u = 60.0 * np.sin(2.0 * np.pi * 50.0 * t)
    y = stepper.run(stepper.rest(0.0), u)[1]
    # The first sample is reached one step after rest at zero, which changes nothing.
    expected = Model(Setup(hrc())).simulate(t, u, hold="linear")
    assert np.max(np.abs(y - expected)) < 1e-3 * np.max(np.abs(expected))
    # One by one, and again: the state in front stays as it is.
    state = stepper.rest(-20.0)
    wanted = Stepper.run(stepper, state, u)[1]
    for _ in range(2):
        assert stepper.run(state, u)[1] == pytest.approx(wanted, rel=1e-9, abs=1e-9 * np.abs(wanted).max())
    with pytest.raises(ArithmeticError, match="sample 1 of 2"):
        stepper.run(state, np.array([0.0, np.nan]))


INTERVAL, GAIN, SAMPLES, PERIOD = 1e-3, 1e-6, 2500, 100
SILENT = Drive(np.zeros(3), np.zeros(3), 50.0)


class Lag(Stepper):
    """``x ← pole x + (1 − pole) gain u``; the output's gain grows by ``slope`` a sample."""

    def __init__(self, pole: float, slope: float = 0.0) -> None:
        self.dt, self._pole, self._slope = INTERVAL, pole, slope

    def rest(self, u: float) -> State:
        return GAIN * u, 0

    def step(self, state: State, u: float) -> tuple[State, float]:
        x, n = state
        x = self._pole * x + (1.0 - self._pole) * GAIN * u
        return (x, n + 1), x * (1.0 + self._slope * n)


def test_a_stable_model_repeats_itself_and_comes_to_rest() -> None:
    for number in range(3):
        found = long_run(Lag(0.8), drawn_drive(75.0, 1, number), GAIN, SAMPLES)
        assert (found.samples, found.diverged, found.gained) == (SAMPLES, False, False)
        assert found.drift < 1e-9
        assert found.motion < 1e-9
        assert found.seconds >= 0.0


def test_drift_is_the_difference_of_two_periods() -> None:
    drive, slope = drawn_drive(75.0, 1, 0), 1e-4
    found = long_run(Lag(0.0, slope), drive, GAIN, SAMPLES)
    # The last driven period is the 22nd, the first that is compared the second one.
    u, n = drive.period(INTERVAL), np.arange(PERIOD)
    early = u * (1.0 + slope * (PERIOD + n))
    late = u * (1.0 + slope * (21 * PERIOD + n))
    assert found.drift == pytest.approx(np.sqrt(np.mean((late - early) ** 2) / np.mean(early**2)))
    middle = u * (1.0 + slope * (11 * PERIOD + n))
    assert found.late == pytest.approx(np.sqrt(np.mean((late - middle) ** 2) / np.mean(middle**2)))
    assert found.drift > DRIFTED


def test_a_model_that_leaves_the_range_has_diverged() -> None:
    found = long_run(Lag(1.01), SILENT, GAIN, SAMPLES)
    assert found.diverged and not found.gained and np.isnan(found.motion) and np.isnan(found.drift)
    # 1.01^n reaches 10 at n = 232, which is the sample 231.
    assert found.samples == 231


@pytest.mark.parametrize("error", [SolverFailed("no root"), ArithmeticError("no root")])
def test_a_step_without_a_solution_ends_a_run(error: Exception) -> None:
    class Fails(Lag):
        def step(self, state: State, u: float) -> tuple[State, float]:
            raise error

    assert long_run(Fails(0.5), SILENT, GAIN, SAMPLES).diverged

    class Endless(Lag):
        def step(self, state: State, u: float) -> tuple[State, float]:
            return state, float("nan")

    found = long_run(Endless(0.5), SILENT, GAIN, SAMPLES)
    assert found.diverged and found.samples == 0


def test_short_runs_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match="samples = 1999"):
        long_run(Lag(0.5), SILENT, GAIN, 1999)
    with pytest.raises(InputRefused, match="samples = 19999"):
        long(Place(tmp_path), Settings.from_config(compose("compare")), (0,), 0.05, (19_999, 1))
