"""Whole studies of structures in which something is concealed, or nothing; derivatives against differences."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from structure import OMEGA, ZETA, write_folder

from phnn.cli import main
from phnn.modal.fit import output_slopes
from phnn.modal.model import ModalModel
from phnn.modal.study import EQUIVALENT, NAMED, NONE, Result


def test_modes_are_exact_and_nothing_is_named_where_all_is_linear(studied: Callable[[str, int], Result]) -> None:
    result = studied("none", 7)
    model = result.final.fit.model
    assert result.verdict == NONE and len(result.candidates) == 1
    order = np.argsort(model.omega)
    assert np.allclose(model.omega[order], OMEGA, rtol=1e-4)
    assert np.allclose(model.zeta[order], ZETA, rtol=1e-2)


SLOW_ONES = [
    pytest.param(kind, seed, marks=pytest.mark.slow)
    for kind in ("extra_hysteron", "cubic_stiffness", "quadratic_drag")
    for seed in (7, 11, 23)
    if (kind, seed) != ("extra_hysteron", 7)
]


@pytest.mark.parametrize(("kind", "seed"), [("extra_hysteron", 7), *SLOW_ONES])
def test_a_concealed_element_is_named_and_one_model_serves(
    studied: Callable[[str, int], Result], kind: str, seed: int
) -> None:
    result = studied(kind, seed)
    assert result.verdict in (NAMED, EQUIVALENT)
    assert kind in result.final.element.names
    assert all(kind in m.element.names for m in result.members)
    for level in range(2):
        held = np.array(
            [result.held_out[fit].levels[level].rmse for fit in (result.candidates[0].fit, result.final.fit)]
        )
        assert (held[1] < 0.2 * held[0]).all()


def test_the_command_writes_what_it_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    write_folder(folder, "none", 3)
    assert main(["modes", str(folder), "--out", str(out)]) == 0
    document = json.loads((out / "modes.json").read_text())
    assert document["verdict"] == "none" and document["missing"] == [] and len(document["levels"]) == 2
    assert document["outputs"] == ["y_1", "y_2"] and document["units"] == {"input": "V", "output": "m"}
    assert (out / "report.html").stat().st_size > 10_000
    assert {p.name for p in (out / "models").iterdir()} == {
        "linear.json", "linear_at_level_1.json", "linear_at_level_2.json",
    }  # fmt: skip
    assert "one linear model serves" in capsys.readouterr().out


def test_one_amplitude_is_not_judged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "in").mkdir()
    write_folder(tmp_path / "in", "none", 3, levels=(0.7,))
    assert main(["modes", str(tmp_path / "in"), "--out", str(tmp_path / "out")]) == 0
    document = json.loads((tmp_path / "out" / "modes.json").read_text())
    assert document["verdict"] == "none" and len(document["levels"]) == 1 and not document["missing"]
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


def changed(folder: Path, change: Callable[[dict[str, np.ndarray]], None]) -> None:
    """Rewrite the inputs of a folder."""
    inputs = {path.name: np.load(path) for path in sorted(folder.glob("u_*.npy"))}
    change(inputs)
    for name, u in inputs.items():
        np.save(folder / name, u)


@pytest.mark.parametrize("fault", ["never driven", "together", "same realisation"])
def test_inputs_that_cannot_be_told_apart_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], fault: str
) -> None:
    write_folder(tmp_path, "none", 3, levels=(0.7,))

    def change(inputs: dict[str, np.ndarray]) -> None:
        for u in inputs.values():
            if fault == "never driven":
                u[:, 1] = 0.0
            elif fault == "together":
                u[:, 1] = u[:, 0]
            else:
                u[:] = u[:, :, :1]

    changed(tmp_path, change)
    assert main(["modes", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert ("is not driven" if fault == "never driven" else "move together") in capsys.readouterr().err


@pytest.mark.slow
def test_a_pure_element_is_not_mixed_with_others_where_amplitudes_are_far_apart(tmp_path: Path) -> None:
    write_folder(tmp_path, "cubic_stiffness", 5, levels=(0.2, 2.1))
    assert main(["modes", str(tmp_path), "--out", str(tmp_path / "out")]) == 0
    assert json.loads((tmp_path / "out" / "modes.json").read_text())["elements"] == ["cubic_stiffness"]


Array = NDArray[np.float64]


def moved(model: ModalModel, k: int, by: float, dt: float) -> ModalModel:
    m, ports, outputs = model.omega.size, model.b.shape[1], model.delay.size
    sizes = np.cumsum([m, m, m * ports, outputs])
    if k < sizes[0]:
        return replace(model, omega=model.omega * np.exp(by * (np.arange(m) == k)))
    if k < sizes[1]:
        return replace(model, zeta=model.zeta * np.exp(by * (np.arange(m) == k - sizes[0])))
    if k < sizes[2]:
        return replace(model, b=model.b + by * (np.arange(m * ports) == k - sizes[1]).reshape(m, ports))
    if k < sizes[3]:
        return replace(model, delay=model.delay + by * dt * (np.arange(outputs) == k - sizes[2]))
    return replace(model, k=model.k * np.exp(by * (np.arange(model.k.size) == k - sizes[3]).reshape(model.k.shape)))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "bound"), [("linear", 0.999999), ("extra_hysteron", 0.75)])
def test_slopes_point_where_differences_do(studied: Callable[[str, int], Result], name: str, bound: float) -> None:
    result = studied("extra_hysteron", 7)
    study = result.study
    fit = next(c.fit for c in result.candidates if c.element.name == name)
    experiment, lines = study.identification(0)[0], study.lines

    def outputs(model: ModalModel) -> Array:
        seen = model.seen(experiment, study.dt).at(lines, 1.0)
        return (seen.columns @ fit.shapes.T) * np.exp(-seen.s[:, None] * model.delay)

    slopes = output_slopes(fit.model, fit.model.seen(experiment, study.dt).at(lines, 1.0), fit.shapes, study.dt)
    sizes = np.linalg.norm(slopes.reshape(-1, slopes.shape[2]), axis=0)
    for k in np.flatnonzero(sizes > 1e-3 * sizes.max()):
        ahead, behind = (outputs(moved(fit.model, int(k), by, study.dt)) for by in (1e-5, -1e-5))
        difference = (ahead - behind) / 2e-5
        norms = np.linalg.norm(slopes[:, :, k]), np.linalg.norm(difference)
        assert np.vdot(slopes[:, :, k], difference).real >= bound * norms[0] * norms[1], k
        if name == "linear":
            assert norms[0] == pytest.approx(norms[1], rel=1e-6)
