"""Studies of modes: their models, what the command says, and the steady states and networks that models give."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import expm
from structure import OMEGA, RATE, ZETA, write_folder

import phnn
from phnn.cli import main
from phnn.errors import InputRefused
from phnn.modal.experiment import Experiment
from phnn.modal.model import ModalModel, Problem, model_from
from phnn.modal.study import Result
from phnn.network.roles import linearised_at_rest


def test_modes_are_exact_where_all_is_linear(studied: Callable[[str, int], Result]) -> None:
    result = studied("none", 7)
    model = result.models[result.final].model
    assert result.linear_serves and set(result.models) == {"linear"}
    order = np.argsort(model.omega)
    assert np.allclose(model.omega[order], OMEGA, rtol=1e-4)
    assert np.allclose(model.zeta[order], ZETA, rtol=1e-2)


def test_a_linear_fit_moves_nothing_that_the_shapes_absorb(studied: Callable[[str, int], Result]) -> None:
    result = studied("none", 7)
    fitted = result.study.identification(0)[:2]
    with ThreadPoolExecutor(1) as pool:
        problem = Problem(result.models["linear"].model, fitted, result.study, pool)
        slopes = problem.slopes(np.zeros(problem.free.shape[1]))
    assert np.linalg.cond(slopes / np.linalg.norm(slopes, axis=0)) < 1e5


def test_the_network_of_the_modes_predicts_as_an_ordinary_model(studied: Callable[[str, int], Result]) -> None:
    result = studied("none", 7)
    model = phnn.Model(phnn.Setup(result.models["linear"].to_network()), substeps=8)
    experiment = result.study.held_out(0)[0]
    cycles, t = 12, np.arange(12 * len(experiment.u)) / RATE
    u = np.tile(experiment.u, (cycles, 1))
    y = model.simulate(t, u[:, 0], further={"voltage_2": u[:, 1]})[-len(experiment.u) :]
    left = y - y.mean() - experiment.y[:, 0]
    assert left.std() < 0.03 * experiment.y[:, 0].std()


SEEDS = [7, pytest.param(11, marks=pytest.mark.slow), pytest.param(23, marks=pytest.mark.slow)]


@pytest.mark.parametrize("seed", SEEDS)
def test_slow_springs_are_found_and_one_model_serves(studied: Callable[[str, int], Result], seed: int) -> None:
    result = studied("slow", seed)
    assert not result.linear_serves and result.final == "slow_ports"
    for level in range(2):
        held = result.study.held_out(level)
        linear, slow = (result.models[name].errors(held) for name in ("linear", "slow_ports"))
        assert (slow < 0.3 * linear).all()
        assert (slow < 1.5 * result.alone[level].errors(held)).all()


def test_the_command_writes_what_it_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    write_folder(folder, "none", 3)
    assert main(["modes", str(folder), "--out", str(out)]) == 0
    document = json.loads((out / "modes.json").read_text())
    assert document["linear_serves"] and document["final"] == "linear" and len(document["levels"]) == 2
    assert document["outputs"] == ["y_1", "y_2"] and document["units"] == {"input": "V", "output": "m"}
    assert {p.name for p in (out / "models").iterdir()} == {
        "linear.json", "linear_at_level_1.json", "linear_at_level_2.json",
    }  # fmt: skip
    assert "one linear model serves" in capsys.readouterr().out
    written = (out / "report.html").read_text()
    assert all(f">{column}<" in written for column in ("input (J½/V)", "voltage_2 (J½/V)", "y_1 (m/J½)", "y_2 (m/J½)"))


def test_one_amplitude_is_not_judged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "in").mkdir()
    write_folder(tmp_path / "in", "none", 3, levels=(0.7,))
    assert main(["modes", str(tmp_path / "in"), "--out", str(tmp_path / "out")]) == 0
    document = json.loads((tmp_path / "out" / "modes.json").read_text())
    assert document["linear_serves"] and len(document["levels"]) == 1
    assert "Record at a second amplitude" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "right", "words"),
    [
        ("start: periodic", "start: unknown", "start: periodic"),
        ("input: band_limited", "input: linear", "input: zero_order"),
        ("file: [u_train_0.npy, y_train_0.npy], ", "file: [u_test_0.npy, y_test_0.npy], ", "realisations"),
    ],
)
def test_recordings_that_show_no_modes_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], wrong: str, right: str, words: str
) -> None:
    write_folder(tmp_path, "none", 3)
    manifest = tmp_path / "recordings.yaml"
    manifest.write_text(manifest.read_text().replace(wrong, right))
    assert main(["modes", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize("fault", ["never driven", "together", "same realisation"])
def test_inputs_that_cannot_be_told_apart_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], fault: str
) -> None:
    write_folder(tmp_path, "none", 3, levels=(0.7,))
    for path in tmp_path.glob("u_*.npy"):
        u = np.load(path)
        if fault == "never driven":
            u[:, 1] = 0.0
        elif fault == "together":
            u[:, 1] = u[:, 0]
        else:
            u[:] = u[:, :, :1]
        np.save(path, u)
    assert main(["modes", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert ("is not driven" if fault == "never driven" else "move together") in capsys.readouterr().err


MIDDLE = 1.2


@pytest.fixture(scope="module")
def middle(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Folder and results of a study of three amplitudes, all experiments at the middle one held out."""
    folder, out = tmp_path_factory.mktemp("middle"), tmp_path_factory.mktemp("results") / "out"
    write_folder(folder, "slow", 7, levels=(0.7, MIDDLE, 2.1), held=(MIDDLE,))
    assert main(["modes", str(folder), "--out", str(out)]) == 0
    return folder, out


