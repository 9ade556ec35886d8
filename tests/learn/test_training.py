"""The loop: it resumes to the same bits, stops on recordings it does not see, and survives bad steps."""

from __future__ import annotations

import csv
import io
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import learn_example as example
import numpy as np
import pytest
import torch
from damaged_files import zipped

from phnn.errors import InputRefused, SolverFailed
from phnn.learn import trainer
from phnn.learn.objective import Objective
from phnn.learn.settings import Settings
from phnn.learn.solvers import Plant, Torchdiffeq, discrete_gradient
from phnn.learn.trainer import Progress, Trainer, board_of, write_log
from phnn.results import Place

KINDS: dict[str, tuple[Callable[[], Plant], int]] = {
    "neural": (lambda: example.neural(3), 3), "fully_neural": (example.fully_neural, 0),
    "neural_ode": (example.neural_ode, 0),
}  # fmt: skip


def objective_of(kind: str, length: int = 0) -> Objective:
    plant = KINDS[kind][0]()
    solver = Torchdiffeq(plant, "rk4", adjoint=False) if kind == "neural_ode" else discrete_gradient
    return Objective(plant, solver, example.recordings(), length)


def settings_of(home: Path, kind: str = "neural", **others: object) -> Settings:
    given: dict[str, object] = {"adam": 3, "lbfgs": 2, "gauss_newton": KINDS[kind][1], "lbfgs_iterations": 2}
    given |= {"tensorboard": False, "patience": 50} | others
    return Settings(folder="-", out=str(home), **given)  # type: ignore[arg-type]


class Killed(Exception):
    """What stands for the end of the process."""


def trained(objective: Objective, settings: Settings, kill_after: int = 0) -> Progress:
    count = [0]

    def say(line: str) -> None:
        count[0] += 1
        if count[0] == kill_after:
            raise Killed

    return Trainer(objective, None, settings, Place(settings.home), say).run()


def values(objective: Objective) -> torch.Tensor:
    return torch.cat([p.detach().reshape(-1) for p in objective.trained()])


def log_of(home: Path) -> list[dict[str, str]]:
    with (home / "log.csv").open() as file:
        return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(file)]


@pytest.mark.parametrize(
    "kind", ["neural", *(pytest.param(k, marks=pytest.mark.slow) for k in ("neural_ode", "fully_neural"))]
)
def test_an_interrupted_run_ends_as_the_uninterrupted_one(tmp_path: Path, kind: str) -> None:
    length = 0 if kind == "neural" else 28
    straight = objective_of(kind, length)
    end = trained(straight, settings_of(tmp_path / "straight", kind))
    epochs = 5 + KINDS[kind][1]
    assert len(end.rows) == epochs
    home = tmp_path / "killed"
    for kill_after in (2, 2, 2):
        with pytest.raises(Killed):
            trained(objective_of(kind, length), settings_of(home, kind), kill_after)
    torch.manual_seed(99)
    resumed = objective_of(kind, length)
    again = trained(resumed, settings_of(home, kind))
    assert torch.equal(values(resumed), values(straight))
    assert log_of(home) == log_of(tmp_path / "straight")
    assert (again.best, again.factor) == (end.best, end.factor)


def test_training_lowers_the_loss_and_ends_with_the_best(tmp_path: Path) -> None:
    objective = objective_of("fully_neural", 28)
    before = float(objective().detach())
    end = trained(objective, settings_of(tmp_path, "fully_neural", adam=8))
    assert end.best < 0.8 * before
    assert float(objective().detach()) == pytest.approx(end.best)
    assert min(row["validation"] for row in end.rows) == end.best


def test_a_training_that_only_harms_ends_where_it_began(tmp_path: Path) -> None:
    # At the truth whatever is moved harms.
    objective = Objective(example.parametric(), discrete_gradient, example.recordings())
    before, began = float(objective().detach()), values(objective)
    end = trained(objective, settings_of(tmp_path, "fully_neural", adam=3, lbfgs=0, rate=0.1))
    assert min(row["validation"] for row in end.rows) > before == end.best
    assert torch.equal(values(objective), began)


def test_each_method_stops_when_validation_no_longer_falls(tmp_path: Path) -> None:
    objective = objective_of("neural")
    told = iter([6.0, 5.0, 4.0, 3.0, 3.5, 3.4, 3.3, *[9.0] * 100])
    kept = []

    def validate() -> float:
        kept.append(values(objective))
        return next(told)

    settings = settings_of(tmp_path, adam=50, lbfgs=0, gauss_newton=20, patience=3)
    end = Trainer(objective, validate, settings, Place(settings.home)).run()
    assert [row["method"] for row in end.rows] == ["adam"] * 6 + ["gauss_newton"] * 3
    assert end.best == 3.0
    assert torch.equal(values(objective), kept[3])


def test_a_failing_step_is_taken_back_and_the_rate_halved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    objective = objective_of("neural_ode", 28)
    real, calls = trainer.with_gradients, [0]

    def sometimes(given: Objective) -> torch.Tensor:
        calls[0] += 1
        if calls[0] == 3:
            with torch.no_grad():
                given.trained()[0].fill_(float("nan"))
        return real(given)

    monkeypatch.setattr(trainer, "with_gradients", sometimes)
    end = trained(objective, settings_of(tmp_path, "neural_ode", adam=6, lbfgs=0))
    assert end.factor == 0.5
    assert len(end.rows) == 6
    assert bool(torch.isfinite(values(objective)).all())
    assert end.best < end.rows[0]["loss"]


