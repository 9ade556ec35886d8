"""What every attack shares: what is written into a folder, one command in this process, and what must hold after it."""

from __future__ import annotations

import json
import os
import re
import resource
import shutil
import signal
import stat
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from damaged_files import COLUMNS, T, U
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from phnn.cli import main
from phnn.configuration import config_folder
from phnn.models import hrc
from phnn.models.store import FILE, save
from phnn.network import Resistor, Storage
from phnn.nn import ConvexEnergyMLP, MonotoneMLP, SectorMLP
from phnn.parameters import Parameter, positive
from phnn.setup import Block, Setup

WITHOUT_LIMITS = settings(
    deadline=None, derandomize=True, database=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck)
)
# Seconds, bytes of memory beyond twice the size of the input, and exit statuses.
LONGEST, MEMORY, REFUSED, INTERRUPTED = 10, 10**9, 2, 130
# Stands in the environment, and in a file that is no input: neither is ever printed.
SECRETS = ("swordfish", "root:")
# Names of the files that are opened while a command runs; nothing while none does.
OPENED: list[list[str]] = []
# Installed code, what it compiled, and what the system tells of itself: any command may open these.
CACHE = os.environ.get("PHNN_CACHE_DIR") or Path.home() / ".cache"
SYSTEM = ("/dev/null", "/proc", "/sys/fs/cgroup", "/usr/share/zoneinfo")
OPEN_TO_ALL = (sys.prefix, sys.base_prefix, Path(__file__).parents[2], CACHE, *SYSTEM, *sys.path[1:])
# Controls but for the end of a line, marks that reverse the direction of writing, and halves of letters.
ODD = re.compile("[\0-\x09\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
# (120, 3) time [s], voltage [V] and displacement [m] of a recording in which nothing is wrong.
TABLE = np.column_stack([T, U, 1e-6 * COLUMNS["displacement_um"]])[:120]
HEADER = "time_s,voltage_V,displacement_m"
# A mass that the voltage drives.
NETWORK = (config_folder() / "network" / "mass_spring_damper.yaml").read_text("utf-8").replace("unit: N}", "unit: V}")
# A model with every kind of learned law, a block before it and one behind it.
_LAWS = {"p": SectorMLP(1.0, 1.0, 2), "w": MonotoneMLP(1.0, 1.0, 2)}
_SETUP = Setup(hrc(1).extend(storages=(Storage("w", ConvexEnergyMLP(1e-6, 1.0, 2)),), resistors=tuple(
    Resistor(f"l_{on}", law, {on: 1.0}) for on, law in _LAWS.items())))  # fmt: skip
_SETUP = _SETUP.with_block("amplifier", Block("lowpass", ("tau",)), (positive("tau", 1e-4, "s"),))
_SETUP = _SETUP.with_block("sensor", Block("drift", ("r",)), (Parameter("r", 0.0, "m/s"),))
with tempfile.TemporaryDirectory() as _home:
    save(_SETUP, Path(_home))
    MODEL = json.loads((Path(_home) / FILE).read_text())


def each(*tables: Mapping[str | None, Any]) -> Any:
    """Return the mark of a test of every input of tables by the words of the refusal: none for what has to pass."""
    cases = [
        (words, name, content)
        for table in tables
        for words, some in table.items()
        for name, content in (some if isinstance(some, Mapping) else dict(enumerate(some))).items()
    ]
    return pytest.mark.parametrize(("words", "name", "content"), cases, ids=[f"{c[0]}-{c[1]}" for c in cases])


def put(path: Path, content: str | bytes) -> None:
    """Write a file with this content."""
    path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass"))


def csv(values: np.ndarray = TABLE, header: str = HEADER) -> str:
    """Return a recording as text."""
    return "\n".join([header, *(",".join(repr(float(v)) for v in row) for row in values)]) + "\n"


def seen(root: Path) -> dict[Path, tuple[int, ...]]:
    """Return kind, size, time and hash of everything below a folder; of sparse and special files no content."""
    states = {path: path.lstat() for path in root.rglob("*")}
    small = [p for p, s in states.items() if stat.S_ISREG(s.st_mode) and max(s.st_blocks * 512, s.st_size) <= 2**26]
    hashes = {p: hash(p.read_bytes()) for p in small if os.access(p, os.R_OK)}
    return {p: (s.st_mode, s.st_size, s.st_mtime_ns, hashes.get(p, 0)) for p, s in states.items()}


class Outcome(NamedTuple):
    """Exit status, what was printed, names of what was written or changed below --out, and all that may be at fault."""

    status: int
    err: str
    written: list[str]
    faults: dict[str, Any]


@dataclass
class Attack:
    """A folder ``data`` with one recording below ``root``, and the commands that are run on it or another folder."""

    root: Path
    data: Path
    captured: pytest.CaptureFixture[str]

    def only(self, name: str, content: str | bytes) -> None:
        """Put this file in the place of all that lies in the folder."""
        shutil.rmtree(self.data)
        self.data.mkdir()
        put(self.data / name, content)

    def __call__(self, command: str = "check", *more: str, **given: Any) -> Outcome:
        """As `run`; asserts that nothing is at fault."""
        outcome = self.run(command, *more, **given)
        assert not any(outcome.faults.values()), outcome
        return outcome

    def run(
        self, command: str = "check", *more: str, said: str | bytes | None = None, words: str | None = None,
        folder: Path | str | None = None, model: Path | str | None = None,
    ) -> Outcome:  # fmt: skip
        """Run a command with further arguments, under a manifest that says this, and look at what must hold.

        ``words`` are those of the refusal: none where the input has to pass, ``None`` where all but a fault is right.
        """
        if said is not None:
            put(self.data / "recordings.yaml", said)
        shutil.rmtree(out := self.root / "out", ignore_errors=True)
        if command == "predict" and not (self.root / "model").exists():
            save(Setup(hrc(1)), self.root / "model", 1)
        given = [model or self.root / "model"] if command == "predict" else []
        given += [self.data if folder is None else folder, *(["--out", out] if command != "check" else [])]
        argv = [*map(os.fspath, [f"folder={self.data}", f"out={out}"] if command == "train" else given), *more]
        before, memory = seen(self.root), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        most = MEMORY + 2 * sum(p.lstat().st_blocks * 512 for p in before)
        self.captured.readouterr()
        OPENED.append(opened := [])
        # A command that hangs is interrupted; its time is that of the processor, for others may run beside it.
        signal.signal(signal.SIGALRM, signal.default_int_handler)
        signal.alarm(6 * LONGEST)
        began = time.process_time()
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            status = main([command, *argv])
        seconds = time.process_time() - began
        signal.alarm(0)
        OPENED.clear()
        beyond = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory)
        (shown, err), after = self.captured.readouterr(), seen(self.root)
        changed = [p for p in {*before, *after} - {out} if before.get(p) != after.get(p)]
        written = [p.relative_to(out).as_posix() for p in changed if out in p.parents]
        named = (*OPEN_TO_ALL, *(one[one.find("=/") + 1 :] for one in argv))
        allowed = {os.path.realpath(one) for one in named if "\0" not in str(one)}
        paths = [Path(os.path.realpath(p)) for p in opened if not p.isdigit() and "--allow-outside" not in more]
        # What is read may have no solution: a model that is passive, or a fit far from the recordings.
        right = (0, REFUSED, int(command != "check")) if words is None else (REFUSED,) if words else (0,)
        faults = {
            "tracebacks": "Traceback" in shown + err or "internal error" in err,
            "hangs": (seconds > LONGEST or status == INTERRUPTED) and f"{seconds:.0f} s",
            "memory": beyond > most and f"{beyond / 1e6:.0f} MB",
            "reads outside": [p for p in paths if allowed.isdisjoint(map(str, (p, *p.parents)))],
            "writes outside": [p for p in changed if out not in p.parents],
            "results of what is refused": status == REFUSED and written,
            "letters that a terminal obeys": ODD.findall(shown + err),
            # A message names cause and remedy; it does not recite the file.
            "no message": status and not (err.startswith("phnn: ") and err.count("\n") == 1 and 20 < len(err) < 3000),
            # A manifest that the user names is quoted where it is wrong.
            "secrets": not any("manifest" in one for one in more) and [s for s in SECRETS if s in shown + err],
            # On a terminal they would stand between the lines of the answer.
            "warnings": [str(w.message) for w in warned if issubclass(w.category, RuntimeWarning | UserWarning)],
            "other answers": status not in right or (status == REFUSED and (words or "") not in err),
        }
        return Outcome(status, err, written, faults)

    def count(self, most: int, name: str, mutant: Callable[[Callable[..., Any]], tuple[Outcome, object]]) -> None:
        """Attack with mutants, each made of what it draws, and what is wrong in its numbers; print the sums."""
        counts, wrong, began = Counter[str](), list[object](), time.monotonic()

        @settings(WITHOUT_LIMITS, max_examples=most)
        @given(data=st.data())
        def one(data: st.DataObject) -> None:
            outcome, numbers = mutant(data.draw)
            found = {**outcome.faults, "wrong numbers": numbers}
            counts.update(mutants=1, read=outcome.status == 0, refused=outcome.status == REFUSED)
            counts.update({what: bool(at) for what, at in found.items()})
            wrong.extend([(found, outcome.err)] * any(found.values()))

        one()
        with self.captured.disabled():
            told = ", ".join(f"{number} {what}" for what, number in counts.items())
            print(f"\n{name}: {told}, {time.monotonic() - began:.0f} s")
        assert counts["read"] and counts["refused"] and not wrong, wrong[:9]


@pytest.fixture(scope="session", autouse=True)
def compiled(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Compile the kernels before a time is taken, and note from then on what is opened while a command runs."""
    folder, model, out = (tmp_path_factory.mktemp(name) for name in ("folder", "model", "out"))
    put(folder / "a.csv", csv())
    put(model / FILE, json.dumps(MODEL))
    assert main(["predict", str(model), str(folder), "--out", str(out)]) == 0
    put(folder / "net.yaml", NETWORK)
    put(folder / "recordings.yaml", "setup: {network: net.yaml}\n")
    assert main(["identify", str(folder), "--out", str(out), "starts=1"]) == 0
    sys.addaudithook(lambda event, args: OPENED[-1].append(str(args[0])) if event == "open" and OPENED else None)


@pytest.fixture
def attack(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Attack:
    """Return a folder to attack: what runs in it would write beside it, where that is seen."""
    monkeypatch.setenv("PHNN_SECRET", SECRETS[0])
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").mkdir()
    for name in ("outside.csv", "data/a.csv"):
        put(tmp_path / name, csv())
    return Attack(tmp_path, tmp_path / "data", capsys)
