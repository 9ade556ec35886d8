"""Warming up compiles what later calls use, so that they compile nothing."""

from __future__ import annotations

from pathlib import Path
from unittest import mock

import campaigns
import numpy as np
import pytest

from phnn import warm
from phnn.derivatives import output_derivatives, output_gradient
from phnn.integrate import cache, general, quick, sweep
from phnn.models.actuator import hrc
from phnn.models.neural import LearnedLaws, neural_hrc
from phnn.models.variants import hrcl
from phnn.network.elements import Network
from phnn.setup import Setup
from phnn.simulate import simulate
from phnn.warm import warm_up

KERNELS = {
    "march": general._compiled,
    "quick march": quick._compiled,
    "sensitivities": sweep._sensitivities,
    "adjoint": sweep._adjoint,
}


@pytest.mark.parametrize(
    "network", [hrc(2), neural_hrc(1, LearnedLaws(3)), hrcl(1).network()], ids=["hrc", "neural", "hrcl"]
)
def test_nothing_is_left_to_compile(network: Network) -> None:
    warm_up()
    known = {name: list(function.signatures) for name, function in KERNELS.items()}
    assert all(known.values())
    t = np.arange(21) * 1e-4
    recording = campaigns.recorded(Setup(network), "sine", t, 5.0 * np.sin(300.0 * t), 1e-9, 0)
    trajectory = simulate(Setup(network), recording)
    names = [name for name, p in network.parameters.items() if not p.fixed]
    output_derivatives(trajectory, names, (0,), np.ones((20, 1)), [(names[0], np.ones(20))])
    output_gradient(trajectory, names, np.ones(21))
    assert {name: list(function.signatures) for name, function in KERNELS.items()} == known


def test_later_kernels_are_compiled_once_in_another_process(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[list[str]] = []
    monkeypatch.setattr(warm.subprocess, "Popen", lambda command, **_: begun.append(command) or mock.Mock())
    monkeypatch.setattr(warm, "has_kept", lambda module: True)
    warm.compile_later_kernels.cache_clear()
    warm.compile_later_kernels()
    assert not begun
    warm.compile_later_kernels.cache_clear()
    monkeypatch.setattr(warm, "has_kept", lambda module: False)
    for _ in range(2):
        warm.compile_later_kernels()
    # Modules that lie in the working directory are not imported (-P).
    assert [command[1:] for command in begun] == [["-P", "-m", "phnn.warm", "later"]]


def test_machine_code_is_found_where_it_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "_folder", lambda: tmp_path)
    assert not cache.has_kept("general")
    (tmp_path / "integrate_1").mkdir()
    (tmp_path / "integrate_1" / "general._steps-35.py311.nbi").touch()
    assert cache.has_kept("general")
    assert not cache.has_kept("quick")
    monkeypatch.setattr(cache, "_folder", lambda: None)
    assert cache.has_kept("general")


def test_a_machine_that_starts_no_process_compiles_when_it_has_to(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError("no more processes")

    monkeypatch.setattr(warm, "has_kept", lambda module: False)
    monkeypatch.setattr(warm.subprocess, "Popen", refuse)
    warm.compile_later_kernels.cache_clear()
    warm.compile_later_kernels()
