"""Structure, power balance and interfaces of the torch module of a network."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import networks, oscillator, random_states
from torch import Tensor, nn

import phnn.network
from phnn.errors import InputRefused, StructureViolated
from phnn.models.actuator import from_paper
from phnn.network import Network, Port, PortHamiltonianSystem, Storage
from phnn.nn import MonotoneMLP, SectorMLP
from phnn.parameters import Parameter, as_table, constant, positive

seeds = st.integers(0, 2**31 - 1)
many = settings(max_examples=150, deadline=None)
BATCH = 8


def states(network: Network, seed: int, count: int = BATCH) -> tuple[Tensor, Tensor]:
    x, u = random_states(network, seed, count)
    return torch.from_numpy(x), torch.from_numpy(u)


@many
@given(networks(), seeds)
def test_power_balance_is_exact(network: Network, seed: int) -> None:
    system = PortHamiltonianSystem(network)
    x, u = states(network, seed)
    balance = system.power_balance(x, u)
    e = system.efforts(x)
    exchanged = (e.abs().unsqueeze(-2) @ system.structure(x).abs() @ e.abs().unsqueeze(-1)).squeeze((-1, -2))
    size = balance.supplied.abs().sum(-1) + balance.dissipated.sum(-1) + exchanged
    assert (balance.defect.abs() <= 1e-10 * size).all()
    assert (balance.dissipated >= 0.0).all()


@many
@given(networks(), seeds)
def test_vector_field_is_structure_minus_dissipation_times_gradient(network: Network, seed: int) -> None:
    system = PortHamiltonianSystem(network)
    x, u = states(network, seed)
    z = x.clone().requires_grad_(True)
    (gradient,) = torch.autograd.grad(system.energy(z).sum(), z)
    torch.testing.assert_close(system.efforts(x), gradient, rtol=1e-9, atol=1e-12)
    _, inputs = system.incidences(x)
    matrix = system.structure(x) - system.dissipation(x)
    expected = (matrix @ gradient.unsqueeze(-1)).squeeze(-1) + system.actions(u) @ inputs.mT
    torch.testing.assert_close(system.vector_field(x, u), expected, rtol=1e-8, atol=1e-10)


def test_actuator_matches_its_equations() -> None:
    network = from_paper()
    theta = {name: p.value for name, p in network.parameters.items()}
    q1, q2, q, p, u, force = 5e-6, -2e-6, 3e-6, 1e-6, 40.0, 0.1
    v, e1, e2 = p / theta["m"], q1 / theta["C_1"], q2 / theta["C_2"]
    rates = PortHamiltonianSystem(network).vector_field(
        torch.tensor([q1, q2, q, p], dtype=torch.float64), torch.tensor([u, force], dtype=torch.float64)
    )
    hysteron_1 = theta["rho_1"] * (e1 - 0.5 * theta["d_1"])
    expected = [
        theta["alpha"] * v - hysteron_1,
        theta["alpha"] * v,
        v,
        theta["alpha"] * (u - e1 - e2) - theta["k"] * q - theta["b"] * v - force,
    ]
    assert e1 > 0.5 * theta["d_1"]
    assert abs(e2) < 0.5 * theta["d_2"]
    torch.testing.assert_close(rates, torch.tensor(expected, dtype=torch.float64), rtol=1e-12, atol=0.0)


def test_outputs_are_conjugate_also_at_a_nonlinear_port() -> None:
    network = Network(
        (Storage("p", "capacitor", ("m",)),),
        (),
        (),
        (Port("voltage", {"p": "alpha"}, "electrostriction", ("eps",)),),
        as_table([positive("m", 2.0, "kg"), positive("alpha", 3.0, "N/V"), Parameter("eps", 0.5)]),
        "p",
    )
    system = PortHamiltonianSystem(network)
    x, u = torch.tensor([4.0], dtype=torch.float64), torch.tensor([6.0], dtype=torch.float64)
    assert system.port_outputs(x, u).item() == pytest.approx((1 + 0.5 * 6.0) * 3.0 * 2.0)
    assert system.power_balance(x, u).supplied.item() == pytest.approx((6.0 + 0.25 * 36.0) * 3.0 * 2.0)


def test_dissipation_at_zero_effort_is_the_slope() -> None:
    for law, slope in (("linear", 0.5), (MonotoneMLP(1.0, 1.0), None), (SectorMLP(1.0, 1.0), None)):
        system = PortHamiltonianSystem(oscillator(resistor=law))
        d = system.dissipation(torch.zeros(2, dtype=torch.float64))[1, 1]
        step = torch.tensor(1e-6, dtype=torch.float64)
        wanted = slope if slope is not None else (law(step) / step).item()  # type: ignore[operator]
        assert d.item() == pytest.approx(wanted, rel=1e-4)


def test_input_fills_the_ports_it_names() -> None:
    system = PortHamiltonianSystem(from_paper())
    x, t = torch.zeros(4, dtype=torch.float64), torch.tensor(0.25, dtype=torch.float64)
    driven = system.with_input(lambda t: 100.0 * t, ports=("force",))
    assert driven(t, x)[3].item() == -25.0
    both = system.with_input(lambda t: torch.stack([0.0 * t, 100.0 * t]))
    assert torch.equal(both(t, x), driven(t, x))
    assert dict(driven.named_parameters()).keys() == {f"system.{n}" for n, _ in system.named_parameters()}
    assert torch.equal(system(t, x), torch.zeros(4, dtype=torch.float64))


def test_what_does_not_fit_is_refused() -> None:
    system = PortHamiltonianSystem(from_paper())
    x, t = torch.zeros(4, dtype=torch.float64), torch.tensor(0.0, dtype=torch.float64)
    with pytest.raises(InputRefused, match="number of ports"):
        system.vector_field(x, torch.zeros(1, dtype=torch.float64))
    with pytest.raises(InputRefused, match="last dimension must be 4"):
        system.energy(x[:3])
    with pytest.raises(InputRefused, match="no port called 'current'"):
        system.with_input(lambda t: t, ports=("current",))
    with pytest.raises(InputRefused, match="name the ports"):
        system.with_input(lambda t: t)(t, x)


def test_networks_that_cannot_be_a_module_are_refused() -> None:
    with pytest.raises(StructureViolated, match="no law called 'rubber'"):
        PortHamiltonianSystem(oscillator(storage="rubber"))
    with pytest.raises(StructureViolated, match="takes 2 parameters, 1 are given"):
        PortHamiltonianSystem(oscillator(resistor="dead_zone"))
    with pytest.raises(StructureViolated, match=r"\.double\(\)"):
        PortHamiltonianSystem(oscillator(resistor=nn.Linear(1, 1)))
    with pytest.raises(StructureViolated, match="torch module"):
        PortHamiltonianSystem(oscillator(resistor=abs))
    bad = Network((Storage("q", "spring", ("k.1",)),), (), (), (), as_table([constant("k.1", 1.0, "1")]))
    with pytest.raises(StructureViolated, match=r"k\.1"):
        PortHamiltonianSystem(bad)


def test_a_name_that_a_network_lacks_is_told() -> None:
    with pytest.raises(AttributeError, match="Networks"):
        phnn.network.Networks  # type: ignore[attr-defined]  # noqa: B018
