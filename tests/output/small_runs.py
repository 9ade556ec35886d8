"""Every command on recordings so small that it takes a second, and what it leaves behind."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pandas as pd

ROOT = Path(__file__).resolve().parents[2]
MARK = "INCOMPLETE.txt"
# What each run is given, and what an earlier one in the same folder was given; None where that would be refused.
RUNS: dict[str, tuple[list[str], list[str] | None]] = {
    "predict": (["predict", "model", "gentle", "--out", "OUT"], ["predict", "other", "gentle", "--out", "OUT"]),
    "invert": (
        ["invert", "model", "wanted/reference.csv", "--out", "OUT"],
        ["invert", "other", "wanted/reference.csv", "--out", "OUT"],
    ),
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
    "compare": (["compare", "gentle", "--out", "OUT", "starts=1", "models=[phs,bouc_wen,linear]"], None),
}  # fmt: skip

# Loads everything once and forks for each run, so that stops fall into the work and not into imports.
SERVER = """
import json, os, signal, sys
import phnn.cli, phnn.commands, phnn.comparison.models, phnn.learn, phnn.plot.signals, phnn.report.sections
import phnn.report.sections
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
    """Runs commands in forks of one process, which starts with the first of them."""

    def __init__(self, home: Path) -> None:
        self.home, self.told = home, home / "told.txt"
        self._started: subprocess.Popen[str] | None = None

    @property
    def process(self) -> subprocess.Popen[str]:
        if self._started is None:
            self._started = subprocess.Popen(
                [sys.executable, "-c", SERVER],
                env=os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
                cwd=self.home,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
        return self._started

    def end(self) -> None:
        """Let the process end, where one has started."""
        if self._started is not None and self._started.stdin is not None:
            self._started.stdin.close()
            self._started.wait()

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


def given(arguments: list[str], out: Path) -> list[str]:
    """What a command is given, with its folder of results."""
    return [a.replace("OUT", str(out)) for a in arguments]


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
        if path.suffix == ".jsonl":
            found[name] = [plain(json.loads(line)) for line in path.read_text().splitlines()]
        elif path.suffix == ".json":
            found[name] = plain(json.loads(path.read_text()))
        elif path.suffix == ".csv":
            table = pd.read_csv(path)
            found[name] = table[[c for c in table.columns if "seconds" not in c]].to_csv()
        elif path.suffix in (".html", ".md"):
            text = re.sub(r"data:image/png;base64,[\w+/=]+", "", path.read_text().replace(str(folder), "OUT"))
            found[name] = re.sub(r"\d[\d.]*(?=\s*(</td>|\||s\b|seconds?\b|min\b))", "", text)
        else:
            found[name] = path.read_bytes().replace(os.fsencode(folder), b"OUT")
    return found


def differing(a: dict[str, object], b: dict[str, object]) -> list[str]:
    return sorted(n for n in a.keys() | b.keys() if a.get(n) != b.get(n))
