"""Sweeps: one folder a run, the same results in every launcher, nothing lost to a failure or a kill, one table."""

from __future__ import annotations

import json
import os
import re
import runpy
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import psutil
import pytest
from test_run import ROOT, settings_of, without_times, written

from phnn.cli import ONE_THREAD
from phnn.errors import InputRefused
from phnn.learn import train_folder
from phnn.multirun import ERROR

SCRIPT = ROOT / "scripts" / "train.py"
gathered = runpy.run_path(str(ROOT / "scripts" / "gather.py"))["gathered"]
SHORT = ("model=hrc", "model.hysterons=1", "model.start=none", "tensorboard=false", "gauss_newton=2")


Sweep = Callable[..., int]


@pytest.fixture
def sweep(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Sweep:
    """Runs a sweep in this process, from the folder above the recordings; gives its exit status."""
    written(tmp_path / "recordings")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("PHNN_SWEEP", "")
    for name in ONE_THREAD:
        monkeypatch.setenv(name, os.environ.get(name, "1"))

    def run(*overrides: str, script: Path = SCRIPT) -> int:
        monkeypatch.setattr(sys, "argv", [str(script), *overrides])
        try:
            runpy.run_path(str(script), run_name="__main__")
        except SystemExit as stop:
            return int(stop.code or 0)
        return 0

    return run


def contents(out: Path) -> dict[str, object]:
    """What the runs of a sweep have written, but for times."""
    names = ("metrics.json", "log.csv", "model/model.json")
    return {f"{home.name}/{n}": without_times((home / n).read_text()) for home in homes(out) for n in names}


def homes(out: Path) -> list[Path]:
    return sorted(path.parent for path in out.glob("*/metrics.json"))


@pytest.mark.slow
def test_a_failing_run_is_told_and_stops_no_other(
    sweep: Sweep, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ("-m", "folder=recordings", *SHORT, "seed=0,1", "solver=discrete_gradient,torchdiffeq")
    assert sweep(*given) == 1
    told = capsys.readouterr()
    table = pd.read_csv(tmp_path / "out" / "sweep" / "runs.csv")
    assert list(table["seed"]) == [0, 0, 1, 1]
    assert list(table["solver.name"]) == ["discrete_gradient", "torchdiffeq"] * 2
    assert list(table["state"]) == ["finished", "failed"] * 2
    assert list(table["epochs"].iloc[::2]) == [2, 2]
    assert table["reason"].iloc[1].startswith("gauss_newton is for networks on whole recordings")
    assert table["reason"].iloc[1] in told.out
    assert "solver=torchdiffeq: failed: gauss_newton is for networks" in told.err
    # Again: what is finished stays, what failed is tried again.
    before = {home: (home / "metrics.json").read_bytes() for home in homes(tmp_path / "out" / "sweep")}
    assert len(before) == 2
    assert sweep(*given) == 1
    assert {home: (home / "metrics.json").read_bytes() for home in homes(tmp_path / "out" / "sweep")} == before
    # A plain run with the same settings is the same.
    home = next(home for home in before if home.name.endswith("seed=1,solver=discrete_gradient"))
    plain = train_folder(settings_of(tmp_path / "recordings", tmp_path / "plain", *SHORT, "seed=1"))
    assert without_times((home / "metrics.json").read_text()) == without_times(json.dumps(plain))


# With one job at a time it starts no processes, which takes most of the time.
@pytest.mark.parametrize("launcher", [
    ("joblib", "hydra.launcher.n_jobs=1"),
    *(pytest.param(o, marks=pytest.mark.slow) for o in (("joblib", "hydra.launcher.n_jobs=2"), ("submitit",))),
])  # fmt: skip
def test_a_launcher_changes_nothing(sweep: Sweep, tmp_path: Path, launcher: tuple[str, ...]) -> None:
    kinds, (name, *options) = ("hrc", "neural_hrc"), launcher
    chosen = (f"launcher={name}", *options, f"model={','.join(kinds)}")
    assert sweep("-m", "out=swept", *chosen, "folder=recordings", *SHORT[1:]) == 0
    for kind in kinds:
        train_folder(settings_of(tmp_path / "recordings", tmp_path / "plain" / kind, f"model={kind}", *SHORT[1:]))
    first, second = contents(tmp_path / "swept"), contents(tmp_path / "plain")
    assert len(first) == 6
    assert list(first.values()) == list(second.values())


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["seed=0,1"], "setting folder is missing"),
        (["folder=recordings,elsewhere"], "runs are not named by folder"),
        (["folder=recordings", "base=a,b"], "runs are not named by base"),
    ],
)
def test_what_cannot_be_swept_is_refused(
    sweep: Sweep, tmp_path: Path, capsys: pytest.CaptureFixture[str], overrides: list[str], words: str
) -> None:
    assert sweep("-m", "out=refused", *overrides) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "refused").exists()


