"""Every command, stopped at random moments: never a mixed folder without its mark, and the same results afterwards."""

from __future__ import annotations

import json
import os
import re
import runpy
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import campaigns
import numpy as np
import pandas as pd
import pytest

from phnn.models.actuator import hrc
from phnn.models.store import save
from phnn.setup import Setup

ROOT = Path(__file__).resolve().parents[2]
MARK = "INCOMPLETE.txt"
SIGNALS = (signal.SIGKILL, signal.SIGINT, signal.SIGTERM)
# Stops of each command by each signal.
STOPS = 5
# One hysteron that slips slowly enough for a training of few steps.
VALUES = {"m": 1.0e-3, "k": 2.0e4, "b": 6.0, "alpha": 0.04, "C_1": 5.0e-7, "rho_1": 1.0e-3, "d_1": 8.0}
GENTLE = "known: {m: {value: 1.0e-3, std: 1.0e-6}}\nsetup: {model: piezo_actuator, hysterons: 1}\n"
# What each run is given, and what an earlier one in the same folder was given; None where that would be refused.
RUNS: dict[str, tuple[list[str], list[str] | None]] = {
    "predict": (["predict", "model", "gentle", "--out", "OUT"], ["predict", "other", "gentle", "--out", "OUT"]),
    "identify": (["identify", "gentle", "--out", "OUT", "starts=1"], ["identify", "fewer", "--out", "OUT", "starts=1"]),
    "diagnose": (
        ["diagnose", "gentle", "--out", "OUT", "starts=1", "max_effects=1"],
        ["diagnose", "fewer", "--out", "OUT", "starts=1", "max_effects=1"],
    ),
    "modes": (["modes", "modes", "--out", "OUT"], ["modes", "modes", "--out", "OUT", "iterations=1"]),
    "train": (
        [
            "train", "folder=gentle", "out=OUT", "model=neural_hrc", "model.hysterons=1", "model.width=3",
            "model.start=none", "tensorboard=false", "adam=20", "gauss_newton=3",
        ],
        None,
    ),
    "compare": (["compare", "gentle", "--out", "OUT", "starts=1", "inputs=20", "models=[phs,bouc_wen,linear]"], None),
    "prove": (
        [
            "prove", "--out", "OUT", "fast_none=1", "fast_weak=1", "only=[fast_none,fast_weak]", "fast_plan=few",
            "executor=serial",
        ],
        None,
    ),
}  # fmt: skip

# Loads everything once and forks for each run, so that stops fall into the work and not into imports.
SERVER = """
import json, os, signal, sys
import phnn.cli, phnn.commands, phnn.compare.run, phnn.learn, phnn.modal.study, phnn.prove.page, phnn.prove.run
import phnn.report.modes
for line in sys.stdin:
    arguments, told = json.loads(line)
    child = os.fork()
    if child == 0:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        out = os.open(told, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        os.dup2(out, 1)
        os.dup2(out, 2)
        os._exit(phnn.cli.main(arguments))
    print(child, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


class Runner:
    """Runs commands in forks of one process."""

    def __init__(self, home: Path) -> None:
        self.home, self.told = home, home / "told.txt"
        environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
        self.process = subprocess.Popen(
            [sys.executable, "-c", SERVER],
            env=environment,
            cwd=home,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def run(self, arguments: list[str], stop: tuple[float, signal.Signals] | None = None) -> int:
        """Exit status; ``stop`` gives the seconds after which a signal is sent."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(json.dumps([arguments, str(self.told)]) + "\n")
        self.process.stdin.flush()
        child = int(self.process.stdout.readline())
        if stop is not None:
            time.sleep(stop[0])
            # One that has ended is no more.
            with suppress(ProcessLookupError):
                os.kill(child, stop[1])
        return int(self.process.stdout.readline())


