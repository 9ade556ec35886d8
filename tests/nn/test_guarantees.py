"""What a system promises holds whatever is done to its modules: subclasses, copies, states, weights, loads."""

from __future__ import annotations

import copy
import math
from dataclasses import replace

import pytest
import torch
from networks import oscillator
from torch import Tensor, nn

import phnn
from phnn.errors import InputRefused, SolverFailed, StructureViolated
from phnn.integrate.scheme import can_compile
from phnn.models.actuator import hrc
from phnn.network import Network, PortHamiltonianSystem
from phnn.nn import ConvexEnergyMLP, MonotoneMLP, SectorMLP, check
from phnn.setup import Setup

torch.set_num_threads(1)
STATES = torch.tensor([2e-4, 1e-4, 5e-5, 1e-3], dtype=torch.float64)


def learned(law: nn.Module) -> Network:
    return hrc(hysterons=2).replace("hysteron_1", law)


def sector() -> SectorMLP:
    return SectorMLP(effort_scale=20.0, flow_scale=1e-3, width=6)


def drive(steps: int) -> Tensor:
    return 40.0 * torch.sin(0.3 * torch.arange(steps, dtype=torch.float64)).unsqueeze(-1)


class Doubled(SectorMLP):
    """Twice the flow of its parent, by a weight of its own."""

    def __init__(self) -> None:
        super().__init__(20.0, 1e-3, 6)
        self.factor = nn.Parameter(torch.tensor(2.0, dtype=torch.float64))

    def forward(self, effort: Tensor) -> Tensor:
        return self.factor.abs() * super().forward(effort)


def test_a_subclass_is_integrated_as_what_it_is() -> None:
    network, parent = learned(Doubled()), learned(sector())
    assert can_compile(parent)
    assert not can_compile(network)
    # Nor is one whose evaluation is replaced.
    law = sector()
    law.forward = lambda effort: 3.0e-5 * effort  # type: ignore[method-assign]
    assert not can_compile(learned(law))
    system = PortHamiltonianSystem(network)
    factor = system.laws["resistor_hysteron_1"].factor
    x, _ = phnn.simulate(system, drive(40))
    other, _ = phnn.simulate(PortHamiltonianSystem(parent), drive(40))
    assert (x - other).abs().max() > 1e-3 * x.abs().max()
    (1e5 * x[..., 2]).square().sum().backward()
    slopes = []
    for step in (1e-4, -1e-4):
        with torch.no_grad():
            factor.add_(step)
            slopes.append((1e5 * phnn.simulate(system, drive(40))[0][..., 2]).square().sum())
            factor.sub_(step)
    assert factor.grad == pytest.approx(float(slopes[0] - slopes[1]) / 2e-4, rel=1e-6)


class Source(nn.Module):
    """``φ = −a ε`` under the name of a learned law."""

    law = "damping"

    def forward(self, effort: Tensor) -> Tensor:
        return -1e-3 * effort


class Hill(nn.Module):
    """An energy below that at rest."""

    def energy(self, x: Tensor) -> Tensor:
        return -x.square()


class Mixed(nn.Module):
    """A law of all points together."""

    def forward(self, effort: Tensor) -> Tensor:
        return effort.sum()


@pytest.mark.parametrize(
    ("law", "words"), [(Source(), "delivers power"), (Hill(), "lies below H"), (Mixed(), "act on each point alone")]
)
def test_a_law_outside_its_promise_is_told_with_a_counterexample(law: nn.Module, words: str) -> None:
    with pytest.raises(StructureViolated, match=words):
        check(law)
    for made in (sector(), MonotoneMLP(1.0, 1.0), ConvexEnergyMLP(1.0, 1.0)):
        check(made)
    if isinstance(law, Source):
        with pytest.raises(StructureViolated, match=words):
            PortHamiltonianSystem(learned(law))


class Bump(nn.Module):
    """An energy that training carries below that at rest."""

    def __init__(self) -> None:
        super().__init__()
        self.a = nn.Parameter(torch.tensor(1.0, dtype=torch.float64))

    def energy(self, x: Tensor) -> Tensor:
        return 0.5 * self.a * x.square() + 0.25 * x.pow(4)


def test_a_storage_of_a_user_never_falls_below_its_energy_at_rest() -> None:
    system = PortHamiltonianSystem(oscillator(Bump()))
    with torch.no_grad():
        system.laws["storage_q"].a.fill_(-30.0)
    x, _ = phnn.simulate(system, torch.sin(torch.arange(60, dtype=torch.float64)).unsqueeze(-1), dt=0.1)
    assert (system.energy(x) >= 0.0).all()
    # From rest and without a force it stays at rest.
    still, _ = phnn.simulate(system, torch.zeros(20, 1, dtype=torch.float64), dt=0.1)
    assert not still.any()