def test_training_that_only_fails_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(given: Objective) -> torch.Tensor:
        raise SolverFailed("no solution of the step at t = 1 s")

    monkeypatch.setattr(trainer, "with_gradients", never)
    with pytest.raises(SolverFailed, match=r"failed steps in a row.*t = 1 s.*lower rate"):
        trained(objective_of("neural_ode", 28), settings_of(tmp_path, "neural_ode"))


def test_a_checkpoint_of_other_settings_is_refused(tmp_path: Path) -> None:
    settings = settings_of(tmp_path, adam=1, lbfgs=0, gauss_newton=0)
    trained(objective_of("neural"), settings)
    refused = r"other settings \(rate: 0\.01 before, 0\.1 now\): take the former.*resume=false"
    with pytest.raises(InputRefused, match=refused):
        trained(objective_of("neural"), replace(settings, rate=0.1))
    assert len(trained(objective_of("neural"), replace(settings, rate=0.1, resume=False)).rows) == 1
    # A run that has ended is not trained again.
    assert len(trained(objective_of("neural"), replace(settings, rate=0.1)).rows) == 1


def test_checkpoints_carry_the_random_generator(tmp_path: Path) -> None:
    assert trainer.load(tmp_path / "c.pt") is None
    torch.manual_seed(5)
    trained(objective_of("neural"), settings_of(tmp_path, adam=1, lbfgs=0, gauss_newton=0))
    drawn = torch.rand(3)
    found = trainer.load(tmp_path / trainer.FILE)
    assert found is not None and torch.equal(torch.rand(3), drawn)
    assert {p.name for p in tmp_path.iterdir()} == {".phnn", trainer.FILE, trainer.LOG}


class Runs:
    """What runs code when it is unpickled."""

    def __reduce__(self) -> Any:
        return (eval, ("__import__('pathlib').Path('ran').write_text('')",))


def saved(content: Any = None, **more: Any) -> bytes:
    """Return a checkpoint of this, or one that is whole but for what is given."""
    whole = {"schema": "phnn.checkpoint/1", "settings": {}, "progress": {}, "present": [], "method": None}
    torch.save(whole | {"random": torch.get_rng_state()} | more if content is None else content, file := io.BytesIO())
    return file.getvalue()


VERSION, PICKLE = ("archive/version", b"3"), pickle.dumps(Runs())
# What is no checkpoint, by the words of the refusal.
NONE: dict[str, list[bytes]] = {
    "cannot be read": [
        b"", bytes(4096), PICKLE, zipped(), saved(x=np.zeros(3)), saved()[:-800],
        zipped(("archive/data.pkl", PICKLE), VERSION), zipped(("archive/data.pkl", b"\x80\x02}"), VERSION)],
    "is no phnn.checkpoint/1": [saved([1, 2]), saved(schema="x")],
    "holds no 'random'": [saved({"schema": "phnn.checkpoint/1"})],
    "its state of the random generator": [saved(random=wrong) for wrong in (3, torch.zeros(0), torch.zeros(5056))],
}  # fmt: skip


@pytest.mark.parametrize("words", NONE)
def test_a_checkpoint_that_is_none_is_refused_and_never_run(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for content in NONE[words]:
        (tmp_path / trainer.FILE).write_bytes(content)
        with pytest.raises(InputRefused, match=f"{words}.*delete it to begin anew"):
            trainer.load(tmp_path / trainer.FILE)
    assert [path.name for path in tmp_path.iterdir()] == [trainer.FILE]


def test_logs_are_written_for_tensorboard_as_well(tmp_path: Path) -> None:
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    rows = [
        {"epoch": k, "method": "adam", "loss": 3.0 - k, "validation": None, "rate": 0.1, "seconds": 0.0}
        for k in range(3)
    ]
    board = board_of(Place(tmp_path), 1)
    for count in (2, 3):
        write_log(Place(tmp_path), rows[:count], board)
    board.close()
    events = accumulator.EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    assert [e.value for e in events.Scalars("loss")] == [2.0, 1.0]
    assert "validation" not in events.Tags()["scalars"]
    assert [row["loss"] for row in log_of(tmp_path)] == ["3.0", "2.0", "1.0"]


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"rate": 0.0}, "rate=0.0 must be a positive number"),
        ({"stride": 0}, "stride=0 must be a whole number, 1 or more"),
        ({"patience": 2.5}, "patience=2.5"),
        ({"window": 1}, "window=1"),
        ({"model": {"width": 4}}, "model must hold kind"),
        ({"solver": "torchdiffeq"}, "solver must hold name"),
        ({"epochs": 4}, "unknown setting epochs"),
    ],
)
def test_settings_out_of_range_are_refused(wrong: dict[str, object], words: str) -> None:
    with pytest.raises(InputRefused, match=words):
        Settings.from_config({"folder": "a", "out": "b", **wrong})
    with pytest.raises(InputRefused, match="setting out is missing"):
        Settings.from_config({"folder": "a"})
