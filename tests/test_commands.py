"""The commands on small campaigns: exit status, what is printed and written; all refuse in the same words."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import campaigns
import numpy as np
import pandas as pd
import pytest

from phnn.cli import main
from phnn.models.actuator import hrc
from phnn.models.store import load, save
from phnn.setup import Setup


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
    assert sorted(p.name for p in out.iterdir()) == [".phnn", "base", "identify.json"]


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


T = np.arange(600) * 1e-4
U = 50.0 * np.sin(2.0 * np.pi * 50.0 * T)
Y = 1e-6 * (U + 0.1 * U**2 / 50.0) + 20e-9 * np.random.default_rng(0).standard_normal(T.size)
ROWS = [",".join(map(repr, row)) for row in np.column_stack([T, U, Y]).tolist()]
GOOD = "\n".join(["time_s,voltage_V,displacement_m", *ROWS]) + "\n"
COMMANDS = ["check", "identify", "diagnose", "compare", "predict", "modes"]
# Text of the recording, of the manifest, and words of the refusal: one fault of each stage of reading.
CASES: dict[str, tuple[str | None, str, tuple[str, ...]]] = {
    "missing folder": (None, "", ("bad", "no such folder", "check the path")),
    "no number": (GOOD.replace(ROWS[41], "0,nan,0"), "", ("a.csv", "voltage_V", "row 42", "NaN", "repair")),
    "absent file": (GOOD, "recordings: [{file: b.csv}]", ("recordings.yaml", "recordings[0]", "b.csv", "correct its")),
}  # fmt: skip


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("case", CASES)
def test_every_command_refuses_in_the_same_words(
    command: str, case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, manifest, words = CASES[case]
    folder, model, out = tmp_path / "bad", tmp_path / "model", tmp_path / "out"
    if recording is not None:
        folder.mkdir()
        (folder / "a.csv").write_text(recording)
        (folder / "recordings.yaml").write_text(manifest)
    save(Setup(hrc(2)), model)
    given = [*([model] if command == "predict" else []), folder, *([] if command == "check" else ["--out", out])]
    assert main([command, *map(str, given)]) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.startswith("phnn: ") and printed.err.count("\n") == 1
    assert "Traceback" not in printed.err and "internal error" not in printed.err
    assert [w for w in words if w not in printed.err] == [], printed.err
    assert not out.exists()


def test_a_folder_of_results_loses_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, model, result = tmp_path / "data", tmp_path / "model", tmp_path / "out" / "a.csv"
    data.mkdir()
    (data / "a.csv").write_text(GOOD)
    (tmp_path / "link").symlink_to(data)
    save(Setup(hrc(1)), model)

    def predicted(out: Path, *more: str) -> str:
        status = main(["predict", str(model), str(data), "--out", str(out), *more])
        return capsys.readouterr().err if status else ""

    # A folder that is read stays as it is.
    for out in (data, tmp_path / "link" / "new"):
        assert "--out" in predicted(out, "--overwrite")
        assert [p.name for p in data.iterdir()] == ["a.csv"] and (data / "a.csv").read_text() == GOOD
    # A changed result is replaced on request only.
    assert not predicted(result.parent)
    first = result.read_bytes()
    result.write_text("annotated")
    os.utime(result, (time.time() + 10.0,) * 2)
    assert "--overwrite" in predicted(result.parent) and result.read_text() == "annotated"
    assert not predicted(result.parent, "--overwrite") and result.read_bytes() == first
    # Predictions of other recordings stay.
    (data / "a.csv").rename(data / "c.csv")
    assert not predicted(result.parent)
    assert {p.name for p in result.parent.glob("[!.]*")} == {"a.csv", "c.csv", "predict.json"}


def test_a_proposal_of_somebody_else_stops_a_diagnosis_before_the_fit(folder: str, tmp_path: Path) -> None:
    (tmp_path / "next_experiment.csv").write_text("mine")
    assert main(["diagnose", folder, "--out", str(tmp_path)]) == 2
    assert (tmp_path / "next_experiment.csv").read_text() == "mine"
