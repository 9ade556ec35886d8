"""What is used of other packages beyond what they document is there, and without it the steps are the same."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import torch

import phnn
from phnn.integrate import hooks, ode
from phnn.integrate.compiled_method import sampled_states
from phnn.models.actuator import hrc
from phnn.network import PortHamiltonianSystem

_PRIVATE = re.compile(r"torchdiffeq\._impl|numba\.(core|_)|_nrt\b|getclosurevars")


def test_private_parts_are_there_and_used_in_two_files() -> None:
    assert hooks.takes_methods(), "gone from torchdiffeq: adapt phnn.integrate.hooks, or bound its version"
    root = Path(phnn.__file__).parent
    using = {p.relative_to(root).as_posix() for p in root.rglob("*.py") if _PRIVATE.search(p.read_text())}
    assert using == {"integrate/hooks.py", "integrate/cache.py"}


def gradient(states: torch.Tensor, system: PortHamiltonianSystem) -> list[torch.Tensor]:
    return list(torch.autograd.grad(states[-1].sum(), list(system.parameters())))


def test_without_torchdiffeqs_methods_the_steps_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    system, t = PortHamiltonianSystem(hrc(1)), torch.linspace(0.0, 2e-4, 5, dtype=torch.float64)
    x0 = torch.full((3,), 1e-6, dtype=torch.float64)
    u = torch.zeros(4, len(system.network.ports), dtype=torch.float64)
    h, nodes = t.diff(), torch.arange(5)

    def everything() -> list[torch.Tensor]:
        one = ode.odeint(system, x0, t, "discrete_gradient", adjoint=True)
        (two,) = sampled_states(system, [u], [h], [nodes], x0[None])
        return [one.detach(), *gradient(one, system), two.detach(), *gradient(two, system)]

    known = everything()
    monkeypatch.setattr(hooks, "part", lambda name: None)
    assert not hooks.takes_methods()
    for a, b in zip(known, everything(), strict=True):
        torch.testing.assert_close(a, b, rtol=1e-12, atol=1e-12 * float(a.abs().max()))
