"""Warming up compiles what later calls use, so that they compile nothing."""

from __future__ import annotations

from collections.abc import Iterator
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


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[list[str]]]:
    """The commands of processes that are begun; none is. Nothing is kept."""
    commands: list[list[str]] = []
    monkeypatch.setattr(warm.subprocess, "Popen", lambda command, **_: commands.append(command) or mock.MagicMock())
    monkeypatch.setattr(warm, "has_kept", lambda function: False)
    warm.begin_elsewhere.cache_clear()
    yield commands
    warm.begin_elsewhere.cache_clear()


def test_later_kernels_are_compiled_once_in_another_process(begun: list[list[str]]) -> None:
    for _ in range(2):
        warm.begin_for_diagnosis()
    # Modules that lie in the working directory are not imported (-P).
    assert [command[1:] for command in begun] == [["-P", "-m", "phnn.warm", "sensitivities"]]


def test_what_is_kept_is_not_compiled_again(begun: list[list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(warm, "has_kept", lambda function: True)
    monkeypatch.setattr(warm, "warm_up", lambda names: pytest.fail(str(names)) if names else None)
    warm.compile_for_diagnosis(pytest.fail)
    assert not begun


def test_a_diagnosis_waits_for_what_another_process_compiles(
    begun: list[list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[str] = []
    looks = iter((False, False, True))
    monkeypatch.setattr(warm, "warm_up", order.extend)
    process = warm.begin_for_diagnosis()
    process.poll.return_value = None
    monkeypatch.setattr(warm, "has_kept", lambda function: function == "quick._steps" or next(looks))
    monkeypatch.setattr(warm.time, "sleep", lambda seconds: order.append("wait"))
    warm.compile_for_diagnosis(order.append)
    assert order == ["compile the simulation, once on this machine", "general steps", "wait"]


def test_a_diagnosis_goes_on_when_the_other_process_has_failed(
    begun: list[list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    monkeypatch.setattr(warm, "warm_up", done.extend)
    warm.begin_for_diagnosis().poll.return_value = 1
    warm.compile_for_diagnosis(str)
    assert done == ["steps", "general steps"]


def test_machine_code_is_found_where_it_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "_folder", lambda: tmp_path)
    (tmp_path / "integrate_1").mkdir()
    (tmp_path / "integrate_1" / "general._steps-35.py311.nbi").touch()
    # The index alone is written before the machine code.
    assert not cache.has_kept("general._steps")
    (tmp_path / "integrate_1" / "general._steps-35.py311.1.nbc").touch()
    assert cache.has_kept("general._steps")
    assert not cache.has_kept("quick._steps")
    monkeypatch.setattr(cache, "_folder", lambda: None)
    assert cache.has_kept("quick._steps")


def test_parts_are_kept_under_their_names() -> None:
    warm_up()
    assert all(warm.is_kept(name) for name in warm.PARTS)


def test_a_machine_that_starts_no_process_compiles_when_it_has_to(
    begun: list[list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError("no more processes")

    done: list[str] = []
    monkeypatch.setattr(warm, "warm_up", done.extend)
    monkeypatch.setattr(warm.subprocess, "Popen", refuse)
    assert warm.begin_for_diagnosis() is None
    warm.compile_for_diagnosis(str)
    assert done == ["steps", "general steps"]
