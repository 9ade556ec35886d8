"""Worked studies of public recordings: the Silverbox's protocol, figures from what commands wrote, and the script."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat
from scripts_example import script

from phnn.configuration import config_folder
from phnn.models.network_file import load_network
from phnn.recordings import Campaign, Recording, read
from phnn.setup import Setup
from phnn.trajectory import simulate
from studies.public import UNSCORED, figures, initial_state, official_errors

STEPS, ZERO = 4, 0.02
MANIFEST = """
setup: {{network: {network}}}
voltage: terminals
variables: {{input: V1, output: V2}}
columns: {{input: {{unit: V}}, output: {{unit: V}}}}
sample_rate_hz: 610.3515625
start: unknown
input: band_limited
recordings:
  - {{file: made.mat, name: training, slice: [0, 900], use: identification}}
  - {{file: made.mat, name: test, slice: [900, 1400], use: confirmation}}
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Setup, Campaign]:
    """An oscillator, and what it answers to a smooth noise; the test begins in motion."""
    folder = tmp_path_factory.mktemp("silverbox")
    network = config_folder() / "recordings" / "silverbox" / "oscillator.yaml"
    setup = Setup(load_network(network), name="oscillator")
    u = np.convolve(np.random.default_rng(1).standard_normal(1400), np.hanning(12), mode="same") * 0.02
    savemat(folder / "made.mat", {"V1": u[None], "V2": np.random.default_rng(2).standard_normal((1, 1400))})
    (folder / "recordings.yaml").write_text(MANIFEST.format(network=network), encoding="utf-8")
    campaign = read(folder, allow_outside=True)

    def answered(recording: Recording) -> Recording:
        begun = simulate(setup, recording, STEPS).states[0].copy()
        begun[setup.network.state_names.index("q")] += 0.05 if recording.name == "test" else 0.0
        return replace(recording, y=simulate(setup, recording, STEPS, initial=begun).y + ZERO)

    return setup, replace(campaign, recordings=tuple(answered(r) for r in campaign.recordings))


def test_the_true_model_has_no_error(made: tuple[Setup, Campaign]) -> None:
    setup, campaign = made
    assert official_errors(setup, STEPS, campaign)["test"] < 1e-6


def test_the_initial_state_is_that_of_the_unscored_samples(made: tuple[Setup, Campaign]) -> None:
    setup, campaign = made
    test = campaign.recordings[1]
    later = replace(test, y=np.where(np.arange(test.y.size) < UNSCORED, test.y, 9.0))
    begun = initial_state(setup, STEPS, later, ZERO)
    place = setup.network.state_names.index("q")
    assert begun[place] - simulate(setup, test, STEPS).states[0][place] == pytest.approx(0.05, rel=1e-3)


def test_a_mean_that_the_training_samples_do_not_have_is_an_error(made: tuple[Setup, Campaign]) -> None:
    setup, campaign = made
    training, test = campaign.recordings
    scored = np.arange(test.y.size) >= UNSCORED
    moved = replace(campaign, recordings=(training, replace(test, y=test.y + 0.01 * scored)))
    assert official_errors(setup, STEPS, moved)["test"] == pytest.approx(0.01, rel=1e-3)


PARTS = ("trajectory[identification]", "trajectory[confirmation]")


def scores(*rmse: float) -> dict[str, Any]:
    return {part: {"rmse": value} for part, value in zip(PARTS, rmse, strict=True)}


def write(path: Path, content: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(content), encoding="utf-8")


def test_emps(tmp_path: Path) -> None:
    load = {"effect": "constant_load", "equivalent_to": ["sensor_drift"]}
    diagnosis = {
        "verdict": "equivalent",
        "missing": [load | {"parameters": {"F_0": {"value": 3.0, "std": 0.1}}}],
        "location": {"name": "mechanical", "tied": ["sensor"]},
        "fit": {"before": scores(0.026, 0.083), "after": scores(0.004, 0.006)},
        "noise_floor": {"trajectory": 2.5e-7},
    }
    parameters = {n: {"value": v, "std": 0.1 * v} for n, v in {"m": 95.0, "b": 200.0, "F_c": 20.0, "F_0": 3.2}.items()}
    write(tmp_path / "diagnose" / "diagnosis.json", diagnosis)
    write(tmp_path / "identify-split" / "identify.json", {"parameters": parameters, "fit": scores(0.002, 0.008)})
    whole = {"parameters": parameters, "fit": {"trajectory": {"rmse": 0.0025}}}
    write(tmp_path / "identify-whole" / "identify.json", whole)
    found = figures("emps", tmp_path, tmp_path)
    assert found["missing"] == {"result": "constant load"}
    assert found["cannot be told from it"] == {"result": "sensor drift"}
    assert found["M [kg]"] == {"first 60 %": (95.0, 9.5), "all 25 s": (95.0, 9.5)}
    assert found["F_0 [N]"]["diagnosis"] == (3.0, 0.1)
    assert found["load and dry friction"]["held out [mm]"] == pytest.approx(8.0)


ROOT = Path(__file__).parents[3]


def test_the_script_refuses_an_empty_folder_and_writes_down_what_a_command_took_that_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    for settings in ([], ["studies.emps=[check]"]):
        with pytest.raises(SystemExit) as stop:
            script("public", f"folder={tmp_path}", f"out={tmp_path / 'out'}", *settings)
        assert stop.value.code == 2
        if not settings:
            assert "no folder of any study" in capsys.readouterr().err and not any(tmp_path.iterdir())
            (tmp_path / "emps").mkdir()
    table = pd.read_csv(tmp_path / "out" / "studies.csv")
    assert table.loc[0, "status"] == 2
    assert table.loc[0, "seconds"] > 0.0 and 0.01 < table.loc[0, "peak_GB"] < 10.0
