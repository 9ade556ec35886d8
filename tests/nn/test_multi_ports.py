"""Laws on several variables together: power, gradients, structure, joints, files, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from networks import ledger
from torch import Tensor, nn

import phnn
from phnn.errors import InputRefused, StructureViolated
from phnn.models.actuator import hrc
from phnn.models.store import load, save
from phnn.network import Modulation, MultiPort, Network, PortHamiltonianSystem, SharedEnergy
from phnn.network.elements import renamed
from phnn.nn import (
    LearnedCoupling,
    LearnedDissipation,
    LearnedEnergy,
    LearnedRatio,
    LearnedSystem,
    Scales,
    SectorMLP,
    check,
)
from phnn.setup import Setup

torch.set_num_threads(1)
DT = 1e-4


def hybrid(**others: nn.Module) -> Network:
    """An actuator with every kind of law that acts on several variables."""
    scales = {"effort_scale": (20.0, 0.1), "flow_scale": (1e-3, 1.0)}
    dissipation = others.get("dissipation") or LearnedDissipation(2, 1, **scales, state_scale=1e-4, width=6)
    energy = others.get("energy") or LearnedEnergy(2, (1e-3, 1e-4), 1e-3, 6)
    return hrc(2).extend(
        multi_ports=(
            MultiPort("friction", dissipation, ("Q_1", {"p": 1.0}), ("q",)),
            MultiPort("gyrator", LearnedCoupling(2, 0, **scales, width=6), ("Q_2", "p")),
        ),
        shared_energies=(SharedEnergy("joint", energy, ("Q_1", "q")),),
        modulations=(Modulation("alpha", "q", LearnedRatio(1e-4)),),
    )


def drive(steps: int) -> Tensor:
    return 40.0 * torch.sin(0.3 * torch.arange(steps, dtype=torch.float64)).unsqueeze(-1)


class Scaled(nn.Module):
    """A law of a user on two efforts, which reads a state; passive while its weight is positive."""

    def __init__(self, weight: float) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.tensor(weight, dtype=torch.float64))

    def forward(self, effort: Tensor, q: Tensor) -> Tensor:
        return self.weight * effort * (1.0 + q.square())


class Bowl(nn.Module):
    """An energy of a user of two states."""

    def __init__(self) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.tensor(10.0, dtype=torch.float64))

    def energy(self, x: Tensor) -> Tensor:
        return self.weight * (x[..., 0] + 0.3 * x[..., 1]).square() + 1e3 * x[..., 0].pow(4)


@pytest.mark.parametrize(
    "others", [{}, {"dissipation": Scaled(1e-4)}, {"energy": Bowl()}], ids=["own", "law", "energy"]
)
@torch.no_grad()
def test_every_step_balances_its_power(others: dict[str, nn.Module]) -> None:
    system, u = PortHamiltonianSystem(hybrid(**others)), drive(60)
    x, _ = phnn.simulate(system, u, dt=DT)
    balance = ledger(system, x.detach(), nn.functional.pad(0.5 * (u[1:] + u[:-1]), (0, 1)), DT)
    assert float(balance.defect.abs().max()) < 1e-9 * float(balance.supplied.abs().max())
    assert bool((balance.dissipated >= 0.0).all())
    assert balance.dissipated.shape[-1] == len(system.network.resistors) + 1


def test_the_rates_are_those_of_structure_dissipation_and_ports() -> None:
    system = PortHamiltonianSystem(hybrid())
    x = torch.tensor([[1e-3, -2e-4, 3e-5, 1e-4], [2e-3, 5e-4, -8e-5, 2e-4]], dtype=torch.float64)
    u = torch.tensor([[30.0, 0.2], [-10.0, 0.0]], dtype=torch.float64)
    j, d = system.structure(x), system.dissipation(x)
    columns = system.incidences(x)[1]
    built = ((j - d) @ system.efforts(x).unsqueeze(-1) + columns @ u.unsqueeze(-1)).squeeze(-1)
    torch.testing.assert_close(system.vector_field(x, u), built, rtol=1e-9, atol=1e-12)


def test_gradients_are_those_of_central_differences() -> None:
    system, u = PortHamiltonianSystem(hybrid()), drive(20)

    def loss() -> Tensor:
        return (phnn.simulate(system, u, dt=DT)[0][..., 2] / 1e-4).square().sum()

    loss().backward()
    for name, p in ((n, p) for n, p in system.named_parameters() if p.numel()):
        flat, gradient = p.detach().view(-1), (torch.zeros_like(p) if p.grad is None else p.grad).view(-1)
        k = int(gradient.abs().argmax())
        values = []
        for sign in (1.0, -1.0):
            flat[k] += sign * 1e-5
            values.append(float(loss().detach()))
            flat[k] -= sign * 1e-5
        wanted = (values[0] - values[1]) / 2e-5
        assert float(gradient[k]) == pytest.approx(wanted, rel=1e-5, abs=1e-7), name


def test_joined_and_renamed_networks_keep_these_laws(tmp_path: Path) -> None:
    network = renamed(hybrid(), "a_")
    assert network.multi_ports[0].columns == ({"a_Q_1": 1.0}, {"a_p": 1.0})
    x, u = torch.tensor([1e-3, 2e-4, 3e-5, 1e-4], dtype=torch.float64), torch.zeros(2, dtype=torch.float64)
    system = PortHamiltonianSystem(hybrid())
    save(Setup(system.as_network()), tmp_path)
    again = PortHamiltonianSystem(load(tmp_path)[0].network)
    assert torch.equal(again.vector_field(x, u), system.vector_field(x, u))
    joined = phnn.network.elements.interconnect(network, "a_force", renamed(hybrid(), "b_"), "b_force", _spring())
    assert len(joined.multi_ports) == 4 and len(joined.shared_energies) == 2


def _spring() -> phnn.network.Storage:
    class Plain(nn.Module):
        def energy(self, x: Tensor) -> Tensor:
            return 50.0 * x.square()

    return phnn.network.Storage("between", Plain())


def test_what_does_not_fit_or_delivers_power_is_refused() -> None:
    class Turning(nn.Module):
        def forward(self, effort: Tensor) -> Tensor:
            return effort.flip(-1)

    class Saddle(nn.Module):
        def energy(self, x: Tensor) -> Tensor:
            return x[..., 0] * x[..., 1]

    with pytest.raises(StructureViolated, match=r"εᵀφ = .* < 0 and it delivers power"):
        check(Turning(), ports=2)
    with pytest.raises(StructureViolated, match="lies below H"):
        check(Saddle(), ports=2)
    with pytest.raises(StructureViolated, match="its law is made for 3 ports, the element has 2"):
        PortHamiltonianSystem(hrc(1).extend(multi_ports=(MultiPort("r", LearnedDissipation(3), ("Q_1", "p")),)))
    with pytest.raises(StructureViolated, match="refers to the storage 'z'"):
        hrc(1).extend(shared_energies=(SharedEnergy("e", LearnedEnergy(2), ("q", "z")),))
    for wrong, words in (
        ({"multi_ports": (MultiPort("r", LearnedRatio(), ("Q_1", "p")),)}, "law of a modulation, not of a multi_port"),
        ({"multi_ports": (MultiPort("r", SectorMLP(1.0, 1.0), ("Q_1",)),)}, "not of a multi_port"),
        ({"shared_energies": (SharedEnergy("e", LearnedDissipation(2), ("Q_1", "q")),)}, "not of a shared_energy"),
        ({"multi_ports": (MultiPort("r", nn.Linear(3, 3).double(), ("Q_1", "p")),)}, "fails on tensors"),
    ):
        with pytest.raises(StructureViolated, match=words):
            PortHamiltonianSystem(hrc(1).extend(**wrong))
    with pytest.raises(StructureViolated, match="not of a storage"):
        PortHamiltonianSystem(hrc(1).replace("Q_1", LearnedEnergy(1)))
    with pytest.raises(InputRefused, match="give a positive typical magnitude"):
        LearnedDissipation(2, effort_scale=(1.0, 0.0))


def test_a_law_that_several_elements_share_is_trained_as_one() -> None:
    law = SectorMLP(20.0, 1e-3, 4)
    system = PortHamiltonianSystem(hrc(2).replace("hysteron_1", law).replace("hysteron_2", law))
    phnn.simulate(system, drive(20), dt=DT)[0][..., 2].square().sum().backward()
    parameters = list(system.laws.parameters())
    assert len(parameters) == len(list(law.parameters()))
    assert all(isinstance(p, nn.Parameter) and bool((p.grad != 0.0).any()) for p in parameters)


def test_a_law_that_training_carries_out_of_its_promise_is_cut_off() -> None:
    system = PortHamiltonianSystem(hybrid(dissipation=Scaled(1e-4)))
    with torch.no_grad():
        system.laws["multi_port_friction"].weight.fill_(-1.0)
    x, u = torch.tensor([1e-3, 2e-4, 3e-5, 1e-4], dtype=torch.float64), torch.zeros(2, dtype=torch.float64)
    assert bool((system.power_balance(x, u).dissipated >= 0.0).all())


def test_a_learned_system_has_several_ports_and_a_linear_start() -> None:
    network = hrc(2)
    for i in (1, 2):
        network = network.replace(f"hysteron_{i}", "linear", (f"rho_{i}",))
    linear = PortHamiltonianSystem(network)
    system = LearnedSystem.near(linear, Scales(1e-3, 75.0, 1e-4), width=8)
    assert [p.name for p in system.network.ports] == ["voltage", "force"]
    with torch.no_grad():
        for port in system.network.multi_ports:
            port.law.entries.weights[-1].zero_()
        system.network.shared_energies[0].law.heights.fill_(-1e4)
        u = torch.cat([drive(100), 0.1 * drive(100)], dim=-1)
        wanted, found = (phnn.simulate(s, u, dt=DT)[0] for s in (linear, system))
    q = linear.state_names.index("q")
    torch.testing.assert_close(found[..., 0], wanted[..., q], rtol=0.0, atol=2e-3 * float(wanted[..., q].abs().max()))