def test_systems_of_one_network_are_trained_apart() -> None:
    network = learned(sector())
    one, other = PortHamiltonianSystem(network), PortHamiltonianSystem(network)
    snapshot = one.as_network()
    before = copy.deepcopy(other.state_dict())
    with torch.no_grad():
        for parameter in one.parameters():
            parameter.add_(0.3)
    assert all(torch.equal(a, b) for a, b in zip(before.values(), other.state_dict().values(), strict=True))
    for kept in (network, snapshot):
        law = next(r.law for r in kept.resistors if r.name == "hysteron_1")
        assert torch.equal(law.heights, sector().heights)
    model = phnn.Model(Setup(network))
    assert model.module is model.module
    with torch.no_grad():
        for parameter in model.module.parameters():
            parameter.add_(0.3)
    assert torch.equal(model.setup.network.resistors[0].law.heights, sector().heights)
    trained = model.with_network(model.module.as_network())
    assert trained.parameters["m"] == pytest.approx(math.exp(0.3) * model.parameters["m"])


def test_a_state_is_loaded_by_names_and_within_bounds() -> None:
    plain = hrc(hysterons=2)
    system = PortHamiltonianSystem(plain)
    system.set_values({"m": 3e-4, "k": 2.5e4})
    state = system.state_dict()
    reversed_ = replace(plain, parameters=dict(reversed(plain.parameters.items())))
    again = PortHamiltonianSystem(reversed_)
    again.load_state_dict(state)
    for name in plain.parameters:
        assert again.value(name).item() == system.value(name).item(), name
    hostile = {**state, "free.reference.b": torch.tensor(-3.7, dtype=torch.float64)}
    with pytest.raises(InputRefused, match=r"parameter b = -3\.7"):
        again.load_state_dict(hostile)
    assert again.value("b").item() == system.value("b").item()
    with pytest.raises(InputRefused, match="parameter b is nan"):
        again.load_state_dict({**state, "free.reference.b": torch.tensor(math.nan, dtype=torch.float64)})


def test_a_hostile_state_of_a_law_stays_passive() -> None:
    system = PortHamiltonianSystem(learned(sector()))
    state = system.state_dict()
    for name in ("conductance", "scale"):
        state[f"laws.resistor_hysteron_1.{name}"] = -state[f"laws.resistor_hysteron_1.{name}"]
    system.load_state_dict(state)
    x = torch.randn(200, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * STATES
    assert torch.linalg.eigvalsh(system.dissipation(x)).min() >= -1e-18
    nothing = {n: torch.full_like(v, math.nan) for n, v in system.laws.state_dict().items()}
    system.laws.load_state_dict(nothing)
    with pytest.raises(SolverFailed, match=r"hysteron_1\..* is not finite"):
        system.vector_field(x, torch.zeros(200, 2, dtype=torch.float64))


def test_sixteen_bits_are_refused() -> None:
    system = PortHamiltonianSystem(learned(sector())).half()
    with pytest.raises((InputRefused, SolverFailed), match=r"float16|finite"):
        system.vector_field(STATES.half(), torch.zeros(2, dtype=torch.float16))


class Softened(nn.Module):
    """A law of one's own in five lines."""

    def __init__(self) -> None:
        super().__init__()
        self.g = nn.Parameter(torch.tensor(3e-5, dtype=torch.float64))

    def forward(self, effort: Tensor) -> Tensor:
        return self.g * torch.tanh(effort / 10.0)


@pytest.mark.parametrize("law", [sector(), MonotoneMLP(20.0, 1e-3, 3), Softened()], ids=["kernel", "monotone", "own"])
def test_simulate_takes_batches_and_shorter_numbers(law: nn.Module) -> None:
    system = PortHamiltonianSystem(learned(law))
    scale = torch.linspace(0.3, 1.5, 6, dtype=torch.float64).reshape(2, 3, 1, 1)
    u = (scale * drive(40)).requires_grad_(True)
    x, y = phnn.simulate(system, u)
    assert (x.shape, y.shape) == ((2, 3, 40, 4), (2, 3, 40, 2))
    graph, inputs = torch.compile(system.vector_field, fullgraph=True, backend="eager"), torch.ones(2).double()
    assert torch.equal(graph(STATES, inputs), system.vector_field(STATES, inputs))
    alone, outputs = phnn.simulate(system, u[1, 2])
    size = x.detach().abs().amax((0, 1, 2))
    assert ((x[1, 2] - alone).abs() <= 1e-11 * size).all()
    assert (outputs - y[1, 2]).abs().max() <= 1e-9 * y.abs().max()
    weights = torch.randn(x.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64) / size
    parameters = list(system.parameters())
    exact = torch.autograd.grad((weights * x).sum(), [u, *parameters])
    largest = max(float(g.abs().max()) for g in exact[1:])
    for parameter, slope in zip(parameters, exact[1:], strict=True):
        # The coordinates of physical parameters, which start at zero.
        if parameter.ndim or bool(parameter):
            continue
        with torch.no_grad():
            ends = []
            for step in (1e-4, -2e-4):
                parameter.add_(step)
                ends.append((weights * phnn.simulate(system, u)[0]).sum())
            parameter.add_(1e-4)
        assert float(ends[0] - ends[1]) / 2e-4 == pytest.approx(float(slope), abs=1e-6 * largest)
    short = copy.deepcopy(system).float()
    x32, _ = phnn.simulate(short, u.detach().float())
    assert ((x32 - x).abs() <= 1e-4 * size).all()
    found = torch.autograd.grad((weights.float() * x32).sum(), list(short.parameters()))
    for a, b in zip(found, exact[1:], strict=True):
        assert (a - b).abs().max() <= 1e-3 * largest
