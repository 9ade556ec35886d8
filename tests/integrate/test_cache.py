"""Kept machine code: found again, and neither damaged nor planted files break or run anything."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

# What is imported, and numba's own start, is the same for all runs: each is a fork behind them.
_SCRIPT = """
import os, sys, warnings
warnings.simplefilter("always")
from phnn.integrate.cache import compiled
from cached_function import double
for _ in range(int(sys.argv[1])):
    if child := os.fork():
        assert os.waitpid(child, 0)[1] == 0
        continue
    f = compiled(double)
    print(f(21.0), sum(f.stats.cache_hits.values()) if f.stats else 0, flush=True)
    os._exit(0)
"""


def run(home: Path, cache: Path | None, times: int = 1) -> tuple[list[str], str]:
    """Compile and call a function in another process, once or several times: what it prints, and its warnings."""
    home.mkdir(exist_ok=True)
    (home / "cached_function.py").write_text("def double(x):\n    return 2.0 * x\n")
    # A stamp in whole seconds: numba takes sources that were written anew for others.
    os.utime(home / "cached_function.py", (1e9, 1e9))
    given = {k: v for k, v in os.environ.items() if k not in ("PHNN_CACHE_DIR", "XDG_CACHE_HOME", "HOME")}
    given |= {"PYTHONPATH": f"{home}:{Path(__file__).parents[2]}"}
    if cache is not None:
        given["PHNN_CACHE_DIR"] = str(cache)
    command = [sys.executable, "-c", _SCRIPT, str(times)]
    done = subprocess.run(command, env=given, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.split(), done.stderr


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ``home`` and the ``cache`` that a first process has filled."""
    made = tmp_path_factory.mktemp("kept")
    assert run(made / "home", made / "cache")[0] == ["42.0", "0"]
    return made


@pytest.fixture
def filled(kept: Path, tmp_path: Path) -> tuple[Path, Path]:
    """That home, and a copy of its cache."""
    shutil.copytree(kept / "cache", tmp_path / "cache")
    return kept / "home", tmp_path / "cache"


def test_machine_code_is_found_again(filled: tuple[Path, Path]) -> None:
    home, cache = filled
    assert run(home, cache)[0] == ["42.0", "1"]
    for path in (cache / "phnn", *(cache / "phnn").iterdir()):
        assert path.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("seed", [0, 1, 2, pytest.param(3, marks=pytest.mark.slow)])
def test_damaged_files_count_as_absent(filled: tuple[Path, Path], seed: int) -> None:
    home, cache = filled
    rng = np.random.default_rng(seed)
    files = [p for p in cache.rglob("*.nb?") if p.is_file()]
    assert len(files) == 2
    for path in files:
        content = bytearray(path.read_bytes())
        if seed == 0:
            content = content[: len(content) // 2]
        elif seed == 1:
            content = bytearray(b"cos\nsystem\n(S'echo planted >&2'\ntR.")
        else:
            for place in rng.integers(len(content), size=3):
                content[place] ^= 1 + int(rng.integers(255))
        path.write_bytes(bytes(content))
    printed, told = run(home, cache, times=2)
    assert printed == ["42.0", "0", "42.0", "1"] and "planted" not in told


def test_a_cache_that_others_can_write_to_is_not_used(filled: tuple[Path, Path]) -> None:
    home, cache = filled
    (cache / "phnn").chmod(0o777)
    printed, told = run(home, cache)
    assert printed == ["42.0", "0"] and "others may write to it" in told
    (cache / "phnn").chmod(0o700)
    cache.chmod(0o777)
    assert "others may replace it" in run(home, cache)[1]


def test_without_a_place_functions_are_compiled_in_memory(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    printed, told = run(tmp_path / "home", tmp_path / "file")
    assert printed == ["42.0", "0"] and "compiled code is not kept" in told


def test_a_mask_that_lets_a_group_write_does_no_harm(tmp_path: Path) -> None:
    before = os.umask(0o002)
    try:
        assert run(tmp_path / "home", tmp_path / "new" / "cache", times=2)[0] == ["42.0", "0", "42.0", "1"]
    finally:
        os.umask(before)
