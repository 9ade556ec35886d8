"""What every attack shares: a hostile folder, one command in this process, and what must hold afterwards."""

from __future__ import annotations

import hashlib
import os
import resource
import shutil
import stat
import sys
import time
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from attack_tools import Attack, csv

from phnn.cli import main
from phnn.integrate.kernel import march
from phnn.integrate.program import compile_network
from phnn.models import hrc

LONGEST_S = 10.0
# Bytes of memory beyond twice the size of the input.
MEMORY = 10**9
REFUSED = 2
# Names of commands that need a model before the folder, and of those that take --out.
WITH_MODEL, WITH_OUT = ("predict",), ("predict", "identify", "diagnose", "compare", "modes")


@dataclass
class Tally:
    """What all attacks of this process took."""

    inputs: int = 0
    seconds: float = 0.0
    memory: int = 0


TALLY = Tally()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """How many inputs were tried, and what the worst of them took."""
    if TALLY.inputs:
        terminalreporter.write_line(
            f"attacks: {TALLY.inputs} inputs, at most {TALLY.seconds:.1f} s, and {TALLY.memory / 1e6:.0f} MB of memory "
            "beyond twice the size of the input"
        )


@dataclass(frozen=True)
class Outcome:
    """Exit status, what was printed, and the names of what was written."""

    status: int
    out: str
    err: str
    written: tuple[str, ...]

    @property
    def refused(self) -> bool:
        """Whether the input was refused with a message."""
        return self.status == REFUSED


def seen(root: Path, but: Path) -> dict[str, str]:
    """Kind, size and hash of everything below a folder but one branch; of sparse and special files no content."""
    found = {}
    for path in sorted(root.rglob("*")):
        if path == but or but in path.parents:
            continue
        state = path.lstat()
        content = ""
        if stat.S_ISREG(state.st_mode) and state.st_blocks * 512 <= 2**26 and state.st_size <= 2**26:
            content = hashlib.sha256(path.read_bytes()).hexdigest()
        found[os.fsdecode(os.fsencode(path))] = f"{state.st_mode:o} {state.st_size} {state.st_mtime_ns} {content}"
    return found


def peak() -> int:
    """Largest resident size of this process so far, bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


@pytest.fixture(scope="session")
def compiled() -> None:
    """Compile the kernels before a time is taken."""
    network = hrc(2)
    program, n = compile_network(network), len(network.storages)
    states, efforts, u = np.zeros((2, n)), np.zeros((1, n)), np.zeros((1, len(network.ports)))
    for general in (False, True):
        assert march(program, program.theta(network), states[0], u, np.full(1, 1e-3), states, efforts, general) == 1


@pytest.fixture
def attack(compiled: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Attack:
    """Run a command on a folder below ``tmp_path`` and check what must hold after any input.

    Its arguments: ``folder``, ``command``, ``manifest``, ``model`` of predict, ``more`` arguments, the exit
    ``statuses`` that are accepted, and ``fresh``, whether what an earlier run wrote is removed before.
    """

    def run(
        folder: Path, command: str = "check", manifest: Path | None = None, model: Path | None = None,
        more: tuple[str, ...] = (), statuses: tuple[int, ...] = (0, REFUSED), fresh: bool = True,
    ) -> Outcome:  # fmt: skip
        out = tmp_path / "out"
        if fresh:
            shutil.rmtree(out, ignore_errors=True)
        arguments = [command]
        if command in WITH_MODEL:
            arguments.append(os.fspath(model if model is not None else folder / "model"))
        arguments.append(os.fspath(folder))
        arguments += ["--manifest", os.fspath(manifest)] if manifest is not None else []
        arguments += ["--out", os.fspath(out)] if command in WITH_OUT else []
        before, size, memory, began = seen(tmp_path, out), weight(tmp_path), peak(), time.perf_counter()
        capsys.readouterr()
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            status = main([*arguments, *more])
        seconds = time.perf_counter() - began
        printed = capsys.readouterr()
        written = tuple(str(p.relative_to(out)) for p in sorted(out.rglob("*"))) if out.exists() else ()
        outcome = Outcome(status, printed.out, printed.err, written)
        assert status in statuses, outcome
        check_printed(outcome)
        # On a terminal they would stand between the lines of the answer.
        assert not [str(w.message) for w in warned if issubclass(w.category, RuntimeWarning | UserWarning)]
        assert seen(tmp_path, out) == before, "an input was changed, or something was written beside --out"
        beyond = peak() - memory - 2 * size
        TALLY.inputs, TALLY.seconds, TALLY.memory = (
            TALLY.inputs + 1, max(TALLY.seconds, seconds), max(TALLY.memory, beyond)
        )  # fmt: skip
        assert seconds < LONGEST_S, f"{seconds:.1f} s"
        assert beyond < MEMORY, f"{beyond / 1e6:.0f} MB beyond twice the size"
        return outcome

    return run


def weight(root: Path) -> int:
    """Bytes that the files below a folder take on the disk."""
    return sum(p.lstat().st_blocks * 512 for p in root.rglob("*"))


def check_printed(outcome: Outcome) -> None:
    """One message where it was refused, nothing that a terminal obeys, no traceback."""
    text = outcome.out + outcome.err
    assert "Traceback" not in text, text
    assert "internal error" not in text, text
    odd = {c for c in text if (ord(c) < 32 and c != "\n") or 127 <= ord(c) < 160 or 0xD800 <= ord(c) < 0xE000}
    assert not odd, (odd, text)
    if outcome.status:
        assert outcome.err.startswith("phnn: "), outcome
        assert outcome.err.count("\n") == 1, outcome
        # A message names cause and remedy; it does not recite the file.
        assert 20 < len(outcome.err) < 3000, outcome
    if outcome.refused:
        assert not outcome.written, outcome


@pytest.fixture
def good(tmp_path: Path) -> Path:
    """A folder with one recording."""
    folder = tmp_path / "data"
    folder.mkdir()
    (folder / "a.csv").write_text(csv())
    return folder