def test_a_held_out_amplitude_is_scored_and_chooses_nothing(middle: tuple[Path, Path]) -> None:
    _, out = middle
    document = json.loads((out / "modes.json").read_text())
    assert len(document["levels"]) == 2 and len(document["held_out_levels"]) == 1
    assert document["held_out_levels"][0]["amplitude"] == pytest.approx(np.sqrt(2.0) * MIDDLE, rel=1e-2)
    slow, linear = document["models"]["slow_ports"], document["models"]["linear"]
    assert slow["held_out_levels"][0]["share"] < 0.2 * linear["held_out_levels"][0]["share"]


@pytest.mark.slow
def test_what_is_measured_at_a_held_out_amplitude_changes_no_model(middle: tuple[Path, Path], tmp_path: Path) -> None:
    folder, out = middle
    other = tmp_path / "in"
    shutil.copytree(folder, other)
    np.save(other / "y_train_1.npy", 3.0 * np.load(folder / "y_train_1.npy")[:, ::-1])
    assert main(["modes", str(other), "--out", str(tmp_path / "out")]) == 0
    again = (tmp_path / "out" / "model" / "model.json").read_bytes()
    assert again == (out / "model" / "model.json").read_bytes()


def test_predict_takes_the_model_and_scores_as_the_study(middle: tuple[Path, Path], tmp_path: Path) -> None:
    folder, out = middle
    assert main(["predict", str(out / "model"), str(folder), "--out", str(tmp_path / "p")]) == 0
    document = json.loads((tmp_path / "p" / "predict.json").read_text())
    study = json.loads((out / "modes.json").read_text())
    final = study["models"][study["final"]]
    for level, held in zip((0, 2), final["held_out"], strict=True):
        for k, error in enumerate(held["rmse"], start=1):
            row = document["recordings"][f"test_{level}.y_{k}"]
            assert row["rmse"] == pytest.approx(error, rel=1e-6) and row["unit"] == "m" and row["held_out"]
            assert row["fit_percent"] > 90.0 and row["residual_over_noise"] > 0.5
            table = pd.read_csv(tmp_path / "p" / row["file"])
            assert list(table) == ["time_s", "displacement_m"] and len(table) == row["samples"]
    assert document["totals"]["held_out"]["recordings"] == 2 * (1 + 5 + 1)
    one = out / "models" / "linear.json"
    assert main(["predict", str(one), str(folder), "--out", str(tmp_path / "q")]) == 0


def test_a_stored_model_is_loaded_and_has_a_network(middle: tuple[Path, Path]) -> None:
    folder, out = middle
    path = out / "models" / "slow_ports.json"
    modes = phnn.load(path)
    network = modes.to_network()
    assert [(p.name, p.unit) for p in network.ports] == [("input", "V"), ("voltage_2", "V")]
    assert len(network.storages) == 2 * modes.model.omega.size + 2 and network.output == "y_1"
    campaign = phnn.read(folder)
    for one, other in zip(phnn.predict(modes, campaign), phnn.predict(path, campaign), strict=True):
        assert np.array_equal(one.y, other.y)


