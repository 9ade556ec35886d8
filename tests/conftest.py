"""What every test shares: one torch thread, so that timings and results do not depend on the machine's load; a
collector of garbage that leaves alone what was there before the first test; the noise floors of recordings; a disk."""

from __future__ import annotations

import gc
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

_FLOORS: dict[tuple[object, ...], Any] = {}


@pytest.fixture(scope="module", autouse=True)
def _same_noise() -> Iterator[None]:
    """The noise of the same samples, which takes most of the time of a reading, is estimated once."""
    # Only where a test module has loaded the reader already.
    draft = sys.modules.get("phnn.recordings.draft")
    if draft is None:
        yield
        return
    estimated = draft.noise_floor

    def once(u: Any, y: Any, *others: object) -> Any:
        key = (sha256(u.tobytes()).digest(), sha256(y.tobytes()).digest(), *others)
        if key not in _FLOORS:
            _FLOORS[key] = estimated(u, y, *others)
        return _FLOORS[key]

    with mock.patch.object(draft, "noise_floor", once):
        yield


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    # Only where a test module has loaded torch already: the command line's tests must not pay for it.
    torch = sys.modules.get("torch")
    if torch is not None:
        torch.set_num_threads(1)


def pytest_collection_finish() -> None:
    # Half a million objects of libraries and tests; to look through them again and again took a twentieth of the time.
    gc.collect()
    gc.freeze()


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Callable[[str], Path]]:
    """Gives a folder that is a disk of its own, of the given options, or changes the options of that disk."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = []

    def with_options(options: str) -> Path:
        command = ["mount", "-t", "tmpfs", "-o", ("remount," if mounted else "") + options, "none", str(folder)]
        if shutil.which("mount") is None or subprocess.run(command, capture_output=True).returncode:
            pytest.skip("no rights to mount a small disk")
        mounted.append(options)
        return folder

    yield with_options
    if mounted:
        subprocess.run(["umount", str(folder)], check=True)
