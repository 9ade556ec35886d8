"""Whole trainings: results, refusals, a killed process, dead zones that learned resistors find."""

from __future__ import annotations

import json
from pathlib import Path

import campaigns
import learn_example as example
import numpy as np
import pandas as pd
import pytest
import torch

import phnn
from phnn import cli
from phnn.configuration import compose_groups
from phnn.errors import InputRefused
from phnn.learn import Settings, train_folder
from phnn.learn.run import validation_names
from phnn.learn.settings import settings_in
from phnn.models.actuator import hrc
from phnn.models.neural import inverse, thresholds
from phnn.models.store import load, save
from phnn.network import PortHamiltonianSystem
from phnn.recordings import read
from phnn.setup import Setup
from phnn.trajectory import simulate
from studies.generator.world import TABLE
from studies.recordings import Conditions, write_recordings

ROOT = Path(__file__).resolve().parents[2]
QUICK = ("tensorboard=false", "model.hysterons=1", "model.width=3", "model.start=none")


def written(folder: Path, frequencies: tuple[float, ...] = (30.0, 50.0, 80.0, 120.0)) -> Path:
    """A folder of recordings of the gentle actuator."""
    return campaigns.written(folder, (example.recording(f, 161, seed=k) for k, f in enumerate(frequencies)))


def settings_of(folder: Path, out: Path, *overrides: str) -> Settings:
    return Settings.from_config(compose_groups("train", [f"folder={folder}", f"out={out}", *overrides]))


def test_a_network_is_trained_scored_and_stored(tmp_path: Path) -> None:
    folder, out = written(tmp_path / "recordings"), tmp_path / "out"
    settings = settings_of(folder, out, *QUICK, "gauss_newton=3", "substeps=2")
    content = train_folder(settings)
    assert json.loads((out / "metrics.json").read_text()) == content
    assert {p.name for p in out.iterdir()} == {
        ".phnn", "checkpoint.pt", "config.yaml", "log.csv", "metrics.json", "model", "weights.pt",
    }  # fmt: skip
    log = pd.read_csv(out / "log.csv")
    assert list(log["method"]) == ["gauss_newton"] * 3
    assert log["loss"].iloc[-1] < log["loss"].iloc[0]
    rows = content["recordings"]
    assert {n for n, row in rows.items() if row["held_out"]} != set()
    assert {n for n, row in rows.items() if row["validation"]} == set(validation_names(read(folder), None)) != set()
    assert validation_names(read(folder), ()) == ()
    setup, substeps = load(out / "model")
    held = next(r for r in read(folder).recordings if rows[r.name]["held_out"])
    y = simulate(setup, held, substeps).y
    scored = held.mask("confirmation")
    error = held.y - y - np.mean((held.y - y)[held.mask("nuisance")])
    assert rows[held.name]["rmse"] == pytest.approx(np.sqrt(np.mean(error[scored] ** 2)), rel=1e-6)
    # The run is over: it stays as it is, file by file, whatever is tried.
    before = {p: p.read_bytes() for p in out.rglob("*") if p.is_file()}
    assert train_folder(settings) == content
    with pytest.raises(InputRefused, match=r"config\.yaml: was made with other settings \(seed: 0 before, 1 now\)"):
        train_folder(settings_of(folder, out, *QUICK, "gauss_newton=3", "substeps=2", "seed=1"))
    other = settings_of(written(tmp_path / "other", (30.0, 50.0)), out, *QUICK, "gauss_newton=3", "substeps=2")
    with pytest.raises(InputRefused, match=r"was made with other recordings: take another --out, or resume=false"):
        train_folder(other)
    assert {p: p.read_bytes() for p in out.rglob("*") if p.is_file()} == before


OWN = """
import torch

import phnn


class Cubic(torch.nn.Module):
    def __init__(self, slope):
        super().__init__()
        self.slope = torch.nn.Parameter(torch.tensor(slope, dtype=torch.float64))

    def forward(self, effort):
        return self.slope.abs() * effort**3


def actuator(hysterons):
    return phnn.models.hrc(hysterons=hysterons)
"""


