"""What is used of other packages beyond what they document is there, and without it everything still works."""

from __future__ import annotations

import re
from pathlib import Path

import numba
import pytest
import torch

import phnn
from phnn.integrate import hooks, ode
from phnn.integrate.cache import compiled
from phnn.integrate.compiled import inline
from phnn.integrate.compiled_method import sampled_states
from phnn.models.actuator import hrc
from phnn.network import PortHamiltonianSystem

_PRIVATE = re.compile(r"torchdiffeq\._impl|numba\.core|_nrt\b|_cache_file|getclosurevars")


def test_no_private_part_has_vanished() -> None:
    gone = hooks.missing()
    assert not gone, f"gone from numba or torchdiffeq: {gone}; adapt phnn.integrate.hooks, or bound their versions"


def test_private_parts_are_used_in_one_file() -> None:
    root = Path(phnn.__file__).parent
    found = {p.relative_to(root).as_posix() for p in root.rglob("*.py") if _PRIVATE.search(p.read_text())}
    assert found == {"integrate/hooks.py"}


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


def double(x: float) -> float:
    return 2.0 * x


def test_without_numbas_files_functions_are_compiled_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hooks, "part", lambda name: None)
    with pytest.warns(UserWarning, match="compiled code is not kept"):
        function = compiled(double)
    assert function(21.0) == 42.0
    assert not function.stats.cache_path


def test_python_cannot_call_what_has_no_wrapper_for_it() -> None:
    inner = inline(double)

    @numba.njit
    def outer(x: float) -> float:
        return inner(x)

    with pytest.raises(TypeError, match="double is called by compiled functions only"):
        inner(1.0)
    assert outer(21.0) == 42.0
    # Compiled for these types by now: without the guard this call would end the process.
    with pytest.raises(TypeError, match="take its `py_func`"):
        inner(1.0)
    assert inner.py_func(1.0) == 2.0


def test_loops_do_without_numbas_option(monkeypatch: pytest.MonkeyPatch) -> None:
    from numba.core import options

    hooks.loop_options.cache_clear()
    monkeypatch.delattr(options.DefaultOptions, "_nrt")
    assert hooks.loop_options() == {}
    assert hooks.missing() == ["numba option _nrt"]
    monkeypatch.undo()
    hooks.loop_options.cache_clear()
    assert hooks.loop_options() == {"_nrt": False}