@pytest.fixture(scope="module")
def runner(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runner]:
    """A folder with recordings and models, and what runs commands in it."""
    home = tmp_path_factory.mktemp("kills")
    setup = Setup(hrc(1, VALUES), name="phs")
    for name, frequencies in (("gentle", (30.0, 50.0, 80.0, 120.0)), ("fewer", (30.0, 80.0))):
        (home / name).mkdir()
        for k, f in enumerate(frequencies):
            t = np.arange(161) / 160.0 / f
            r = campaigns.recorded(setup, f"sine_{f:.0f}", t, 75.0 * np.sin(2.0 * np.pi * f * t), 60e-9, k)
            table = pd.DataFrame({"time_s": r.t, "voltage_V": r.u, "displacement_m": r.y})
            table.to_csv(home / name / f"{r.name}.csv", index=False)
        (home / name / "recordings.yaml").write_text(GENTLE)
    save(setup, home / "model", 2)
    save(setup.with_values({"k": 2.2e4}), home / "other", 2)
    (home / "modes").mkdir()
    structure = runpy.run_path(str(ROOT / "tests" / "modal" / "structure.py"))
    structure["write_folder"](home / "modes", "none", 3, levels=(0.7,))
    made = Runner(home)
    yield made
    assert made.process.stdin is not None
    made.process.stdin.close()
    made.process.wait()


def plain(value: Any) -> Any:
    """Without what a run took."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items() if "seconds" not in k}
    return [plain(v) for v in value] if isinstance(value, list) else value


def results(folder: Path) -> dict[str, object]:
    """What lies in a folder but for notes of phnn, states of a training, and the times that runs took."""
    found: dict[str, object] = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if not path.is_file() or name.startswith(".phnn/") or path.name == "checkpoint.pt":
            continue
        if path.suffix == ".json":
            found[name] = plain(json.loads(path.read_text()))
        elif path.suffix == ".csv":
            table = pd.read_csv(path)
            found[name] = table[[c for c in table.columns if "seconds" not in c]].to_csv()
        elif path.suffix in (".html", ".md"):
            text = re.sub(r"data:image/png;base64,[\w+/=]+", "", path.read_text())
            found[name] = re.sub(r"\d[\d.]*(?=\s*(</td>|\||s\b|seconds?\b|min\b))", "", text)
        else:
            found[name] = path.read_bytes().replace(os.fsencode(folder), b"OUT")
    return found


def differing(a: dict[str, object], b: dict[str, object]) -> list[str]:
    return sorted(n for n in a.keys() | b.keys() if a.get(n) != b.get(n))


@pytest.mark.slow
@pytest.mark.parametrize("verb", RUNS)
def test_a_command_that_is_stopped_leaves_a_mark_and_ends_with_the_same_results(runner: Runner, verb: str) -> None:
    now, before = RUNS[verb]
    place = runner.home / "runs" / verb

    def given(arguments: list[str], out: Path) -> list[str]:
        return [a.replace("OUT", str(out)) for a in arguments]

    # Twice, for the first run may wait for compiled code.
    for _ in range(2):
        began = time.monotonic()
        assert runner.run(given(now, place / "clean")) == 0, runner.told.read_text()
        if verb in ("train", "compare", "prove"):
            break
    seconds = time.monotonic() - began
    clean = results(place / "clean")
    old = None
    if before is not None:
        assert runner.run(given(before, place / "old")) == 0, runner.told.read_text()
        old = results(place / "old")
    seed, out, stopped = list(RUNS).index(verb), place / "out", 0
    for number, moment in enumerate(np.random.default_rng(seed).uniform(0.0, seconds, STOPS * len(SIGNALS))):
        sent = SIGNALS[number % len(SIGNALS)]
        case = f"{verb}, seed {seed}, stop {number}: {sent.name} after {moment:.3f} s"
        shutil.rmtree(out, ignore_errors=True)
        # Every other run meets the results of an earlier one.
        first = old is not None and before is not None and number % 2 == 1
        if first:
            assert runner.run(given(before or [], out)) == 0, case
        status = runner.run(given(now, out), (float(moment), sent))
        stopped += status != 0
        assert status in (0, -sent, 128 + sent), (case, runner.told.read_text())
        assert "Traceback" not in runner.told.read_text(), case
        left = results(out) if out.is_dir() else {}
        whole = not left or left == clean or (first and left == old)
        assert whole or MARK in left, (case, differing(left, clean))
        assert runner.run(given(now, out)) == 0, (case, runner.told.read_text())
        assert results(out) == clean, (case, differing(results(out), clean))
        assert not list(out.rglob("*.part")), case
    print(f"{verb}: {stopped} of {STOPS * len(SIGNALS)} runs were stopped, seed {seed}, {seconds:.1f} s a run")
