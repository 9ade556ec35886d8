"""Disks that are full, fill up during the work or may not be written to: one message, and nothing lost."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import campaigns
import numpy as np
import pandas as pd
import pytest

from phnn.cli import main
from phnn.models.store import save
from phnn.results import claim

MARK = "INCOMPLETE.txt"
SAMPLES = 15_000


def mount(*arguments: str) -> bool:
    """Whether a file system could be mounted; that needs rights."""
    return (
        shutil.which("mount") is not None and not subprocess.run(["mount", *arguments], capture_output=True).returncode
    )


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Callable[[str], Path]]:
    """Gives a folder on a disk of its own, of the given options, or changes the options of that disk."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = []

    def with_options(options: str) -> Path:
        again = "remount," if mounted else ""
        if not mount("-t", "tmpfs", "-o", again + options, "none", str(folder)):
            pytest.skip("no rights to mount a small disk")
        mounted.append(options)
        return folder / "out"

    yield with_options
    if mounted:
        subprocess.run(["umount", str(folder)], check=True)


def made(folder: Path, recordings: int) -> Path:
    """Two models, recordings of which predictions take some 0.6 MB each, and those predictions."""
    setup = campaigns.base().setup
    save(setup, folder / "model", 1)
    save(setup.with_values({"k": 1.1 * setup.values()["k"]}), folder / "other", 1)
    (folder / "rec").mkdir()
    t = np.arange(SAMPLES) * 1e-4
    for k in range(recordings):
        table = pd.DataFrame({"time_s": t, "voltage_V": 5.0 * np.sin(2 * np.pi * (20 + k) * t)})
        table.to_csv(folder / "rec" / f"r{k:02d}.csv", index=False)
    for model in ("model", "other"):
        assert predict(folder, model, folder / f"of_{model}") == 0
    return folder


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Predictions of 1.8 MB."""
    return made(tmp_path_factory.mktemp("disks"), 3)


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Predictions of 9 MB."""
    return made(tmp_path_factory.mktemp("disks"), 16)


def predict(home: Path, model: str, out: Path) -> int:
    return main(["predict", str(home / model), str(home / "rec"), "--out", str(out)])


def seen(folder: Path) -> dict[str, bytes]:
    """Content of all files but phnn's own notes and index."""
    found = (p for p in sorted(folder.rglob("*")) if p.is_file() and ".phnn" not in p.parts and p.name != "index.html")
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in found}


def told(capsys: pytest.CaptureFixture[str]) -> str:
    """The one message."""
    text = capsys.readouterr().err
    assert text.startswith("phnn: ") and text.count("\n") == 1, text
    return text


@pytest.mark.parametrize("size", [1, 2, 4])
def test_a_disk_without_room_is_met_before_the_work(
    home: Path, disk: Callable[[str], Path], size: int, capsys: pytest.CaptureFixture[str]
) -> None:
    out = disk(f"size={size}m")
    assert predict(home, "model", out) == 2
    assert "MiB of disk are free" in told(capsys)
    assert not out.exists() or not seen(out)


def filled_up(
    home: Path, disk: Callable[[str], Path], size: int, capsys: pytest.CaptureFixture[str], patch: pytest.MonkeyPatch
) -> None:
    """A prediction on a disk too small for it, and once more after the disk has grown."""
    out, wanted = disk(f"size={size}m"), seen(home / "of_model")
    capsys.readouterr()
    with patch.context() as m:
        m.setattr(sys.modules[claim.__module__], "_LEAST_FREE", 0)
        assert predict(home, "model", out) == 1
    assert "the disk is full" in told(capsys)
    left = seen(out)
    assert MARK in left
    # What is there is whole.
    assert all(left[name] == wanted[name] for name in left if name != MARK)
    assert not list(out.rglob("*.part"))
    disk("size=64m")
    assert predict(home, "model", out) == 0
    assert seen(out) == wanted


def test_a_disk_that_fills_up_loses_nothing(
    home: Path, disk: Callable[[str], Path], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    filled_up(home, disk, 1, capsys, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("size", [2, 4, 8])
def test_a_larger_disk_that_fills_up_loses_nothing(
    large: Path, disk: Callable[[str], Path], size: int, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    filled_up(large, disk, size, capsys, monkeypatch)


def test_earlier_results_stay_whole_on_a_disk_that_fills_up(
    home: Path, disk: Callable[[str], Path], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = disk("size=64m")
    old, new = seen(home / "of_other"), seen(home / "of_model")
    assert predict(home, "other", out) == 0
    filler = out.parent / "filler"
    free = shutil.disk_usage(out).free
    filler.write_bytes(bytes(free - 2**18))
    capsys.readouterr()
    with monkeypatch.context() as m:
        m.setattr(sys.modules[claim.__module__], "_LEAST_FREE", 0)
        assert predict(home, "model", out) == 1
    assert "the disk is full" in told(capsys)
    left = seen(out)
    assert set(left) - {MARK} == set(old) and MARK in left
    assert all(left[name] in (old[name], new[name]) for name in old)
    filler.unlink()
    assert predict(home, "model", out) == 0
    assert seen(out) == new


def test_a_disk_that_may_not_be_written_to_is_met_before_the_work(
    home: Path, disk: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    out = disk("size=64m")
    disk("ro")
    assert predict(home, "model", out) == 2
    assert "choose another folder" in told(capsys)


def test_a_folder_in_which_another_run_writes_is_met_before_the_work(
    home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with claim(tmp_path / "out", "diagnose"):
        assert predict(home, "model", tmp_path / "out") == 2
        assert "another run of phnn writes there" in told(capsys)
    assert predict(home, "model", tmp_path / "out") == 0
