"""What every attack shares: what is written into a folder, one command in this process, and what must hold after it."""

from __future__ import annotations

import hashlib
import io
import os
import resource
import shutil
import stat
import sys
import time
import warnings
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from phnn.cli import main
from phnn.configuration import config_folder
from phnn.integrate.kernel import march
from phnn.integrate.program import compile_network
from phnn.models import hrc
from phnn.models.store import save
from phnn.setup import Setup

LONGEST_S = 10.0
# Bytes of memory beyond twice the size of the input.
MEMORY = 10**9
REFUSED = 2
# Names of commands that take --out.
WITH_OUT = ("predict", "identify", "diagnose", "compare", "modes")
# Stands in the environment, and in a file that is no input: neither is ever printed.
SECRETS = ("swordfish", "root:")
# Names of the files that are opened while a command runs; nothing while none does.
OPENED: list[list[str]] = []
ROOT = Path(__file__).resolve().parents[2]
# Installed code, what it compiled, and what the system tells of itself: any command may open these.
CACHE = os.environ.get("PHNN_CACHE_DIR") or Path.home() / ".cache"
SYSTEM = ("/dev/null", "/proc", "/sys/fs/cgroup", "/usr/share/zoneinfo")
OPEN_TO_ALL = (sys.prefix, sys.base_prefix, ROOT, CACHE, *SYSTEM, *sys.path[1:])
HEADER = "time_s,voltage_V,displacement_m"
GIVEN = (config_folder() / "network" / "mass_spring_damper.yaml").read_text(encoding="utf-8")
# What is driven is the voltage; what it is about is left out.
NETWORK = GIVEN.replace("unit: N}", "unit: V}").partition("\n")[2]


def often(count: int) -> settings:
    """Return settings for so many examples, each with fixtures that a test clears itself."""
    unsuited = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.data_too_large]
    return settings(max_examples=count, deadline=None, derandomize=True, suppress_health_check=unsuited)


def quick(first: Iterable[str], *others: str) -> list[Any]:
    """Return parameters of a test of which only the first run in the fast suite."""
    return [*first, *(pytest.param(other, marks=pytest.mark.slow) for other in others)]


def rows(table: Mapping[str, Iterable[Any]]) -> list[Any]:
    """Return words of the refusal and an input, once for each input of a table by these words."""
    return [
        pytest.param(words, one, id=f"{words or 'passes'}-{one if isinstance(inputs, Mapping) else number}")
        for words, inputs in table.items()
        for number, one in enumerate(inputs)
    ]


def put(path: Path, content: str | bytes) -> None:
    """Write a file with this content."""
    path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass"))


def zipped(*members: tuple[str, bytes]) -> bytes:
    """Return an archive of these members, whose names may be the same."""
    with zipfile.ZipFile(file := io.BytesIO(), "w") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, content in members:
            archive.writestr(name, content)
    return file.getvalue()


def table(samples: int = 120) -> np.ndarray:
    """Return (N, 3) time [s], voltage [V] and displacement [m] of a recording in which nothing is wrong."""
    t = 1e-3 * np.arange(samples)
    u = 50.0 * np.sin(2.0 * np.pi * 40.0 * t)
    y = 1e-6 * (0.9 * u + 2e-3 * u**2) + 20e-9 * np.random.default_rng(0).standard_normal(samples)
    return np.column_stack([t, u, y])


def csv(values: np.ndarray | None = None, header: str = HEADER) -> str:
    """Return the recording as text."""
    values = table() if values is None else values
    return "\n".join([header, *(",".join(repr(float(v)) for v in row) for row in values)]) + "\n"


def seen(root: Path) -> dict[Path, str]:
    """Return kind, size and hash of everything below a folder; of sparse and special files no content."""
    found = {}
    for path in sorted(root.rglob("*")):
        state = path.lstat()
        small = stat.S_ISREG(state.st_mode) and max(state.st_blocks * 512, state.st_size) <= 2**26
        content = hashlib.sha256(path.read_bytes()).hexdigest() if small else ""
        found[path] = f"{state.st_mode:o} {state.st_size} {state.st_mtime_ns} {content}"
    return found


def inside(path: str, folders: Iterable[Any]) -> bool:
    """Tell whether a file is one of these, or lies in one of them."""
    real = Path(os.path.realpath(path))
    allowed = {Path(os.path.realpath(one)) for one in folders if "\0" not in str(one)}
    return not allowed.isdisjoint((real, *real.parents))


