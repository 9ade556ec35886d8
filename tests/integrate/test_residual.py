"""The torch module as judge of the compiled march, and gradients through it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import torchdiffeq
from junctions import random_junction, recording
from networks import remembering
from torch import Tensor, nn

from phnn.effects import effect
from phnn.errors import InputRefused, SolverFailed
from phnn.integrate import differentiable
from phnn.integrate.differentiable import simulated
from phnn.integrate.equations import _SCALED, check, has_closed_form, power_balance
from phnn.models.actuator import from_paper, hrc
from phnn.network import PortHamiltonianSystem, Resistor
from phnn.setup import Setup
from phnn.trajectory import Trajectory, simulate


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


def called(system: PortHamiltonianSystem, function: nn.Module) -> tuple[list[str], tuple[Tensor, ...]]:
    names = [f"system.{name}" for name, _ in system.named_parameters()]
    return names, tuple(p.detach().clone().requires_grad_(True) for p in system.parameters())


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
    names, values = called(system, Solve(system))

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


def soft_actuator() -> PortHamiltonianSystem:
    """Table 1 with the first hysteron slowed down, so that an explicit method can follow it."""
    return PortHamiltonianSystem(hrc(2, {"rho_1": 6e-4}))


def without_kinks() -> PortHamiltonianSystem:
    """Hysterons that relax without a dead zone: dopri5's own gradient is 1e-3 wrong where a step straddles a kink."""
    base = hrc(2)
    slow = [Resistor(f"hysteron_{i}", "linear", {f"Q_{i}": 1.0}, (f"rho_{i}",)) for i in (1, 2)]
    network = replace(base, resistors=(*slow, base.resistors[-1])).with_values({"rho_1": 6e-4})
    return PortHamiltonianSystem(
        replace(network, parameters={n: p for n, p in network.parameters.items() if n not in ("d_1", "d_2")})
    )


def test_gradient_tends_to_that_of_torchdiffeq() -> None:
    duration, system = 2e-3, without_kinks()

    def voltage(t: Tensor) -> Tensor:
        return torch.stack([75.0 * torch.sin(2 * np.pi * 250.0 * t), 0.0 * t], dim=-1)

    def gradient(end: Tensor) -> Tensor:
        # Coordinates count relative changes of the parameters; the states are of the order 1e-6.
        return torch.stack(torch.autograd.grad(1e6 * end.sum(), list(system.parameters())))

    x0 = torch.zeros(4, dtype=torch.float64)
    times = torch.tensor([0.0, duration], dtype=torch.float64)
    wanted = gradient(
        torchdiffeq.odeint(system.with_input(voltage), x0, times, rtol=1e-10, atol=1e-16, method="dopri5")[-1]
    )
    errors = []
    for n in (4000, 8000):
        fine = voltage(torch.linspace(0.0, duration, 2 * n + 1, dtype=torch.float64))
        u = (fine[:-2:2] + 4.0 * fine[1::2] + fine[2::2]) / 6.0
        got = gradient(simulated(system, x0, u, duration / n)[-1])
        errors.append(float(((got - wanted).abs() / wanted.abs()).max()))
    assert errors[1] < 1e-6
    assert errors[1] == pytest.approx(errors[0] / 4.0, rel=0.1)


def test_unusable_arguments_are_refused() -> None:
    system = soft_actuator()
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
