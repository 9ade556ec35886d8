"""The command line of the experiment, and every file of configs/experiment."""

from __future__ import annotations

import json
import runpy
import subprocess
import sys
from pathlib import Path

import campaigns
import hydra
import pytest

from phnn.configuration import config_folder
from phnn.identification.options import Options
from studies.recordings import Conditions

ROOT = Path(__file__).resolve().parents[3]
FILES = sorted(p.stem for p in (config_folder() / "experiment").glob("*.yaml"))


SCRIPT = ROOT / "scripts" / "experiment.py"


def script(*overrides: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(SCRIPT), *overrides]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)


@pytest.mark.parametrize("name", FILES)
def test_every_experiment_composes(name: str) -> None:
    with hydra.initialize_config_dir(str(config_folder()), version_base=None):
        given = ["out=out"] if name in ("prove", "trainers") else ["folder=recordings", "out=out"]
        config = hydra.compose(f"experiment/{name}", given)
    assert config.out == "out"
    if name in ("prove", "slice"):
        assert config.prove.seed == 2026
        return
    if name == "trainers":
        assert config.seed == 0
        return
    assert config.folder == "recordings"
    if name == "rivals":
        assert config.compare.budget == 60.0
        return
    if name == "studies":
        assert all(
            command.split()[0] in ("check", "compare", "diagnose", "identify", "modes")
            for some in config.studies.values()
            for command in some
        )
        return
    group = {"paper": "fit", "folder": "diagnose", "compare": "compare"}[name]
    assert Options.from_config(config[group]).starts >= 1
    if name in ("paper", "compare"):
        assert Conditions(**config.recordings).effect in ("creep", "none")


@pytest.mark.parametrize(
    ("override", "needle"),
    [
        ("recordings.effect=gravity", "gravity"),
        ("recordings.noise_um=much", "noise_um"),
        ("fit.starts=0", "starts"),
        ("folder=nowhere", "nowhere"),
    ],
)
def test_bad_input_is_refused_in_one_line(
    override: str, needle: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), f"out={tmp_path / 'out'}", override])
    with pytest.raises(SystemExit) as stop:
        runpy.run_path(str(SCRIPT), run_name="__main__")
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert needle in error
    assert error.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize("own", [False, True])
def test_one_command_line(own: bool, tmp_path: Path) -> None:
    folder = [f"folder={campaigns.concealed()[0]}", "fit.starts=1", "published=false"] if own else []
    done = script(f"out={tmp_path}", *folder)
    assert done.returncode == 0, done.stderr
    assert "Table 3" in done.stdout
    content = json.loads((tmp_path / "experiment.json").read_text())
    assert len(content["table"]) == (4 if own else 9)
    models = {"phs", "bouc_wen"} | (set() if own else {"phs_published", "bouc_wen_published"})
    assert all(set(row["models"]) == models for row in content["table"].values())
    written = {p.name for p in tmp_path.iterdir()}
    files = {".phnn", "experiment.json", "experiment.md", "table3.csv", "index.html", "figures", "phs", "bouc_wen"}
    assert written == files | (set() if own else {"recordings"})
    assert len(list((tmp_path / "figures").glob("fig1*.png"))) == (4 if own else 6)
