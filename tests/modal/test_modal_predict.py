"""Models of `phnn modes` predict the recordings that they were fitted to and amplitudes that were held out."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from structure import write_folder

import phnn
from phnn.cli import main
from phnn.errors import InputRefused
from phnn.modal.store import model_from

MIDDLE = 1.2


@pytest.fixture(scope="module")
def middle(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Folder and results of a study of three amplitudes, all experiments at the middle one held out."""
    folder, out = tmp_path_factory.mktemp("middle"), tmp_path_factory.mktemp("results") / "out"
    write_folder(folder, "extra_hysteron", 7, levels=(0.7, MIDDLE, 2.1), held=(MIDDLE,))
    assert main(["modes", str(folder), "--out", str(out), "stops=5"]) == 0
    return folder, out


def test_a_held_out_amplitude_is_scored_and_chooses_nothing(middle: tuple[Path, Path]) -> None:
    _, out = middle
    document = json.loads((out / "modes.json").read_text())
    assert len(document["levels"]) == 2 and len(document["held_out_levels"]) == 1
    assert document["held_out_levels"][0]["amplitude"] == pytest.approx(np.sqrt(2.0) * MIDDLE, rel=1e-2)
    assert document["verdict"] in ("named", "equivalent") and "extra_hysteron" in document["elements"]
    final = document["models"]["+".join(document["elements"])]
    # The amplitude between is predicted as well as the fitted ones are, within a tenth of the worse of them.
    assert final["held_out_levels_share"][0] <= 1.1 * max(final["held_out_share"])
    assert final["held_out_levels_share"][0] < 0.2 * document["models"]["linear"]["held_out_levels_share"][0]
    entry = document["missing"][0]
    assert entry["status"] == document["verdict"] and entry["share_explained"] > 0.5 and entry["passive"]
    assert len(entry["held_out"]["before"]) == len(entry["held_out"]["after"]) == 3


@pytest.mark.slow
def test_what_is_measured_at_a_held_out_amplitude_changes_no_model(middle: tuple[Path, Path], tmp_path: Path) -> None:
    folder, out = middle
    other = tmp_path / "in"
    shutil.copytree(folder, other)
    np.save(other / "y_train_1.npy", 3.0 * np.load(folder / "y_train_1.npy")[:, ::-1])
    assert main(["modes", str(other), "--out", str(tmp_path / "out"), "stops=5"]) == 0
    again = (tmp_path / "out" / "model" / "model.json").read_bytes()
    assert again == (out / "model" / "model.json").read_bytes()


def test_predict_takes_the_model_and_scores_as_the_study(middle: tuple[Path, Path], tmp_path: Path) -> None:
    folder, out = middle
    assert main(["predict", str(out / "model"), str(folder), "--out", str(tmp_path / "p")]) == 0
    document = json.loads((tmp_path / "p" / "predict.json").read_text())
    study = json.loads((out / "modes.json").read_text())
    final = study["models"]["+".join(study["elements"])]
    for level, errors in ((0, final["held_out_rmse"][0]), (2, final["held_out_rmse"][1])):
        for k, error in enumerate(errors, start=1):
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
    path = out / "models" / "extra_hysteron.json"
    modes = phnn.load(path)
    network = modes.to_network()
    assert [(p.name, p.unit) for p in network.ports] == [("input", "V"), ("voltage_2", "V")]
    assert {s.name for s in network.storages if s.name.startswith("s_")} == {
        f"s_{j}_{a}" for j in (1, 2) for a in range(1, 6) if modes.fit.model.k[j - 1, a - 1] > 0.0
    }
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
    "too high a frequency": ("frequency_Hz", [1e300, 2.0, 3.0]),
    "a negative damping": ("damping_ratio", [-0.1, 0.1, 0.1]),
    "an overdamped mode": ("damping_ratio", [1.5, 0.1, 0.1]),
    "NaN": ("damping_ratio", [float("nan"), 0.1, 0.1]),
    "a negative weight": ("parameters", [[-1.0] * 5] * 2),
    "a threshold of nothing": ("thresholds", [[0.0] * 5] * 2),
    "an unknown part": ("kinds", [9] * 5),
    "an unknown element": ("element", ["eval"]),
    "texts": ("delay_s", ["a", "b"]),
    "a huge interval": ("dt_s", 1e9),
    "a negative interval": ("dt_s", -1e-3),
    "no inputs": ("inputs", []),
    "units that are none": ("units", {"input": "V"}),
    "shapes that do not fit": ("shapes", [[1.0]]),
    "a list": ("left_of_fitted", [1.0]),
    "another schema": ("schema", ["phnn.modal-model/2"]),
}


@pytest.mark.parametrize("fault", WRONG)
def test_a_damaged_model_is_refused(middle: tuple[Path, Path], fault: str) -> None:
    document = json.loads((middle[1] / "models" / "extra_hysteron.json").read_text())
    assert model_from(document).fit.model.k.shape == (2, 5)
    key, value = WRONG[fault]
    assert key in document
    with pytest.raises(InputRefused, match="phnn modes"):
        model_from({**document, key: value})
