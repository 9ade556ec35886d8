"""``phnn invert``: what it writes, what it prints, what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import phnn
from phnn.cli import main
from phnn.models.actuator import from_paper
from phnn.models.store import save
from phnn.setup import Setup

RATE = 10_000.0


def table(size_um: float = 80.0, frequency: float = 25.0) -> pd.DataFrame:
    t = np.arange(801) / RATE
    y = 0.5 * size_um * (1.0 - np.cos(2.0 * np.pi * frequency * t))
    return pd.DataFrame({"time_s": t, "displacement_um": y})


@pytest.fixture
def home(tmp_path: Path) -> Path:
    save(Setup(from_paper()), tmp_path / "model", 1)
    (tmp_path / "given").mkdir()
    table().to_csv(tmp_path / "given" / "r.csv", index=False)
    return tmp_path


def run(home: Path, *more: str, reference: str = "given/r.csv") -> int:
    return main(["invert", str(home / "model"), str(home / reference), "--out", str(home / "out"), *more])


def test_the_command_can_be_given_to_the_model(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(home) == 0
    printed = capsys.readouterr().out
    assert "error of the model: at most" in printed
    assert str(home / "out" / "command.csv") in printed
    assert {p.name for p in (home / "out").iterdir()} == {".phnn", "command.csv", "invert.json", "invert.png"}
    found = pd.read_csv(home / "out" / "command.csv")
    assert list(found.columns) == ["time_s", "voltage_V", "displacement_m", "reference_m", "error_m"]
    content = json.loads((home / "out" / "invert.json").read_text())
    assert content["schema"] == "phnn.inverse/1"
    assert content["follows"] is True
    assert content["missed"] == []
    model = phnn.load(home / "model")
    y = model.simulate(found["time_s"], found["voltage_V"], input_before=content["voltage_before_V"])
    assert np.abs(y - 1e-6 * table()["displacement_um"]).max() <= content["tolerance_m"]
    assert (home / "out" / "invert.png").read_bytes().startswith(b"\x89PNG")


def test_the_command_is_a_recording_that_phnn_predicts(home: Path) -> None:
    assert run(home) == 0
    (home / "check").mkdir()
    found = pd.read_csv(home / "out" / "command.csv")
    found[["time_s", "voltage_V"]].to_csv(home / "check" / "a.csv", index=False)
    # The folder of an identification stands for the model in it.
    (home / "identified").mkdir()
    (home / "model").rename(home / "identified" / "base")
    assert main(["predict", str(home / "identified"), str(home / "check"), "--out", str(home / "predicted")]) == 0
    predicted = pd.read_csv(home / "predicted" / "a.csv")["displacement_m"]
    # The start of a table without a manifest is zero volts, the command begins with a jump of a few volts from there.
    assert np.abs(predicted - found["displacement_m"]).max() < 0.01 * np.ptp(predicted)


def test_options_reach_the_inverse(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--limits", "-3", "40", "--slew", "1e5", "--smooth", "300", "--lead-in", "0.01", "--hold", "zero_order"]
    assert run(home, *options, "--tolerance", "1e-8") == 0
    content = json.loads((home / "out" / "invert.json").read_text())
    assert content["options"] == {
        "smooth_Hz": 300.0, "limits_V": [-3.0, 40.0], "slew_V_per_s": 1e5, "hold": "zero_order", "lead_in_s": 0.01,
    }  # fmt: skip
    assert content["tolerance_m"] == 1e-8
    found = pd.read_csv(home / "out" / "command.csv")
    assert found["time_s"][0] == pytest.approx(-0.01)
    assert found["voltage_V"].between(-3.0, 40.0).all()
    assert not content["follows"]
    assert "the voltage limits -3 V and 40 V" in content["missed"][0]["causes"][0]
    assert "it is limited by the voltage limits" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "needle"),
    [
        (lambda f: f.rename(columns={"displacement_um": "displacement"}), "no unit for the displacement"),
        (lambda f: f.rename(columns={"displacement_um": "displacement_V"}), "cannot be in V"),
        (lambda f: f.rename(columns={"displacement_um": "voltage_V"}), "no displacement column"),
        (lambda f: f.rename(columns={"displacement_um": "output_V"}), "the output of the model in m"),
        (lambda f: f.drop(columns="time_s"), "no time column"),
        (lambda f: f.assign(displacement_um=f["displacement_um"].where(f.index != 7)), "row 8"),
        (lambda f: f.assign(displacement_um=3.0), "constant at"),
        (lambda f: f.drop(index=range(100, 200)), "gap"),
        (lambda f: f.assign(time_s=f["time_s"][::-1].to_numpy()), "time"),
        (lambda f: f.assign(displacement_um=1e6 * f["displacement_um"]), "correct the unit"),
        (lambda f: f.assign(displacement_um=50.0 * (f.index > 300)), "jumps, has corners, or is noisy"),
    ],
)
def test_what_is_no_reference_is_refused(
    home: Path, capsys: pytest.CaptureFixture[str], change: object, needle: str
) -> None:
    change(table()).to_csv(home / "given" / "r.csv", index=False)  # type: ignore[operator]
    assert run(home) == 2
    streams = capsys.readouterr()
    assert needle in streams.err
    assert streams.err.count("\n") == 1
    assert not (home / "out").exists()


def test_an_absent_reference_and_another_kind_of_model_are_refused(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(home, reference="given/none.csv") == 2
    assert "no such file" in capsys.readouterr().err
    model = json.loads((home / "model" / "model.json").read_text())
    (home / "model" / "model.json").write_text(json.dumps({**model, "schema": "phnn.modal-model/3"}))
    assert run(home) == 2


def test_results_never_go_where_the_reference_lies(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = home / "given"
    assert main(["invert", str(home / "model"), str(given / "r.csv"), "--out", str(given)]) == 2
    assert "from which this command reads" in capsys.readouterr().err
    assert {p.name for p in given.iterdir()} == {"r.csv"}


def test_a_smoothed_reference_is_no_excuse(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    t = np.arange(2001) / RATE
    corners = 20.0 * np.abs(2.0 * (25.0 * t % 1.0) - 1.0)
    pd.DataFrame({"time_s": t, "displacement_um": corners}).to_csv(home / "given" / "r.csv", index=False)
    assert run(home, "--smooth", "500", "--lead-in", "0.02") == 0
    printed = capsys.readouterr().out
    assert "against the smoothed reference: at most" in printed
    assert "against the reference itself: at most" in printed
    content = json.loads((home / "out" / "invert.json").read_text())
    found = pd.read_csv(home / "out" / "command.csv")
    apart = np.abs(found["displacement_m"] - found["given_m"])
    assert content["error_of_given_max_m"] == pytest.approx(apart.max())
    assert content["error_of_given_max_m"] > 10.0 * content["error_max_m"]
    np.testing.assert_allclose(found["given_m"].iloc[-t.size :], 1e-6 * corners, atol=1e-15)


def test_a_command_beyond_the_recordings_is_told(tmp_path: Path) -> None:
    t, y = np.arange(801) / RATE, 1e-6 * table()["displacement_um"].to_numpy()
    for inputs, told in (((-75.0, 75.0), False), ((0.0, 20.0), True), (None, False)):
        model = phnn.Model(Setup(from_paper()), inputs=inputs)
        model.save(tmp_path / str(inputs))
        loaded = phnn.load(tmp_path / str(inputs))
        assert loaded.inputs == inputs
        assert any("beyond that it extrapolates" in m for m in loaded.inverse(t, y).messages) is told


@pytest.mark.parametrize("hold", ["cubic", "zero_order"])
def test_what_is_reached_is_simulated_with_the_same_hold(hold: str) -> None:
    t, y = np.arange(801) / RATE, 1e-6 * table()["displacement_um"].to_numpy()
    model = phnn.Model(Setup(from_paper()))
    found = model.inverse(t, y, hold=hold)
    again = model.simulate(found.t, found.voltage, input_before=found.voltage_before, hold=hold)
    np.testing.assert_allclose(again, found.reached, atol=1e-15)
