"""The compiled step inside torchdiffeq: the states of the march, and the gradients of the implicit function theorem."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import torchdiffeq
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import networks, random_states
from torch import Tensor
from torch.nn.functional import pad

from phnn.errors import InputRefused, StructureViolated
from phnn.integrate.compiled_method import COMPILED, COMPILED_ADJOINT, SampledRuns, sampled_states
from phnn.integrate.differentiable import simulate_torch
from phnn.integrate.method import METHOD
from phnn.integrate.program import compile_network
from phnn.models.actuator import from_paper
from phnn.models.neural import LearnedLaws, neural_hrc
from phnn.network import Network, PortHamiltonianSystem

torch.set_num_threads(1)

Runs = tuple[list[Tensor], list[Tensor], list[Tensor]]


def sines(steps: int = 60) -> Runs:
    """Inputs, steps and samples of one period of three sines: other rates, other lengths, other samples."""
    u, h, nodes = [], [], []
    for k, frequency in enumerate((1.0, 50.0, 150.0)):
        n = steps + 7 * k
        phase = 2.0 * np.pi * (torch.arange(n, dtype=torch.float64) + 0.5) / n
        u.append((70.0 * torch.sin(phase)).unsqueeze(-1))
        # Steps that change size, as they do after a jump of the input.
        h.append(torch.full((n,), 1.0 / frequency / n, dtype=torch.float64) * torch.where(phase < 1.0, 0.5, 1.0))
        nodes.append(torch.arange(0 if k else 3, n, 2 + k))
    return u, h, nodes


def with_ports(u: list[Tensor], system: PortHamiltonianSystem) -> list[Tensor]:
    return [pad(v, (0, len(system.network.ports) - 1)) for v in u]


def gradients(states: list[Tensor], system: PortHamiltonianSystem, x0: Tensor) -> dict[str, Tensor]:
    """Of a loss that weighs every sample differently, each state in its own units."""
    system.zero_grad()
    random = torch.Generator().manual_seed(4)
    loss = sum(
        (
            torch.randn(x.shape, dtype=torch.float64, generator=random) * x / x.detach().abs().amax(0).clamp_min(1e-30)
        ).sum()
        for x in states
    )
    assert isinstance(loss, Tensor)
    (by_x0,) = torch.autograd.grad(loss, x0, retain_graph=True)
    loss.backward()
    return {"x0": by_x0} | {n: p.grad.clone() for n, p in system.named_parameters() if p.grad is not None}


def compare(system: PortHamiltonianSystem, x0: Tensor, runs: Runs, tolerance: float) -> None:
    u, h, nodes = runs
    u = with_ports(u, system)
    start = x0.clone().requires_grad_(True)
    direct = [simulate_torch(system, *r)[n] for r, n in zip(zip(u, h, start, strict=True), nodes, strict=True)]
    expected = gradients(direct, system, start)
    for adjoint in (True, False):
        start = x0.clone().requires_grad_(True)
        states = sampled_states(system, u, h, nodes, start, adjoint)
        assert all(torch.equal(a, b) for a, b in zip(states, direct, strict=True))
        found = gradients(states, system, start)
        for name, value in expected.items():
            assert (found[name] - value).abs().max() <= tolerance * value.abs().max(), (name, adjoint)
        assert all(not found[name].any() for name in found.keys() - expected.keys())


@pytest.mark.parametrize("kind", ["dead zones", "learned"])
def test_states_and_gradients_are_those_of_the_exact_sweep(kind: str) -> None:
    network = from_paper() if kind == "dead zones" else neural_hrc(2, LearnedLaws(5))
    system = PortHamiltonianSystem(network)
    # 1.2e-6 m of displacement, so that all states and their gradients matter.
    x0 = torch.zeros(3, 4, dtype=torch.float64)
    x0[:, network.storage_names.index("q")] = 1.2e-6
    compare(system, x0, sines(), 1e-8)


@settings(max_examples=6, deadline=None)
@given(networks(monotone=True), st.integers(0, 10**6))
def test_gradients_of_any_network_are_those_of_the_exact_sweep(network: Network, seed: int) -> None:
    try:
        compile_network(network)
    except StructureViolated:
        return
    system = PortHamiltonianSystem(network)
    x0 = torch.from_numpy(random_states(network, seed, 2)[0])
    u = [torch.sin(torch.arange(12 + 3 * k, dtype=torch.float64)).unsqueeze(-1) for k in range(2)]
    h = [torch.full((v.shape[0],), 0.05 * (1 + k), dtype=torch.float64) for k, v in enumerate(u)]
    nodes = [torch.tensor([0, 4, 9]), torch.tensor([2, 15])]
    if network.ports:
        compare(system, x0, (u, h, nodes), 1e-8)


def test_gradients_agree_with_finite_differences() -> None:
    system, (u, h, nodes) = PortHamiltonianSystem(from_paper()), sines(40)
    u, x0 = with_ports(u, system), torch.zeros(3, 4, dtype=torch.float64)
    at = system.state_names.index("q")

    def loss() -> Tensor:
        return sum((1e10 * x[:, at].square().sum() for x in sampled_states(system, u, h, nodes, x0)), torch.zeros(()))

    loss().backward()
    for name, parameter in system.named_parameters():
        ends = []
        for sign in (1.0, -1.0):
            with torch.no_grad():
                parameter.add_(sign * 1e-5)
                ends.append(float(loss()))
                parameter.sub_(sign * 1e-5)
        assert parameter.grad is not None
        assert float(parameter.grad) == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-4, abs=1e-5), name


def test_a_graph_that_is_kept_is_gone_back_over_again() -> None:
    system, (u, h, nodes) = PortHamiltonianSystem(from_paper()), sines(20)
    states = sampled_states(system, with_ports(u, system), h, nodes, torch.zeros(3, 4, dtype=torch.float64))
    loss = sum((x.square().sum() for x in states), torch.zeros(()))
    first = torch.autograd.grad(loss, list(system.parameters()), retain_graph=True)
    again = torch.autograd.grad(loss, list(system.parameters()))
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))


def test_long_marches_are_differentiated_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    system = PortHamiltonianSystem(from_paper())
    monkeypatch.setattr("phnn.integrate.compiled_method._STEPS", 13)
    compare(system, torch.zeros(3, 4, dtype=torch.float64), sines(), 1e-8)


def test_what_cannot_be_integrated_is_refused() -> None:
    system, (u, h, nodes) = PortHamiltonianSystem(from_paper()), sines(20)
    runs = SampledRuns(system, with_ports(u, system), h, nodes)
    start = runs.start(torch.zeros(3, 4, dtype=torch.float64))
    ends, both = torch.tensor([0.0, 1.0], dtype=torch.float64), {"method": COMPILED, "adjoint_method": COMPILED_ADJOINT}
    exact = both | {"options": {}, "adjoint_options": {}}
    with pytest.raises(InputRefused, match="impulses in time"):
        torchdiffeq.odeint(runs, start, ends, method="rk4")
    with pytest.raises(InputRefused, match="impulses in time"):
        torchdiffeq.odeint_adjoint(
            runs, start, ends, method=COMPILED, options={}, adjoint_method="rk4", adjoint_options={}
        )[-1].sum().backward()
    with pytest.raises(InputRefused, match=f"{METHOD}"):
        torchdiffeq.odeint_adjoint(system, start[:, :4], ends, **exact)
    with pytest.raises(InputRefused, match="from 0 to 1"):
        torchdiffeq.odeint_adjoint(runs, start, 2.0 * ends, **exact)
    with pytest.raises(InputRefused, match="no option step_size"):
        torchdiffeq.odeint(runs, start, ends, method=COMPILED, options={"step_size": 0.1})
    with pytest.raises(InputRefused, match=r"give that of SampledRuns\.start"):
        torchdiffeq.odeint(runs, start[:, :4], ends, method=COMPILED, options={})
    with pytest.raises(InputRefused, match="adjoint_method of odeint_adjoint"):
        torchdiffeq.odeint_adjoint(
            system, start[0, :4], ends, method="rk4",
            adjoint_method=COMPILED_ADJOINT, adjoint_options={},
        ).sum().backward()  # fmt: skip
    with pytest.raises(InputRefused, match="step indices from 0 to"):
        SampledRuns(system, with_ports(u, system), h, [n + 19 for n in nodes])