def test_a_system_is_trained_in_place_and_in_several_ways(tmp_path: Path) -> None:
    campaign = read(written(tmp_path / "recordings"))
    system = PortHamiltonianSystem(hrc(1, example.VALUES | {"k": 1.9e4}))
    trained = phnn.train(system, campaign, epochs=3)
    assert trained.system is system and trained.history[-1]["loss"] < trained.history[0]["loss"]
    assert trained.model.parameters["k"] == system.value("k").item() != 1.9e4
    assert trained.over_noise < 1.2
    # The same loss, by another gradient and by an optimiser of the user's own choice.
    for others in (
        {"method": "lbfgs", "adjoint": "torchdiffeq"},
        {"method": "adam", "optimiser": lambda p: torch.optim.RAdam(p, 1e-3)},
    ):
        other = PortHamiltonianSystem(hrc(1, example.VALUES | {"k": 1.9e4}))
        found = phnn.train(other, campaign, epochs=2, substeps=2, out=tmp_path / str(others["method"]), **others)
        assert found.history[0]["loss"] == pytest.approx(trained.history[0]["loss"], rel=0.05)
        assert (tmp_path / str(others["method"]) / "log.csv").exists()
    for others, words in (
        ({"method": "newton"}, "method = 'newton'"),
        ({"seeds": (0, 1)}, "seeds is for phnn train"),
        ({"method": "adam", "optimiser": 3}, "optimiser=3: give a function"),
        ({"method": "adam", "epochs": 1, "optimiser": lambda p: torch.optim.SGD(p, -1.0)}, "cannot be made"),
        ({"out": campaign.folder}, "recordings"),
        # The checkpoint there is that of another network.
        ({"method": "lbfgs", "adjoint": "torchdiffeq", "epochs": 2, "substeps": 2, "out": tmp_path / "lbfgs"}, "model"),
    ):
        with pytest.raises(InputRefused, match=words):
            phnn.train(PortHamiltonianSystem(hrc(1, example.VALUES)), campaign, **others)  # type: ignore[arg-type]
    with pytest.raises(InputRefused, match="give a Network"):
        phnn.train(trained.model, campaign)  # type: ignore[arg-type]


