"""Kept machine code: found again, for the same sources only, and no damaged file or full disk breaks anything."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from unittest import mock

import campaigns
import numba
import numpy as np
import pytest

import phnn
from phnn.configuration import config_folder
from phnn.derivatives import compile_all, output_derivatives
from phnn.integrate import cache, sweep
from phnn.models.actuator import hrc
from phnn.models.network_file import load_network
from phnn.models.neural import LearnedLaws, neural_hrc
from phnn.network.elements import Network
from phnn.setup import Setup
from phnn.trajectory import simulate

_TWICE = """
import sys
from phnn.integrate.cache import compiled
from kept_function import double
f = compiled(double)
print(f(21.0), sum(f.stats.cache_hits.values()))
"""
_KERNEL = """
from phnn.derivatives import compile_all
from phnn.integrate import sweep
compile_all()
print(sum(sweep.sensitivity_steps.stats.cache_misses.values()))
"""


def begun(script: str, **surroundings: str) -> subprocess.Popen[str]:
    given = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])} | surroundings
    return subprocess.Popen([sys.executable, "-c", script], env=given, stdout=subprocess.PIPE, text=True)


def printed(process: subprocess.Popen[str]) -> list[str]:
    out = process.communicate()[0]
    assert process.returncode == 0
    return out.split()


def double(x: float) -> float:
    return 2.0 * x


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder for kept machine code."""
    monkeypatch.setattr(cache, "_folder", lambda: tmp_path)
    return tmp_path


def hits() -> int:
    """Return how often a new compiled function took its machine code from the folder."""
    function = cache.compiled(double)
    assert function(21.0) == 42.0
    return sum(function.stats.cache_hits.values())


def test_of_two_processes_at_once_one_compiles_and_the_other_waits(tmp_path: Path) -> None:
    (tmp_path / "kept_function.py").write_text("def double(x):\n    return 2.0 * x\n")
    path = f"{tmp_path}:{Path(__file__).parents[2]}"
    processes = [begun(_TWICE, PYTHONPATH=path, PHNN_CACHE_DIR=str(tmp_path)) for _ in range(2)]
    assert sorted(printed(p) for p in processes) == [["42.0", "0"], ["42.0", "1"]]
    assert (tmp_path / "phnn").stat().st_mode & 0o777 == 0o700


def test_a_second_process_compiles_no_kernel() -> None:
    compile_all()
    assert printed(begun(_KERNEL)) == ["0"]


@pytest.mark.parametrize("damage", ["empty", "half", "text"])
@pytest.mark.parametrize("kind", ["nbi", "nbc"])
def test_a_damaged_file_is_compiled_again(folder: Path, kind: str, damage: str) -> None:
    assert [hits(), hits()] == [0, 1]
    (file,) = folder.rglob(f"*.{kind}")
    content = file.read_bytes()
    file.write_bytes({"empty": b"", "half": content[: len(content) // 2], "text": b"no pickle"}[damage])
    assert [hits(), hits()] == [0, 1]


def test_without_a_folder_functions_are_compiled_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "phnn").touch()
    monkeypatch.setenv("PHNN_CACHE_DIR", str(tmp_path))
    with pytest.warns(UserWarning, match="compiled code is not kept in .*; set PHNN_CACHE_DIR"):
        assert cache._folder.__wrapped__() is None
    monkeypatch.setattr(cache, "_folder", lambda: None)
    assert [hits(), hits()] == [0, 0]


def test_a_folder_that_takes_no_files_costs_a_warning(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    function = cache.compiled(double)
    shutil.rmtree(function.stats.cache_path)
    Path(function.stats.cache_path).touch()
    with pytest.warns(UserWarning, match="compiled code is not kept in"):
        assert function(21.0) == 42.0
    # Where its folder does not serve, numba would write beside the sources, whatever their version.
    assert hits() == 0 and cache.compiled(double).stats.cache_path is None


@pytest.mark.parametrize("edited", ["laws/leaf.py", "integrate/program.py", "chain/delay.py"])
def test_an_edited_callee_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, edited: str) -> None:
    shutil.copytree(Path(phnn.__file__).parent, tmp_path / "phnn", ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(phnn, "__file__", str(tmp_path / "phnn" / "__init__.py"))
    before = cache.fingerprint.__wrapped__()
    assert cache.fingerprint.__wrapped__() == before
    (tmp_path / "phnn" / edited).write_text("# another source\n")
    assert cache.fingerprint.__wrapped__() != before


@pytest.mark.parametrize(
    "network",
    [hrc(2), neural_hrc(1, LearnedLaws(3)), load_network(config_folder() / "network/hrcl.yaml")],
    ids=["hrc", "neural", "hrcl"],
)
def test_derivatives_are_compiled_ahead_for_all_networks(network: Network) -> None:
    compile_all()
    known = list(sweep.sensitivity_steps.signatures)
    t = np.arange(21) * 1e-4
    recording = campaigns.recorded(Setup(network), "sine", t, 5.0 * np.sin(300.0 * t), 1e-9, 0)
    name = next(name for name, p in network.parameters.items() if not p.fixed)
    output_derivatives(simulate(Setup(network), recording), [name], (0,), np.ones((20, 1)), [(name, np.ones(20))])
    assert sweep.sensitivity_steps.signatures == known


@pytest.mark.parametrize("reason", ["", "kept", "own laws", "no process"])
def test_derivatives_are_compiled_elsewhere_where_they_are_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reason: str
) -> None:
    popen = mock.Mock(side_effect=OSError("no more processes") if reason == "no process" else None)
    monkeypatch.setattr(cache, "_folder", lambda: tmp_path)
    monkeypatch.setattr(cache, "registered_outside", lambda: ["a law"] if reason == "own laws" else [])
    if reason == "kept":
        (tmp_path / "integrate_1").mkdir()
        (tmp_path / "integrate_1" / "sweep.sensitivity_steps-35.py311.1.nbc").touch()
    monkeypatch.setattr(cache.atexit, "register", mock.Mock())
    monkeypatch.setattr(cache.subprocess, "Popen", popen)
    assert cache.compile_ahead.__wrapped__() is (reason != "kept")
    # Modules that lie in the working directory are not imported (-P).
    expected = [] if reason in ("kept", "own laws") else ["-P"]
    assert [call.args[0][1] for call in popen.call_args_list] == expected


def test_python_cannot_call_what_has_no_wrapper_for_it() -> None:
    inner = cache.inline(double)

    @numba.njit
    def outer(x: float) -> float:
        return inner(x)

    # Once it is compiled for these types, such a call would end the process.
    for _ in range(2):
        with pytest.raises(TypeError, match="double is called by compiled functions only: take its `py_func`"):
            inner(1.0)
        assert outer(21.0) == 42.0
    assert inner.py_func(1.0) == 2.0