def peak() -> int:
    """Return the largest resident size of this process so far, bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


class Outcome(NamedTuple):
    """Exit status, what was printed, and the names of what was written or changed below --out."""

    status: int
    out: str
    err: str
    written: tuple[str, ...]


@dataclass
class Attack:
    """A folder ``data`` with one recording below ``root``, and the commands that are run on it or another folder."""

    root: Path
    captured: pytest.CaptureFixture[str]

    @property
    def data(self) -> Path:
        return self.root / "data"

    def only(self, name: str, content: str | bytes) -> None:
        """Put this file in the place of the recording."""
        (self.data / "a.csv").unlink(missing_ok=True)
        put(self.data / name, content)

    def __call__(
        self, command: str = "check", *more: str, said: str | bytes | None = None, words: str | None = None,
        folder: Path | str | None = None, model: Path | str | None = None, manifest: Path | None = None,
        out: Path | None = None, kept: bool = False, statuses: tuple[int, ...] = (),
    ) -> Outcome:  # fmt: skip
        """Run a command and check what must hold after any input.

        Args:
            more: further arguments; said: content of the manifest of ``data``, as it is where nothing is given.
            words: of the refusal; none where the input has to pass, ``None`` where either is right.
            model: of predict, a good one where none is there; out, kept: where to write, and whether what an earlier
                run wrote there stays; statuses: others that are accepted.
        """
        if said is not None:
            put(self.data / "recordings.yaml", said)
        # Where somebody else's folder is given, a lock may be left in it.
        unseen, out = ("" if out is None else ".phnn"), out or self.root / "out"
        if not kept:
            shutil.rmtree(self.root / "out", ignore_errors=True)
        given = [self.data if folder is None else folder, *(["--manifest", manifest] if manifest is not None else [])]
        given += ["--out", out] if command in WITH_OUT else []
        if command == "predict":
            if not (self.root / "model").exists():
                save(Setup(hrc(1)), self.root / "model", 1)
            given.insert(0, model or self.root / "model")
        if command == "train":
            given = [f"folder={self.data}", f"out={out}"]
        values = [argument.partition("=")[2] for argument in (*map(str, given), *more) if "=/" in argument]
        before, memory = seen(self.root), peak()
        size = sum(p.lstat().st_blocks * 512 for p in before)
        self.captured.readouterr()
        began = time.perf_counter()
        OPENED.append(opened := [])
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            status = main([command, *map(os.fspath, given), *more])
        OPENED.clear()
        seconds, (shown, err), after = time.perf_counter() - began, self.captured.readouterr(), seen(self.root)
        beyond, text = peak() - memory - 2 * size, shown + err
        changed = [p for p in sorted({*before, *after} - {out}) if before.get(p) != after.get(p)]
        changed = [p for p in changed if unseen not in p.parts]
        strange = [p for p in changed if out not in p.parents]
        assert not strange, f"an input was changed, or something was written beside --out: {strange}"
        strange = [p for p in opened if not (p.isdigit() or inside(p, (*OPEN_TO_ALL, *given, *values)))]
        assert "--allow-outside" in more or not strange, f"opened outside of what was given: {strange}"
        outcome = Outcome(status, shown, err, tuple(p.relative_to(out).as_posix() for p in changed))
        assert "Traceback" not in text and "internal error" not in text, text
        # Nothing that a terminal obeys.
        odd = {c for c in text if (ord(c) < 32 and c != "\n") or 127 <= ord(c) < 160 or 0xD800 <= ord(c) < 0xE000}
        assert not odd, (odd, text)
        if status:
            assert err.startswith("phnn: ") and err.count("\n") == 1, outcome
            # A message names cause and remedy; it does not recite the file.
            assert 20 < len(err) < 3000, outcome
        assert status != REFUSED or not outcome.written, outcome
        # A manifest that the user names is quoted where it is wrong.
        quoted = manifest is not None or any(m.startswith("manifest=") for m in more)
        assert quoted or not any(secret in text for secret in SECRETS), outcome
        # On a terminal they would stand between the lines of the answer.
        assert not [str(w.message) for w in warned if issubclass(w.category, RuntimeWarning | UserWarning)]
        assert seconds < LONGEST_S, f"{seconds:.1f} s"
        assert beyond < MEMORY, f"{beyond / 1e6:.0f} MB beyond twice the size"
        accepted = (0, REFUSED) if words is None else (REFUSED,) if words else (0,)
        assert status in (*accepted, *statuses) and (status != REFUSED or (words or "") in err), outcome
        return outcome


@pytest.fixture(scope="session")
def compiled() -> None:
    """Compile the kernels before a time is taken, and note from then on what is opened while a command runs."""
    network = hrc(2)
    program, n = compile_network(network), len(network.storages)
    states, efforts, u = np.zeros((2, n)), np.zeros((1, n)), np.zeros((1, len(network.ports)))
    for general in (False, True):
        assert march(program, program.theta(network), states[0], u, np.full(1, 1e-3), states, efforts, general) == 1
    sys.addaudithook(lambda event, args: OPENED[-1].append(str(args[0])) if event == "open" and OPENED else None)


@pytest.fixture
def attack(
    compiled: None, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Iterator[Attack]:
    """Return a folder to attack: what runs in it would write beside it, where that is seen."""
    monkeypatch.setenv("PHNN_SECRET", SECRETS[0])
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").mkdir()
    for name in ("outside.csv", "data/a.csv"):
        put(tmp_path / name, csv())
    yield Attack(tmp_path, capsys)
    for path in tmp_path.rglob("*"):
        if not path.is_symlink():
            path.chmod(0o700)
