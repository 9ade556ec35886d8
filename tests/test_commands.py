"""The commands on small campaigns, in process: exit status, what is printed, what is written."""

from __future__ import annotations

import json
from pathlib import Path

import campaigns
import numpy as np
import pandas as pd
import pytest

from phnn.cli import main
from phnn.models.store import load, save

RECORDINGS = Path(__file__).resolve().parents[2] / "shared" / "recordings"


@pytest.fixture(scope="module")
def folder() -> str:
    return str(campaigns.concealed()[0])


def test_check_says_what_was_understood(folder: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", folder]) == 0
    out = capsys.readouterr().out
    for word in ("sine_010Hz_75V", "sine_010Hz_50V", "step_75V", "um", "noise"):
        assert word in out


def test_identify_writes_a_model_that_predicts(folder: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["identify", folder, "--out", str(out), "starts=1"]) == 0
    captured = capsys.readouterr()
    assert "alpha" in captured.out
    assert "stated" in captured.out
    content = json.loads((out / "identify.json").read_text())
    assert content["parameters"]["m"]["held"].startswith("held at the stated")
    true = campaigns.concealed()[1].base
    for name in ("k", "alpha", "d_1"):
        assert content["parameters"][name]["value"] == pytest.approx(true[name], rel=0.02)
    assert all(s["residual_over_noise"] < 1.2 for s in content["fit"].values())
    assert main(["predict", str(out / "base"), folder, "--out", str(tmp_path / "y")]) == 0
    for recording in campaigns.campaign().recordings:
        table = pd.read_csv(tmp_path / "y" / f"{recording.name}.csv")
        assert list(table.columns) == ["time_s", "displacement_m"]
        assert np.std(table["displacement_m"] - recording.y) < 1.2 * recording.noise
    assert sorted(p.name for p in out.iterdir()) == [".phnn", "base", "identify.json", "index.html"]


def test_predict_without_an_output_starts_at_rest_with_no_offset(tmp_path: Path) -> None:
    fitted = campaigns.base()
    save(fitted.setup, tmp_path / "model", 2)
    assert load(tmp_path / "model")[1] == 2
    folder = tmp_path / "inputs"
    folder.mkdir()
    table = pd.read_csv(campaigns.concealed()[0] / "sine_010Hz_75V.csv")
    table[["time_s", "voltage_V"]].to_csv(folder / "a.csv", index=False)
    assert main(["predict", str(tmp_path / "model"), str(folder), "--out", str(tmp_path / "y")]) == 0
    found = pd.read_csv(tmp_path / "y" / "a.csv")["displacement_m"]
    recording = campaigns.campaign().recordings[0]
    assert found[0] == 0.0
    assert np.std(found - recording.y) < 1.1 * recording.noise


def test_parts_of_a_recording_are_told_apart_in_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    from rich.console import Console

    from phnn.commands.identify import _score_table
    from phnn.identification.evaluate import Evaluation, PartScore

    parts = tuple(PartScore(f"loops[{u}]", u, 99.0, 1e-8, 1.0) for u in ("identification", "confirmation"))
    Console(width=200).print(_score_table({"base": Evaluation({}, parts)}))
    shown = capsys.readouterr().out
    assert "loops[identification]" in shown
    assert "loops[confirmation]" in shown


@pytest.mark.slow
def test_diagnose_finds_nothing_where_nothing_is_missing(folder: str, tmp_path: Path) -> None:
    assert main(["diagnose", folder, "--out", str(tmp_path / "out"), "starts=2", "seed=1"]) == 0
    content = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert content["verdict"] == "none"
    assert content["seed"] == 1
    names = {".phnn", "diagnosis.json", "report.html", "index.html", "model", "base", "figures"}
    assert {p.name for p in (tmp_path / "out").iterdir()} == names


@pytest.mark.slow
def test_compare_ranks_the_models(folder: str, tmp_path: Path) -> None:
    assert main(["compare", folder, "--out", str(tmp_path), "starts=2"]) == 0
    content = json.loads((tmp_path / "compare.json").read_text())
    assert set(content) == {"phs", "phs_neural", "bouc_wen", "linear"}
    for scores in content.values():
        assert set(scores) == {r.name for r in campaigns.campaign().recordings}
        assert {n for n, s in scores.items() if s["held_out"]} == {"sine_010Hz_50V"}
        for row in scores.values():
            assert set(row) >= {"fit_percent", "rmse", "residual_over_noise", "held_out"}
    held = {m: s["sine_010Hz_50V"]["residual_over_noise"] for m, s in content.items()}
    assert held["phs"] < 1.2 < held["bouc_wen"] < held["linear"]


@pytest.mark.slow
def test_a_real_stack_is_modelled_better_after_the_diagnosis(tmp_path: Path) -> None:
    folder = RECORDINGS / "piezo-stack"
    if not folder.is_dir():
        pytest.skip(f"the public recordings of a piezo stack are not at {folder}")
    assert main(["diagnose", str(folder), "--out", str(tmp_path / "out")]) == 0
    content = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert content["verdict"] != "none"
    before, after = content["fit"]["before"], content["fit"]["after"]
    assert content["fit"]["held_out"]
    for name in content["fit"]["held_out"]:
        assert after[name]["residual_over_noise"] < before[name]["residual_over_noise"]
        assert after[name]["fit_percent"] > 98.0