def test_recordings_without_outputs_are_predicted(middle: tuple[Path, Path], tmp_path: Path) -> None:
    folder, out = middle
    inputs = tmp_path / "in"
    inputs.mkdir()
    np.save(inputs / "u.npy", np.load(folder / "u_test_0.npy"))
    (inputs / "recordings.yaml").write_text(
        "sample_rate_hz: 1000\nstart: periodic\ninput: band_limited\naxes: [time, channel, realisation, period]\n"
        "columns: {voltage: {column: 0, unit: V}}\nports: {voltage_2: {column: 1, unit: V}}\n"
        "recordings: [{file: u.npy, name: new}]\n"
    )
    assert main(["predict", str(out / "model"), str(inputs), "--out", str(tmp_path / "p")]) == 0
    document = json.loads((tmp_path / "p" / "predict.json").read_text())
    (row,) = document["recordings"].values()
    assert row["rmse"] is None and document["totals"] == {}
    table = pd.read_csv(tmp_path / "p" / row["file"])
    assert list(table) == ["time_s", "y_1_m", "y_2_m"] and table["y_2_m"].std() > 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "right", "words"),
    [
        ("start: periodic", "start: unknown", "start: periodic"),
        ("ports: {voltage_2", "ports: {force_2", "force_2"),
        ("outputs: {y_1", "outputs: {z_1", "z_1"),
        ("2, unit: m}, y_2: {column: 3, unit: m}", "2, unit: V}, y_2: {column: 3, unit: V}", "V by V"),
    ],
)  # fmt: skip
def test_other_recordings_are_refused(
    middle: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], wrong: str, right: str, words: str
) -> None:
    folder, out = middle
    text = (folder / "recordings.yaml").read_text()
    assert wrong in text
    (tmp_path / "other.yaml").write_text(text.replace(wrong, right))
    given = ["predict", str(out / "model"), str(folder), "--manifest", str(tmp_path / "other.yaml")]
    assert main([*given, "--out", str(tmp_path / "p")]) == 2
    told = capsys.readouterr().err
    assert words in told and "Traceback" not in told and not (tmp_path / "p").exists()


WRONG: dict[str, tuple[str, Any]] = {
    "no ports": ("ports", []),
    "ports of another size": ("ports", [[1.0]]),
    "a negative frequency": ("frequency_Hz", [-1.0, 2.0, 3.0]),
    "a frequency of nothing": ("frequency_Hz", []),
    "a negative damping": ("damping_ratio", [-0.1, 0.1, 0.1]),
    "an overdamped mode": ("damping_ratio", [1.5, 0.1, 0.1]),
    "NaN": ("damping_ratio", [float("nan"), 0.1, 0.1]),
    "a negative stiffness": ("springs", [-1.0, 0.1]),
    "springs of another number": ("springs", [0.1]),
    "a reach of nothing": ("reach", [0.0, 1.0]),
    "texts": ("delay_s", ["a", "b"]),
    "a negative interval": ("dt_s", -1e-3),
    "no inputs": ("inputs", []),
    "units that are none": ("units", {"input": "V"}),
    "shapes that do not fit": ("shapes", [[1.0]]),
    "a list": ("left_of_fitted", [1.0]),
    "another schema": ("schema", ["phnn.modal-model/3"]),
}


@pytest.mark.parametrize("fault", WRONG)
def test_a_damaged_model_is_refused(middle: tuple[Path, Path], fault: str) -> None:
    document = json.loads((middle[1] / "models" / "slow_ports.json").read_text())
    assert model_from(document).model.springs.shape == (2,)
    key, value = WRONG[fault]
    assert key in document
    with pytest.raises(InputRefused, match="phnn modes"):
        model_from({**document, key: value})


torch.set_num_threads(1)

Array = NDArray[np.float64]

DT = 1e-3


def model_of(seed: int = 5, modes: int = 3, ports: int = 2, reach: float = 1.0) -> ModalModel:
    """Modes between 20 and 200 Hz, with springs at the ports that matter."""
    rng = np.random.default_rng(seed)
    omega = np.sort(2.0 * np.pi * rng.uniform(20.0, 200.0, modes))
    springs = rng.uniform(0.01, 0.1, ports)
    return ModalModel(
        omega, rng.uniform(0.005, 0.05, modes), rng.standard_normal((modes, ports)), np.array([3e-4, 0.0]),
        springs, reach * rng.uniform(0.5, 2.0, ports),
    )  # fmt: skip


def experiment_of(ports: int, seed: int = 1, size: int = 256, zero_order: bool = False) -> Experiment:
    u = np.random.default_rng(seed).standard_normal((size, ports))
    return Experiment("made", False, u - u.mean(axis=0), np.zeros((size, 2)), np.zeros(2), zero_order)


def matrices(model: ModalModel, k: Array) -> tuple[Array, Array]:
    """``A`` and ``B`` in q and p, with springs k at the ports."""
    square = np.diag(model.omega**2)
    zero, one = np.zeros_like(square), np.eye(model.omega.size)
    b = model.b
    damping = np.diag(2.0 * model.zeta * model.omega)
    a = np.block([[zero, square], [-one - b @ np.diag(k) @ b.T, -damping]])
    return a, np.concatenate([np.zeros_like(b), b])