def test_classes_and_configurations_of_the_users_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = written(tmp_path / "recordings", (30.0, 50.0))
    (tmp_path / "law_of_mine.py").write_text(OWN)
    (tmp_path / "configs" / "model").mkdir(parents=True)
    (tmp_path / "configs" / "model" / "mine.yaml").write_text("_target_: law_of_mine.actuator\nhysterons: 1\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    short = ("tensorboard=false", "gauss_newton=0", "stride=4", "substeps=1")
    law = settings_of(
        folder, tmp_path / "law", "model.hysterons=1", "model.start=none", "model._target_=law_of_mine.Cubic",
        "+model.slope=1e-7", "adam=1", "optimiser={_target_: torch.optim.RAdam, lr: 0.001}",
        "scheduler={_target_: torch.optim.lr_scheduler.StepLR, step_size: 1}", *short,
    )  # fmt: skip
    content = train_folder(law)
    assert content["epochs"] == 1 and not (tmp_path / "law" / "model").exists()
    mine = settings_of(folder, Path("mine"), "configs=configs", "model=mine", "lbfgs=1", "seeds=[0,1]", *short)
    content = train_folder(mine)
    assert content["seeds"] == [0, 1]
    assert all(row["rmse_spread"] == 0.0 for row in content["recordings"].values())
    assert (tmp_path / "mine" / "seed_1" / "model").exists()
    with pytest.raises(InputRefused, match=r"law_of_mine\.Absent: there is no such class"):
        train_folder(settings_of(folder, tmp_path / "x", "model._target_=law_of_mine.Absent", *short))
    with pytest.raises(InputRefused, match="configs=nowhere: there is no such folder"):
        settings_of(folder, tmp_path / "x", "configs=nowhere")


@pytest.mark.slow
def test_black_boxes_train_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = written(tmp_path / "recordings")
    short = (
        "model.width=4", "model.states=2", "gauss_newton=0", "adam=2", "window=27", "stride=2", "tensorboard=false",
    )  # fmt: skip
    for model, solver in (("fully_neural", "discrete_gradient"), ("neural_ode", "torchdiffeq")):
        out = tmp_path / model
        method = ("solver.method=rk4", "solver.adjoint=false") if solver == "torchdiffeq" else ()
        given = [f"folder={folder}", f"out={out}", f"model={model}", f"solver={solver}", *short, *method]
        assert cli.main(["train", *given]) == 0
        assert "trained" in capsys.readouterr().out
        assert json.loads((out / "metrics.json").read_text())["model"]["kind"] == model
        # A network of learned laws has a form on disk, a neural differential equation has none.
        predicted = cli.main(["predict", str(out / "model"), str(folder), "--out", str(tmp_path / "predicted")])
        assert predicted == (0 if model == "fully_neural" else 2)
        assert len(torch.load(out / "weights.pt", weights_only=True)) > 3


def test_what_cannot_be_trained_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = written(tmp_path / "recordings", (30.0, 50.0))
    given = [f"folder={folder}", f"out={tmp_path / 'out'}", "tensorboard=false"]
    for wrong, words in (
        (["model=transformer"], "transformer"),
        (["nonsense=1"], "nonsense"),
        (["model.kind=other"], "model.kind = 'other'"),
        (["model.depth=3"], "model.depth"),
        (["+model.depth=3", "model.start=none"], "model.depth: neural_hrc takes"),
        (["validation=[nobody]"], "validation: no recording nobody"),
        (["rate=-1"], "rate=-1 must be a positive number"),
    ):
        assert cli.main(["train", *given, *wrong]) == 2, wrong
        assert words in capsys.readouterr().err
    with pytest.raises(InputRefused, match="Missing mandatory value: out"):
        compose_groups("train", ["folder=a"])


def without_times(text: str) -> object:
    """A file's content but for how long things took."""
    if not text.startswith("{"):
        return [line.rpartition(",")[0] for line in text.splitlines()]
    return {k: v for k, v in json.loads(text).items() if k not in ("seconds", "gradient_seconds")}


def test_settings_of_an_earlier_run_are_read_as_plain_values(tmp_path: Path) -> None:
    settings = Settings(folder=str(written(tmp_path / "rec", (30.0,))), out=str(tmp_path / "out"), adam=1)
    (tmp_path / "out").mkdir()
    for text, words in (("rate: ${oc.env:HOME}\n", "config.yaml"), ("- 1\n", "holds no settings")):
        (tmp_path / "out" / "config.yaml").write_text(text)
        with pytest.raises(InputRefused, match=words):
            settings_in(tmp_path / "out" / "config.yaml")
    assert not settings.allow_outside


def test_a_run_goes_on_from_the_base_it_began_with_alone(tmp_path: Path) -> None:
    folder, given = written(tmp_path / "rec", (30.0, 50.0)), ("gauss_newton=1", "substeps=2", "model.start=parametric")
    settings = settings_of(folder, tmp_path / "out", *QUICK, *given, f"base={tmp_path / 'diagnosis'}")
    save(Setup(hrc(1)), tmp_path / "diagnosis" / "model")
    first = train_folder(settings)
    assert train_folder(settings) == first
    save(Setup(hrc(1)).with_values({"k": 2e4}), tmp_path / "diagnosis" / "model")
    with pytest.raises(InputRefused, match="another model to start from"):
        train_folder(settings)


def test_recordings_outside_the_folder_are_read_where_that_is_allowed(tmp_path: Path) -> None:
    inside, outside = written(tmp_path / "rec", (30.0, 50.0)), tmp_path / "sine_050.csv"
    (inside / outside.name).rename(outside)
    (inside / outside.name).symlink_to(outside)
    given = (f"folder={inside}", f"out={tmp_path / 'out'}", "model=hrc", "model.start=none", "model.hysterons=1")
    short = ("tensorboard=false", "gauss_newton=1", "validation=[]")
    assert cli.main(["train", *given, *short]) == 2
    assert cli.main(["train", *given, *short, "allow_outside=true"]) == 0


@pytest.mark.slow
def test_two_hysterons_learn_dead_zones_they_were_not_told_of(tmp_path: Path) -> None:
    # The generator shares no code with the model: four sines to train on, three more, a step and a chirp held out.
    folder, out = tmp_path / "recordings", tmp_path / "out"
    write_recordings(folder, Conditions(noise_um=0.05, seed=5))
    overrides = ("model.start=none", "stride=5", "substeps=2", "gauss_newton=100", "patience=30", "validation=[]")
    settings = compose_groups("train", [f"folder={folder}", f"out={out}", "tensorboard=false", *overrides])
    content = train_folder(Settings.from_config(settings))
    assert json.loads((out / "metrics.json").read_text()) == content
    assert content["held_out_over_noise"] < 1.3
    setup, substeps = load(out / "model")
    trained = [r for r in read(folder).recordings if r.mask("identification").any()]
    states = np.concatenate([simulate(setup, r, substeps).states for r in trained])
    for i in (1, 2):
        law, half = setup.network.resistors[i - 1].law, 0.5 * TABLE[f"d_{i}"]
        visited = torch.from_numpy(states[:, i - 1] / setup.values()[f"C_{i}"])
        largest = 0.9 * float(law(visited).detach().abs().max())
        for found in thresholds(law, largest, 3.0 * half):
            assert abs(found) == pytest.approx(half, rel=0.01)
        flows = np.linspace(0.05, 1.0, 30) * largest
        exact = flows / TABLE[f"rho_{i}"] + half
        assert np.abs(inverse(law, flows, 4.0 * half) - exact).max() < 0.03 * half
