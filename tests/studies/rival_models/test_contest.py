"""The studies of rivals: what they make and conclude, the use of recordings, and models in a closed loop."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

from phnn.comparison import models
from phnn.configuration import compose
from phnn.errors import InputRefused, OutputFailed
from phnn.model import Model
from phnn.models.actuator import hrc
from phnn.setup import Setup
from studies.rival_models.contest import run
from studies.rival_models.names import register_rivals
from studies.rival_models.rival import State, Stepper
from studies.rival_models.runs import CompiledStepper, Loop, closed, closed_path, drawn_loops

Array = NDArray[np.float64]
QUICK = ("starts=1", "workers=1", "budget=1.5")


@pytest.fixture(autouse=True)
def _registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(models, "_RIVALS", {})
    register_rivals()


def study(out: Path, **changes: object) -> dict[str, object]:
    """The settings of a small study."""
    config = {
        "study": "table", "out": str(out), "sets": ["prandtl_ishlinskii"], "seeds": [4], "noise_um": 0.05,
        "folder": None, "runs": 2, "compare": compose("compare", QUICK),
    }  # fmt: skip
    return config | changes


@pytest.mark.slow
def test_the_table_is_written_and_read_back(tmp_path: Path) -> None:
    chosen = compose("compare", [*QUICK, "models=[hammerstein,dahl]"])
    asked = study(tmp_path, compare=chosen, sets=["prandtl_ishlinskii", "silverbox"], seeds=[4, 5])
    text = run(asked).read_text()
    with (tmp_path / "table.csv").open() as file:
        written = list(csv.DictReader(file))
    assert [(r["set"], r["seed"], r["model"]) for r in written] == [
        ("prandtl_ishlinskii", seed, model) for seed in "45" for model in ("dahl", "hammerstein")
    ]
    assert "seeds 4, 5" in text and "1.5 seconds of one processor" in text and "silverbox: skipped" in text
    line = next(x for x in text.splitlines() if x.startswith("| Hammerstein"))
    assert line.count("±") == 3 and float(line.split("|")[-2]) > 0
    # Finished models are read back with the time that they took.
    assert [x for x in run(asked).read_text().splitlines() if x.startswith("| ")] == [
        x for x in text.splitlines() if x.startswith("| ")
    ]


@pytest.mark.parametrize(
    ("change", "needle"),
    [
        ({"study": "beauty"}, "beauty"), ({"seeds": []}, "seeds"), ({"sets": "moon"}, "moon"),
        ({"noise_um": "x"}, "noise_um=x"), ({"noise_um": -1}, "noise_um=-1"), ({"seeds": [-1]}, "seeds=-1"),
        ({"seeds": "x"}, "seeds=x"), ({"study": "loops", "runs": "x"}, "runs=x"),
    ],
)  # fmt: skip
def test_studies_refuse_what_they_cannot_use(change: dict[str, object], needle: str, tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match=needle):
        run(study(tmp_path / "out", **change))


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