def test_the_steady_state_is_that_of_a_held_input_step_by_step() -> None:
    model, experiment = model_of(), experiment_of(2, zero_order=True)
    steady = model.steady(experiment, DT)
    n = len(experiment.u)
    x = np.fft.irfft(steady.x, n, axis=0)
    softened = 1.0 / (1.0 + x.var(axis=0) / model.reach**2)
    assert (softened < 0.95).all()
    a, b = matrices(model, model.springs * softened)
    step = expm(DT * a)
    forced = np.linalg.solve(a, (step - np.eye(len(a))) @ b)
    state = np.zeros(len(a))
    for _ in range(60):
        states = []
        for u in experiment.u:
            states.append(state)
            state = step @ state + forced @ u
    q = np.array(states)[:, : model.omega.size]
    assert np.abs(np.fft.irfft(steady.q, n, axis=0) - (q - q.mean(axis=0))).max() < 2e-3 * q.std()


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 2**31), modes=st.integers(1, 5), ports=st.integers(1, 3), reach=st.floats(0.01, 10.0))
def test_ports_take_up_power_at_every_line(seed: int, modes: int, ports: int, reach: float) -> None:
    steady = model_of(seed, modes, ports, reach).steady(experiment := experiment_of(ports, seed), DT)
    u = np.fft.rfft(experiment.u, axis=0)
    supplied = (u.conj() * steady.s[:, None] * steady.x).sum(axis=1).real
    assert (supplied >= -1e-9 * np.abs(u * steady.s[:, None] * steady.x).sum(axis=1)).all()


def moved(model: ModalModel, k: int, by: float) -> ModalModel:
    """The model after a move of the k-th variable of a fit."""
    sizes = [model.omega.size, model.zeta.size, model.b.size, model.delay.size, model.springs.size]
    omega, zeta, b, delay, springs = np.split(by * (np.arange(sum(sizes)) == k), np.cumsum(sizes)[:-1])
    return replace(
        model,
        omega=model.omega * np.exp(omega),
        zeta=model.zeta * np.exp(zeta),
        b=model.b + b.reshape(model.b.shape),
        delay=model.delay + delay * DT,
        springs=model.springs * np.exp(springs),
    )


def test_slopes_are_differences_where_the_mean_square_does_not_matter() -> None:
    model, experiment = model_of(reach=1e6), experiment_of(2)
    shapes = np.random.default_rng(2).standard_normal((2, 2 * 3 + 2))

    def seen(model: ModalModel) -> NDArray[np.complex128]:
        steady = model.steady(experiment, DT)
        return np.asarray((steady.columns @ shapes.T) * np.exp(-steady.s[:, None] * model.delay))

    slopes = model.slopes(model.steady(experiment, DT), shapes, DT)
    for k in range(slopes.shape[2]):
        difference = (seen(moved(model, k, 1e-5)) - seen(moved(model, k, -1e-5))) / 2e-5
        assert np.allclose(slopes[:, :, k], difference, rtol=0.0, atol=1e-5 * np.abs(slopes).max()), k


def test_the_vector_field_of_the_network_is_that_of_the_modes() -> None:
    model = model_of()
    c = np.array([0.3, -0.2, 1.0])
    network = phnn.models.modal(model.omega, model.zeta, model.b, outputs={"tip": c})
    a, b = linearised_at_rest(network)
    own, inputs = matrices(model, np.zeros(2))
    places = [network.state_names.index(f"{kind}_{i}") for kind in "qp" for i in (1, 2, 3)]
    assert np.allclose(a[np.ix_(places, places)], own) and np.allclose(b[places], inputs)
    tip = network.state_names.index("tip")
    assert np.allclose(a[tip, places], np.concatenate([np.zeros(3), c * model.omega**2]))
    assert not a[:, tip].any() and not b[tip].any() and network.output == "tip"


def test_names_of_ports() -> None:
    model = model_of()
    named = phnn.models.modal(model.omega, model.zeta, model.b, ("left", "right"), "N")
    assert [(p.name, p.unit) for p in named.ports] == [("left", "N"), ("right", "N")]
    assert {p.name for p in phnn.models.modal(model.omega, model.zeta, model.b).ports} == {"port_1", "port_2"}
    for names in (("left",), ("left", "left")):
        with pytest.raises(InputRefused, match="2 different names"):
            phnn.models.modal(model.omega, model.zeta, model.b, names)
    with pytest.raises(InputRefused, match="positive frequency"):
        phnn.models.modal(-model.omega, model.zeta, model.b)