def test_the_table_tells_what_became_of_every_run(
    sweep: Sweep, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = tmp_path / "recordings", tmp_path / "runs"
    for seed in (0, 1):
        train_folder(settings_of(folder, out / f"run_{seed}", *SHORT, f"seed={seed}"))
    (out / "run_1" / "metrics.json").unlink()
    (out / "unfit").mkdir()
    (out / "unfit" / ERROR).write_text("RuntimeError('no memory')\nTraceback ...")
    (out / ".submitit" / "1").mkdir(parents=True)
    (out / ".submitit" / "1" / ERROR).write_text("of no run")
    table = gathered(out)
    assert list(table["run"]) == ["run_0", "run_1", "unfit"]
    assert list(table["state"]) == ["finished", "interrupted", "failed"]
    assert table["epochs"].iloc[:2].tolist() == [2, 2]
    assert 0.0 < table["best_validation"].iloc[1] < np.inf
    assert table["reason"].tolist() == ["", "", "RuntimeError('no memory')"]
    assert set(table.columns).isdisjoint({"folder", "out", "model.kind"})
    assert sweep(str(out), script=ROOT / "scripts" / "gather.py") == 0
    assert re.search(r"│ 0 +│ finished +│ 2 ", capsys.readouterr().out)
    assert pd.read_csv(out / "runs.csv")["seed"].tolist()[:2] == [0, 1]
    (out / "run_0" / "metrics.json").write_text("{")
    with pytest.raises(InputRefused, match=r"metrics\.json: cannot be read .* delete it and repeat the run"):
        gathered(out)
    with pytest.raises(InputRefused, match="no run in it"):
        gathered(folder)


def started(folder: Path, out: str, launcher: str, *overrides: str) -> subprocess.Popen[bytes]:
    """A sweep in a process of its own."""
    command = [sys.executable, str(SCRIPT), "-m", f"launcher={launcher}", "folder=recordings", f"out={out}"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.Popen([*command, "tensorboard=false", *overrides], env=environment, cwd=folder)


@pytest.mark.slow
@pytest.mark.parametrize("launcher", ["joblib", "submitit"])
def test_a_killed_sweep_resumes_to_the_same_result(tmp_path: Path, launcher: str) -> None:
    written(tmp_path / "recordings")
    runs = ("model=neural_hrc", "model.hysterons=1", "model.width=4", "model.start=none", "seed=0,1,2,3", "adam=60")
    overrides = (*runs, "gauss_newton=3", "patience=100")
    assert started(tmp_path, "straight", launcher, *overrides).wait(timeout=1800) == 0
    killed = started(tmp_path, "killed", launcher, *overrides)
    while sum(len(path.read_text().splitlines()) > 8 for path in (tmp_path / "killed").glob("*/log.csv")) < 2:
        assert killed.poll() is None
        time.sleep(0.05)
    workers = psutil.Process(killed.pid).children()
    killed.send_signal(signal.SIGKILL)
    assert killed.wait() == -signal.SIGKILL
    if launcher == "joblib":
        # Jobs of a queue live on, workers do not.
        assert psutil.wait_procs(workers, timeout=60)[1] == []
    assert len(homes(tmp_path / "killed")) < 4
    assert not (tmp_path / "killed" / "runs.csv").exists()
    assert started(tmp_path, "killed", launcher, *overrides).wait(timeout=1800) == 0
    assert contents(tmp_path / "killed") == contents(tmp_path / "straight")
    assert set(pd.read_csv(tmp_path / "killed" / "runs.csv")["state"]) == {"finished"}
