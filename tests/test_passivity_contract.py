"""Passivity after training: whatever an optimiser does to a law, a learned law or a model, the structure holds."""

from __future__ import annotations

import inspect
from itertools import product

import pytest
import torch
from attacks import OBJECTIVES, OPTIMISERS, REACH, train, violations
from subjects import CORE, EVERY, Subject, laws, learned, learned_together
from torch import nn

import phnn.nn.one_ports
from phnn.errors import SolverFailed
from phnn.laws.wide import WIDE_RESISTORS, WIDE_STORAGES
from phnn.models.store import _KINDS
from phnn.network.bounded import BoundedParameters

both = pytest.mark.parametrize("dtype", [torch.float64, torch.float32], ids=["float64", "float32"])
optimisers = pytest.mark.parametrize("optimiser", OPTIMISERS)
FAST = [name for name, _ in (*CORE, *learned(), *learned_together())] + ["from_paper", "motor", "neural_hrc"]


def trained(name: str, dtype: torch.dtype, optimiser: str, kind: str, steps: int) -> None:
    """Train a subject, and count what is violated at many states.

    A weight that an optimiser has carried beyond use is refused by name wherever the model is evaluated.
    """
    subject = EVERY[name]()
    subject.module.to(dtype)
    said = train(subject, optimiser, kind, steps)
    if not said:
        try:
            found = violations(subject, 10_000 if steps > 100 else 1000)
        except SolverFailed as error:
            said = str(error)
        else:
            assert not found, found
    if said:
        assert "the parameter" in said, said
        assert "lower the rate of learning" in said, said


def test_every_learned_law_is_among_the_subjects() -> None:
    assert set(_KINDS) == set(WIDE_RESISTORS) | set(WIDE_STORAGES)
    modules = [c for _, c in inspect.getmembers(phnn.nn.one_ports, inspect.isclass) if issubclass(c, nn.Module)]
    assert set(modules) == {type(make(2)) for make in _KINDS.values()}


class _Finite(nn.Module):
    """Which numbers of a subject are finite at states as large as 32 bits allow."""

    def __init__(self, subject: Subject) -> None:
        super().__init__()
        self.module, self.subject = subject.module, subject
        self.a, self.u = subject.states(200, 1, REACH[torch.float32])
        self.b, _ = subject.states(200, 2, REACH[torch.float32])

    def forward(self) -> torch.Tensor:
        m, a, b = self.module, self.a, self.b
        efforts = m.mean_efforts(a, b)
        power = efforts * self.subject.balanced_rate(efforts, 0.5 * (a + b), self.u)
        numbers = (m.energy(a), m.efforts(a), efforts, power, self.subject.lost(efforts, a))
        return torch.stack([torch.isfinite(v).all() for v in numbers])


@pytest.mark.parametrize("name", dict(laws()))
@torch.no_grad()
def test_no_end_of_the_ranges_of_parameters_leaves_32_bits(name: str) -> None:
    # Coordinates may end anywhere; values, and so energy, efforts and power, must fit into the numbers.
    subject = EVERY[name]()
    subject.module.to(torch.float32)
    finite = _Finite(subject)
    names = [
        f"{at}.z.{parameter}"
        for at, m in finite.named_modules()
        if isinstance(m, BoundedParameters)
        for parameter in m.z
    ]
    corners = torch.tensor(list(product((-1e30, 1e30), repeat=len(names))))

    def found_at(corner: torch.Tensor) -> torch.Tensor:
        return torch.func.functional_call(finite, dict(zip(names, corner.unbind(), strict=True)), ())

    # All corners at once: one by one they take five times as long.
    found = torch.func.vmap(found_at)(corners)
    assert found.shape == (2 ** len(names), 5)
    assert found.all(), corners[~found.all(-1)]


@both
@optimisers
@pytest.mark.parametrize("name", FAST)
def test_a_short_training_violates_nothing(name: str, dtype: torch.dtype, optimiser: str) -> None:
    trained(name, dtype, optimiser, "random", 10)


@pytest.mark.slow
@both
@optimisers
@pytest.mark.parametrize("kind", OBJECTIVES)
@pytest.mark.parametrize("name", EVERY)
def test_a_long_training_violates_nothing(name: str, dtype: torch.dtype, optimiser: str, kind: str) -> None:
    trained(name, dtype, optimiser, kind, 200)
