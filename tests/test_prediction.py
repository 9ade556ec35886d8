"""What `phnn predict` says of recordings whose output is known, and error indices against another package."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from campaigns import GENTLE
from junctions import recording

from phnn.cli import main
from phnn.models.actuator import hrc
from phnn.models.store import save
from phnn.prediction import Predicted, error_indices
from phnn.recordings.recording import Part
from phnn.setup import Setup

NOISE, RATE, SAMPLES = 50e-9, 20_000.0, 2_000


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stored")
    save(Setup(hrc(1, GENTLE)), folder / "model", 1)
    return folder / "model"


def sine(frequency: float = 40.0) -> pd.DataFrame:
    t = np.arange(SAMPLES) / RATE
    return pd.DataFrame({"time_s": t, "voltage_V": 60.0 * np.sin(2.0 * np.pi * frequency * t)})


def strict(path: Path) -> dict[str, Any]:
    """json without NaN and infinity, which its standard does not know."""

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} in {path}")

    content: dict[str, Any] = json.loads(path.read_text(), parse_constant=refuse)
    return content


def predict(model: Path, folder: Path, out: Path) -> dict[str, Any]:
    assert main(["predict", str(model), str(folder), "--out", str(out)]) == 0
    return strict(out / "predict.json")


@pytest.fixture
def recorded(model: Path, tmp_path: Path) -> Path:
    """Two recordings of the stored model itself with white noise, one of them marked as held out."""
    inputs, folder, rng = tmp_path / "inputs", tmp_path / "recorded", np.random.default_rng(3)
    inputs.mkdir()
    folder.mkdir()
    for name, frequency in (("a", 40.0), ("b", 60.0)):
        sine(frequency).to_csv(inputs / f"{name}.csv", index=False)
    predict(model, inputs, tmp_path / "clean")
    for name, frequency in (("a", 40.0), ("b", 60.0)):
        y = pd.read_csv(tmp_path / "clean" / f"{name}.csv")["displacement_m"]
        sine(frequency).assign(displacement_m=y + 1e-6 + NOISE * rng.normal(size=SAMPLES)).to_csv(
            folder / f"{name}.csv", index=False
        )
    (folder / "recordings.yaml").write_text("recordings:\n  - a.csv\n  - {file: b.csv, use: confirmation}\n")
    return folder


def test_scores_follow_their_formulas(
    model: Path, recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = predict(model, recorded, tmp_path / "out")
    for name in ("a", "b"):
        row = content["recordings"][name]
        y, found = (
            pd.read_csv(folder / f"{name}.csv")["displacement_m"].to_numpy() for folder in (recorded, tmp_path / "out")
        )
        first = round(row["scored_from_s"] * RATE)
        assert row["samples"] == SAMPLES - first
        error, y = (y - found)[first:], y[first:]
        assert row["rmse"] == pytest.approx(np.sqrt(np.mean(error**2)))
        assert row["unit"] == "m"
        assert row["fit_percent"] == pytest.approx(100.0 * (1.0 - np.linalg.norm(error) / np.linalg.norm(y - y.mean())))
        assert row["residual_over_noise"] == pytest.approx(row["rmse"] / row["noise_floor"])
        assert row["residual_over_noise"] == pytest.approx(1.0, abs=0.1)
    printed = capsys.readouterr().out
    for word in ("fit %", "RMSE", "nm", "residual over noise", "held out", "predict.json"):
        assert word in printed


def test_recordings_held_out_by_the_manifest_are_counted_apart(model: Path, recorded: Path, tmp_path: Path) -> None:
    content = predict(model, recorded, tmp_path / "out")
    rows, totals = content["recordings"], content["totals"]
    assert {n: r["held_out"] for n, r in rows.items()} == {"a": False, "b": True}
    assert {n: t["recordings"] for n, t in totals.items()} == {"all": 2, "held_out": 1, "others": 1}
    for total, name in (("held_out", "b"), ("others", "a")):
        for key in ("fit_percent", "rmse", "residual_over_noise"):
            assert totals[total][key] == pytest.approx(rows[name][key])
    assert totals["all"]["residual_over_noise"] == pytest.approx(
        np.sqrt(np.mean([r["residual_over_noise"] ** 2 for r in rows.values()]))
    )
    (recorded / "recordings.yaml").unlink()
    assert set(predict(model, recorded, tmp_path / "other")["totals"]) == {"all"}


def test_without_an_output_there_is_no_score(
    model: Path, recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (recorded / "recordings.yaml").unlink()
    sine(50.0).to_csv(recorded / "input_only.csv", index=False)
    content = predict(model, recorded, tmp_path / "out")
    row = content["recordings"]["input_only"]
    assert row["fit_percent"] is row["rmse"] is row["residual_over_noise"] is None
    assert "no output" in row["notes"][0]
    assert content["totals"]["all"]["recordings"] == 2
    for name in ("a", "b"):
        (recorded / f"{name}.csv").unlink()
    capsys.readouterr()
    assert predict(model, recorded, tmp_path / "alone")["totals"] == {}
    assert "fit %" not in capsys.readouterr().out


def test_a_constant_output_has_no_fit(model: Path, tmp_path: Path) -> None:
    folder = tmp_path / "rest"
    folder.mkdir()
    # It moves within the samples that give zero and initial state, and rests in those that are scored.
    y = np.where(np.arange(SAMPLES) < 20, 0.3e-6, 0.1e-6)
    sine().assign(displacement_m=y).to_csv(folder / "a.csv", index=False)
    content = predict(model, folder, tmp_path / "out")
    row = content["recordings"]["a"]
    assert row["fit_percent"] is None
    assert row["rmse"] > 0.0
    assert any("constant" in note for note in row["notes"])
    assert content["totals"]["all"]["fit_percent"] is None


def test_no_ratio_is_made_up_where_no_noise_floor_was_found(model: Path, tmp_path: Path) -> None:
    folder = tmp_path / "smooth"
    folder.mkdir()
    table = sine()
    table.assign(displacement_m=1e-6 * table["voltage_V"]).to_csv(folder / "a.csv", index=False)
    row = predict(model, folder, tmp_path / "out")["recordings"]["a"]
    assert row["residual_over_noise"] is None
    assert row["noise_floor"] is None
    assert "no noise floor was found" in row["noise_source"]


NAMES = ("RMSE", "NRMSE", "R_squared", "MAE", "fit_index")
T = np.arange(400) * 1e-3


def outputs(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    y = np.sin(20.0 * T) + 0.3
    return y, y + 0.05 * rng.normal(size=y.size) + 0.02 * T


@pytest.mark.parametrize("window", [None, 0, 50])
def test_they_are_those_of_nonlinear_benchmarks(window: int | None) -> None:
    package = pytest.importorskip("nonlinear_benchmarks")
    y, model = outputs()
    true = package.Input_output_data(y, y, 1e-3, state_initialization_window_length=window)
    theirs = [float(getattr(package.error_metrics, name)(true, model)) for name in NAMES]
    np.testing.assert_allclose(error_indices(y, model, window or 0), theirs, rtol=1e-13)


def test_a_prediction_has_them_over_what_is_scored_or_behind_a_window() -> None:
    y, model = outputs(1)
    parts = (Part("a[start]", 0, 60, "nuisance"), Part("a", 60, y.size, "confirmation"))
    found = Predicted(replace(recording(T, 0.0 * T), y=y, parts=parts), model, pd.DataFrame(), True)
    assert found.indices() == error_indices(y, model, 60)
    assert found.indices(50) == error_indices(y, model, 50) != found.indices()
    document = found.document("a.csv")
    assert found.indices().rmse == pytest.approx(document["rmse"], rel=1e-12)
    assert found.indices().fit_index == pytest.approx(document["fit_percent"], rel=1e-12)


def test_what_is_undefined_is_no_number() -> None:
    flat = error_indices(np.ones(9), np.zeros(9))
    assert (flat.rmse, flat.mae) == (1.0, 1.0)
    assert np.isnan([flat.nrmse, flat.r_squared, flat.fit_index]).all()
    unrecorded = Predicted(replace(recording(T, 0.0 * T), y=np.full(T.size, np.nan)), T, pd.DataFrame(), False)
    assert np.isnan(unrecorded.indices()).all()
    assert np.isnan(unrecorded.indices(5)).all()
