"""The step in torch: balance, accuracy, gradients, failures; the module as judge of the compiled march."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from junctions import random_junction, recording
from networks import Falling, ledger, oscillator, remembering, solve_dense
from torch import Tensor, nn

from phnn.derivatives import output_derivatives
from phnn.effects import effect
from phnn.errors import InputRefused, SolverFailed, StructureViolated
from phnn.integrate import differentiable
from phnn.integrate.differentiable import Steps, sensitivities, simulated
from phnn.integrate.equations import _SCALED, check, has_closed_form, linearised, power_balance, step_residual
from phnn.integrate.scheme import Scheme
from phnn.laws import RESISTOR_LAWS
from phnn.model import Model
from phnn.models.actuator import from_paper, hrc
from phnn.network import Network, Port, PortHamiltonianSystem, Resistor, Storage
from phnn.nn import LearnedSystem
from phnn.parameters import as_table, constant, positive
from phnn.recordings.recording import Start, unrecorded
from phnn.setup import Block, Setup
from phnn.trajectory import Trajectory, simulate


def test_a_step_without_connected_solution_names_time_and_remedy() -> None:
    mass, force = (Storage("p", "capacitor", ("m",)),), (Port("force", {"p": 1.0}),)
    friction, table = (Resistor("friction", Falling(), {"p": 1.0}),), as_table([positive("m", 2.0, "kg")])
    system = PortHamiltonianSystem(Network(mass, friction, (), force, table, "p"))
    x0 = torch.zeros(1, dtype=torch.float64)
    # The law holds at most 2.14 N.
    u = torch.linspace(1.8, 4.0, 32, dtype=torch.float64)
    with torch.no_grad(), pytest.raises(SolverFailed, match=r"from t = .* has no solution: .* monotone"):
        solve_dense(system, x0, u, 0.5, Scheme.MIDPOINT)
    # Short steps follow the branch over the top of the friction law.
    u = u.repeat_interleave(10)
    with torch.no_grad():
        x = solve_dense(system, x0, u, 0.05, Scheme.MIDPOINT)
        balance = ledger(system, x, u, 0.05, Scheme.MIDPOINT)
    assert (balance.dissipated >= 0.0).all()
    assert balance.defect.abs().max() <= 1e-10 * balance.supplied.abs().max()
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
    network = replace(oscillator().with_values({"m": mass, "k": stiffness, "b": 10.0 * mass}), output="q")
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


def sine(samples: int = 400) -> Trajectory:
    t = np.arange(samples) * 1e-5
    return simulate(Setup(from_paper()), recording(t, 75.0 * np.sin(2 * np.pi * 150.0 * t)))


@pytest.mark.parametrize(("place", "name"), [(0, "Q_1"), (1, "Q_2"), (2, "q"), (3, "p")])
def test_a_wrong_state_is_named_with_its_time(place: int, name: str) -> None:
    trajectory = sine()
    states = trajectory.states.copy()
    states[201, place] *= 1.0 + 1e-7
    with pytest.raises(SolverFailed, match=rf"at t = 0\.002(01)? s .* at the ({name}|p) equation"):
        check(replace(trajectory, states=states))
    states[201, place] = np.nan
    with pytest.raises(SolverFailed, match=r"t = 0\.002 s"):
        check(replace(trajectory, states=states))


def test_one_wrong_step_of_a_long_recording_is_found() -> None:
    heat = {"kappa_T": 0.3, "R_T": 2.0, "C_T": 1e-3, "T_a": 293.15, "T_s": 1.0}
    setup, t = effect("self_heating").add_to(Setup(from_paper()), heat), np.arange(8 * _SCALED) * 1e-5
    assert not has_closed_form(PortHamiltonianSystem(setup.network))
    trajectory = simulate(setup, recording(t, 75.0 * np.sin(2 * np.pi * 150.0 * t)))
    assert 0.0 < check(trajectory) < 1e-12
    for n in (1, 7_301, t.size - 1):
        states = trajectory.states.copy()
        states[n, 2] += 1e-7 * states[:, 2].max()
        with pytest.raises(SolverFailed, match=rf"at t = ({t[n - 1]:.6g}|{t[n % t.size]:.6g}) s leaves a relative"):
            check(replace(trajectory, states=states))


def test_balance_of_a_cycle_matches_what_the_elements_take() -> None:
    trajectory = sine(1334)
    balance = power_balance(trajectory)
    assert balance.dissipated.shape == (1333, 3)
    assert (balance.dissipated >= -1e-20).all()
    system = PortHamiltonianSystem(from_paper())
    with torch.no_grad():
        h = system.energy(torch.from_numpy(trajectory.states))
    assert balance.stored.sum().item() == pytest.approx((h[-1] - h[0]).item())
    # The damper's share by its own law, and the balance of the whole.
    damper = float(np.sum(trajectory.h * 3.7356 * trajectory.velocity**2))
    assert balance.dissipated[:, 2].sum().item() == pytest.approx(damper, rel=1e-12)
    total = balance.supplied.sum() - balance.dissipated.sum() - balance.stored.sum()
    assert abs(total.item()) < 1e-13 * balance.supplied.abs().sum().item()
    # A wrong input leaves a defect.
    wrong = replace(trajectory, u=trajectory.u * (1.0 + 1e-6))
    assert power_balance(wrong).defect.abs().max() > 1e4 * balance.defect.abs().max()


class Solve(nn.Module):
    """A march whose parameters can be replaced."""

    def __init__(self, system: PortHamiltonianSystem) -> None:
        super().__init__()
        self.system = system

    def forward(self, u: Tensor, h: Tensor, x0: Tensor) -> Tensor:
        return simulated(self.system, x0, u, h)


# Seeds whose motion keeps clear of kinks by more than a finite difference moves it.
@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in (2, 3, 5, 7, 12))])
@pytest.mark.parametrize("block", [100, 2])
@pytest.mark.parametrize("memories", [False, True])
def test_gradcheck_by_parameters_inputs_steps_and_start(
    seed: int, block: int, memories: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(differentiable, "BLOCK", block)
    network = random_junction(seed, stiff=False)
    network = remembering(network, seed) if memories else network
    system = PortHamiltonianSystem(network)
    random = np.random.default_rng(seed)
    u = torch.from_numpy(random.normal(size=(3, len(network.ports)))).requires_grad_(True)
    h = torch.from_numpy(random.uniform(0.05, 0.2, 3)).requires_grad_(True)
    x0 = torch.from_numpy(random.normal(size=len(network.state_names))).requires_grad_(True)
    names = [f"system.{name}" for name, _ in system.named_parameters()]
    values = tuple(p.detach().clone().requires_grad_(True) for p in system.parameters())

    def solve(u: Tensor, h: Tensor, x0: Tensor, *parameters: Tensor) -> Tensor:
        replaced = dict(zip(names, parameters, strict=True))
        path = torch.func.functional_call(Solve(system), replaced, (u, h, x0))
        assert torch.equal(path[0], x0)
        return path[1:]

    # Along directions at random; the slow suite tries every entry.
    quick = {"fast_mode": seed == 0}
    assert torch.autograd.gradcheck(solve, (u, h, x0, *values), eps=1e-6, atol=2e-6, rtol=1e-4, **quick)
    first = simulated(system, x0, u, h)[0]
    assert torch.equal(torch.autograd.grad(first.sum(), x0)[0], torch.ones_like(x0))


def test_unusable_arguments_are_refused() -> None:
    system = PortHamiltonianSystem(from_paper())
    x0, u = torch.zeros(4, dtype=torch.float64), torch.zeros(3, 2, dtype=torch.float64)
    with pytest.raises(InputRefused, match=r"state has shape \(3,\)"):
        simulated(system, x0[:3], u, 1e-5)
    with pytest.raises(InputRefused, match="2, the number of ports"):
        simulated(system, x0, u[:, :1], 1e-5)
    with pytest.raises(InputRefused, match=r"\.double\(\)"):
        simulated(system, x0, u.float(), 1e-5)
    with pytest.raises(InputRefused, match=r"not finite at index \(1, 0\)"):
        simulated(system, x0, u + torch.tensor([[0.0], [np.nan], [0.0]], dtype=torch.float64), 1e-5)
    for h in (0.0, -1.0, float("nan")):
        with pytest.raises(InputRefused, match="positive, finite steps"):
            simulated(system, x0, u, h)
    with pytest.raises(InputRefused, match="do not fit"):
        simulated(system, torch.zeros(4, 4, dtype=torch.float64), torch.zeros(3, 5, 2, dtype=torch.float64), 0.1)
