"""The power-preserving step in torch: exact balance, accuracy, gradients, and failures that say why."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import Falling, ledger, networks, oscillator, random_states, solve_dense
from torch import Tensor, nn

from phnn.derivatives import output_derivatives
from phnn.errors import SolverFailed, StructureViolated
from phnn.integrate.differentiable import Steps, sensitivities, simulated
from phnn.integrate.equations import linearised, step_residual
from phnn.integrate.scheme import Scheme
from phnn.laws import RESISTOR_LAWS
from phnn.model import Model
from phnn.models import hrc
from phnn.network import Coupling, Network, Port, PortHamiltonianSystem, Resistor, Storage
from phnn.nn import LearnedSystem
from phnn.parameters import as_table, constant, positive
from phnn.recordings.recording import Start, unrecorded
from phnn.setup import Block, Setup
from phnn.trajectory import simulate


def closes(
    system: PortHamiltonianSystem, x: Tensor, u: Tensor, h: float, scheme: Scheme = Scheme.DISCRETE_GRADIENT
) -> bool:
    """Whether every step keeps the balance to 1e-10 of the energies that meet in it."""
    with torch.no_grad():
        balance = ledger(system, x, u, h, scheme)
        size = h * (balance.supplied.abs().sum(-1) + balance.dissipated.sum(-1)) + system.energy(x).abs().max()
    # What a hysteron-type storage dissipates is a difference, which rounding may leave below zero.
    lossy = h * balance.dissipated >= -1e-14 * size.unsqueeze(-1)
    return bool(lossy.all() and (h * balance.defect.abs() <= 1e-10 * size).all())


@settings(max_examples=40, deadline=None)
@given(networks(monotone=True), st.integers(0, 10**6), st.sampled_from([1e-3, 0.1, 3.0]))
def test_power_balance_is_exact_for_any_network_and_step(network: Network, seed: int, h: float) -> None:
    system = PortHamiltonianSystem(network)
    x0, u = (torch.from_numpy(v) for v in random_states(network, seed, 3))
    with torch.no_grad():
        x = solve_dense(system, x0[0], u, h)
    assert x.shape == (4, x0.shape[-1])
    assert closes(system, x, u, h)


def test_a_step_without_connected_solution_names_time_and_remedy() -> None:
    network = Network(
        (Storage("p", "capacitor", ("m",)),),
        (Resistor("friction", Falling(), {"p": 1.0}),),
        (),
        (Port("force", {"p": 1.0}),),
        as_table([positive("m", 2.0, "kg")]),
        "p",
    )
    system = PortHamiltonianSystem(network)
    x0 = torch.zeros(1, dtype=torch.float64)
    # The law holds at most 2.14 N.
    u = torch.linspace(1.8, 4.0, 32, dtype=torch.float64)
    with torch.no_grad(), pytest.raises(SolverFailed, match=r"from t = .* has no solution: .* monotone"):
        solve_dense(system, x0, u, 0.5, Scheme.MIDPOINT)
    # Short steps follow the branch over the top of the friction law.
    u = u.repeat_interleave(10)
    with torch.no_grad():
        x = solve_dense(system, x0, u, 0.05, Scheme.MIDPOINT)
    assert closes(system, x, u, 0.05, Scheme.MIDPOINT)
    assert (x[1:] >= x[:-1]).all()
    assert x[-1] / 2.0 > 0.3


class Broken(nn.Module):
    """A law that is no number beyond an effort, but not yet when the system is made, which would refuse it."""

    broken = False

    def forward(self, effort: Tensor) -> Tensor:
        return torch.where(effort > 0.1, torch.nan, effort) if self.broken else effort


def test_a_law_that_is_not_finite_is_named_with_its_time() -> None:
    system = PortHamiltonianSystem(oscillator(resistor=Broken()))
    system.laws["resistor_damper"].broken = True
    u = torch.ones(50, dtype=torch.float64)
    with torch.no_grad(), pytest.raises(SolverFailed, match=r"step from t = 0\.\d+ s .*not finite"):
        solve_dense(system, torch.zeros(2, dtype=torch.float64), u, 0.02)


class DeadZone(nn.Module):
    """A registered law, in a module that has no kernel."""

    def __init__(self, law: str, *values: float) -> None:
        super().__init__()
        self.law_name, self.values = law, nn.Parameter(torch.tensor(values, dtype=torch.float64))

    def forward(self, effort: Tensor) -> Tensor:
        return RESISTOR_LAWS[self.law_name].flow(effort, torch.zeros_like(effort), *self.values)


def test_a_model_whose_law_has_no_kernel_simulates_and_predicts_as_the_compiled_one() -> None:
    network = hrc(hysterons=1)
    (resistor,) = (r for r in network.resistors if r.name == "hysteron_1")
    values = [network.parameters[n].value for n in resistor.parameters]
    own = network.replace("hysteron_1", DeadZone(str(resistor.law), *values))
    t = np.arange(120) * 2e-4
    block = {
        "amplifier": (Block("lowpass", ("t_a",)),), "sensor": (Block("lag", ("t_s",)),),
        "block_parameters": as_table([constant(n, 3e-4, "s", "test") for n in ("t_a", "t_s")]),
    }  # fmt: skip
    outputs = [Model(Setup(n, **block), 8).simulate(t, 20.0 + 60.0 * np.sin(300.0 * t)) for n in (network, own)]
    assert np.abs(outputs[0] - outputs[1]).max() < 1e-3 * np.ptp(outputs[0])
    rest = [Model(Setup(n)).simulate(t[:3], np.full(3, 20.0)) for n in (network, own)]
    assert rest[0] == pytest.approx(rest[1], rel=1e-9)
    recording = replace(unrecorded("r", t, 60.0 * np.sin(300.0 * t), "cubic", 0.0, {}), start=Start("unknown"))
    for scheme in Scheme:
        run = simulate(Setup(own), recording, 2, initial=np.zeros(3), scheme=scheme)
        slope = output_derivatives(run, (), range(3))[:, 2]
        ends = [
            simulate(Setup(own), recording, 2, initial=np.array([0.0, 0.0, s]), scheme=scheme).y for s in (1e-8, -1e-8)
        ]
        assert slope == pytest.approx((ends[0] - ends[1]) / 2e-8, rel=1e-4, abs=1e-6 * np.abs(slope).max()), scheme
    with pytest.raises(StructureViolated, match="has no kernel: take simulate, predict"):
        output_derivatives(run, ("k",))


def test_slopes_in_closed_form_and_sensitivities_are_those_of_automatic_differentiation() -> None:
    system = LearnedSystem(states=3, ports=1, width=6)
    random = torch.Generator().manual_seed(0)
    x, z = torch.randn(2, 5, 2, 3, generator=random, dtype=torch.float64)
    h = torch.full((5, 2, 1), 0.1, dtype=torch.float64)
    end, start, u = z.clone().requires_grad_(), x.clone().requires_grad_(), torch.ones(5, 2, 1, dtype=torch.float64)
    residual = step_residual(system, start, end, u, h)
    for found, at in zip(linearised(system, x, z, u, h)[1:], (end, start), strict=True):
        rows = [torch.autograd.grad(residual[..., i].sum(), at, retain_graph=True)[0] for i in range(3)]
        assert torch.allclose(found, torch.stack(rows, dim=-2), rtol=1e-12, atol=1e-14)
    steps, x0 = Steps(system), 0.1 * x[0]
    states = simulated(system, x0, u, h[..., 0])
    by = sensitivities(steps, states.detach(), u, h, [torch.arange(6)] * 2, 0)
    weights = [p for p in steps.parameters() if p.requires_grad]
    exact = torch.autograd.grad(states[5, 1, 0], weights)
    assert torch.allclose(by[1][5, :-3], torch.cat([g.reshape(-1) for g in exact]), rtol=1e-9, atol=1e-12)


class Tied(nn.Module):
    """A law that holds one weight under two names."""

    def __init__(self) -> None:
        super().__init__()
        self.slope = self.bend = nn.Parameter(torch.tensor(2e-4, dtype=torch.float64))

    def forward(self, effort: Tensor) -> Tensor:
        return self.slope.abs() * effort + self.bend.abs() * effort**3 / 100.0


def test_the_gradient_by_a_tied_weight_counts_both_of_its_places() -> None:
    system = PortHamiltonianSystem(hrc(hysterons=1).replace("hysteron_1", Tied()))
    voltage = 60.0 * torch.sin(0.1 * torch.arange(60, dtype=torch.float64))
    u = torch.stack([voltage, torch.zeros_like(voltage)], dim=1)
    (weight,) = (p for n, p in system.named_parameters() if n.endswith("hysteron_1.slope"))

    def loss() -> Tensor:
        return (1e6 * simulated(system, torch.zeros(3, dtype=torch.float64), u, 1e-4)[:, 0]).square().sum()

    (gradient,) = torch.autograd.grad(loss(), weight)
    with torch.no_grad():
        weight += 2e-8
        above = loss()
        weight -= 4e-8
        assert float(gradient) == pytest.approx(float(above - loss()) / 4e-8, rel=1e-5)


@pytest.mark.parametrize("mass", [1e-3, 1e3])
def test_a_steady_cycle_closes_in_any_units(mass: float) -> None:
    stiffness = 1e6 * mass
    network = Network(
        (Storage("q", "spring", ("k",), "m"), Storage("p", "capacitor", ("m",), "kg m/s")),
        (Resistor("damper", "linear", {"p": 1.0}, ("b",)),), (Coupling("q", "p"),), (Port("force", {"p": 1.0}),),
        as_table([positive("m", mass, "kg"), positive("k", stiffness, "N/m"), positive("b", 10.0 * mass, "N s/m")]),
        "q",
    )  # fmt: skip
    own = network.replace("damper", DeadZone("linear", 10.0 * mass))
    t = 1e-4 * np.arange(200)
    drive = 1e-3 * stiffness * np.sin(2.0 * np.pi * t / 5e-3)
    recording = replace(unrecorded("r", t, drive, "cubic", 0.0, {}), start=Start("periodic"), period=5e-3)
    compiled, torched = (simulate(Setup(n), recording, 2) for n in (network, own))
    assert compiled.compiled is not None and torched.compiled is None
    assert torched.y == pytest.approx(compiled.y, abs=1e-9 * np.ptp(compiled.y))


class Sinh(nn.Module):
    """A law whose slope leaves the range of numbers before the law does what a step asks."""

    def forward(self, effort: Tensor) -> Tensor:
        return torch.sinh(effort)


@pytest.mark.parametrize(("kind", "guess"), [(torch.float32, 88.0), (torch.float64, 708.0)])
def test_a_step_whose_slope_is_infinite_is_not_taken_for_solved(kind: torch.dtype, guess: float) -> None:
    table = as_table([positive("k", 1e4, "N/m")])
    spring, port = (Storage("q", "spring", ("k",)),), (Port("flow", {"q": 1.0}),)
    system = PortHamiltonianSystem(Network(spring, (Resistor("r", Sinh(), {"q": 1.0}),), (), port, table, "q")).to(kind)
    h, k = 1e-3, 1e4
    flow = 2.0 * guess / k * (1.0 + 0.5 * h * k) / h
    ends = simulated(system, torch.full((1,), 1e-9, dtype=kind), torch.full((1, 1), flow, dtype=kind), h)
    assert float(0.5 * k * ends[-1, 0].detach()) == pytest.approx(np.arcsinh(flow), rel=0.05)
