"""The power-preserving step inside torchdiffeq: its states, its balance, and gradients that are exact at any step."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
import torchdiffeq
from networks import ledger, solve_dense
from torch import Tensor, nn

from phnn.errors import InputRefused
from phnn.integrate import differentiable
from phnn.integrate.method import METHOD
from phnn.network import Coupling, DrivenSystem, Network, Port, PortHamiltonianSystem, Resistor, Storage
from phnn.nn import ConvexEnergyMLP, SectorMLP
from phnn.parameters import as_table, positive

torch.set_num_threads(1)

# Whole and broken numbers of steps, one interval without an inner step, and a start that is not zero.
SPARSE = torch.tensor([0.5, 1.1, 1.3, 1.86], dtype=torch.float64)
STEP = 0.2


class Wave(nn.Module):
    """A sine with two parameters that moves all ports alike."""

    def __init__(self, ports: int, amplitude: float = 1.3) -> None:
        super().__init__()
        self.ports = ports
        self.amplitude = nn.Parameter(torch.tensor(amplitude, dtype=torch.float64))
        self.frequency = nn.Parameter(torch.tensor(3.0, dtype=torch.float64))

    def forward(self, t: Tensor) -> Tensor:
        return (self.amplitude * torch.sin(self.frequency * t)).expand(self.ports)


def mass(storage: Storage, *resistors: Resistor, **values: float) -> DrivenSystem:
    """A driven mass of 2 kg on a spring, with resistors on its velocity."""
    network = Network(
        (storage, Storage("p", "capacitor", ("m",))),
        resistors,
        (Coupling("q", "p"),),
        (Port("force", {"p": 1.0}),),
        as_table([positive("m", 2.0, "kg"), *(positive(name, value, "1") for name, value in values.items())]),
    )
    return PortHamiltonianSystem(network).with_input(Wave(1))


def linear(b: float) -> DrivenSystem:
    return mass(Storage("q", "spring", ("k",)), Resistor("damper", "linear", {"p": 1.0}, ("b",)), k=8.0, b=b)


def frictional() -> DrivenSystem:
    """A hardening spring, dry friction and a dead zone."""
    return mass(
        Storage("q", "cubic_spring", ("k", "kappa", "q0")),
        Resistor("dry", "coulomb", {"p": 1.0}, ("f", "v")),
        Resistor("gap", "dead_zone", {"p": 1.0}, ("rho", "width")),
        k=8.0, kappa=0.6, q0=0.4, f=0.3, v=0.02, rho=40.0, width=0.2,
    )  # fmt: skip


def neural(resistor: nn.Module) -> DrivenSystem:
    return mass(Storage("q", ConvexEnergyMLP(1.0, 4.0, 3)), Resistor("learned", resistor, {"p": 1.0}))


CASES: dict[str, Callable[[], DrivenSystem]] = {
    "rate times step 1e3": lambda: linear(1e4),
    "rate times step 1e6": lambda: linear(1e7),
    "frictional": frictional,
    "damping law": lambda: neural(SectorMLP(1.0, 1.0, 3)),
}


def starts(driven: DrivenSystem, *batch: int) -> Tensor:
    generator = torch.Generator().manual_seed(3)
    return torch.randn(*batch, len(driven.system.state_names), dtype=torch.float64, generator=generator)


def by_torchdiffeq(driven: nn.Module, x0: Tensor, t: Tensor, step: float | None = STEP) -> Tensor:
    return torchdiffeq.odeint(driven, x0, t, method=METHOD, options={"step_size": step})


def by_adjoint(driven: nn.Module, x0: Tensor, t: Tensor, step: float | None = STEP) -> Tensor:
    return torchdiffeq.odeint_adjoint(driven, x0, t, method=METHOD, options={"step_size": step})


def gradients(
    solve: Callable[..., Tensor], driven: DrivenSystem, start: Tensor, t: Tensor, *step: float
) -> tuple[Tensor, dict[str, Tensor]]:
    """States, and the gradients of a loss that weighs every output differently."""
    driven.zero_grad()
    x0 = start.clone().requires_grad_(True)
    x = solve(driven, x0, t, *step)
    weights = torch.randn(x.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(4))
    (weights * x).sum().backward()
    found = {name: p.grad.clone() for name, p in driven.named_parameters() if p.grad is not None}
    assert x0.grad is not None
    return x.detach(), {"x0": x0.grad} | found


def agree(found: dict[str, Tensor], expected: dict[str, Tensor], tolerance: float) -> None:
    """Every gradient to a tolerance relative to its own largest component."""
    for name, value in expected.items():
        assert (found[name] - value).abs().max() <= tolerance * value.abs().max(), name
    # What is used nowhere has no gradient in a graph, and zero from an adjoint.
    assert all(not found[name].any() for name in found.keys() - expected.keys())


@pytest.mark.parametrize("name", ["rate times step 1e3", "frictional", "damping law"])
def test_adjoint_gradients_agree_with_finite_differences(name: str) -> None:
    driven, t = CASES[name](), SPARSE[:3]
    x0 = starts(driven)
    by_adjoint(driven, x0, t).sum().backward()
    for label, parameter in driven.named_parameters():
        value = parameter.data.view(-1)
        kept, ends = value[0].item(), []
        small = 1e-5 * max(1.0, abs(kept))
        for sign in (1.0, -1.0):
            value[0] = kept + sign * small
            with torch.no_grad():
                ends.append(by_torchdiffeq(driven, x0, t).sum().item())
        value[0] = kept
        assert parameter.grad is not None
        slope = (ends[0] - ends[1]) / (2.0 * small)
        assert parameter.grad.view(-1)[0].item() == pytest.approx(slope, rel=1e-5, abs=1e-9), label


def test_gradients_by_the_output_times() -> None:
    # Steps of 0.17 s fill no interval exactly, so that their number stays when an output moves a little.
    driven, t = linear(0.5), SPARSE.clone().requires_grad_(True)
    x0 = starts(driven)
    (slopes,) = torch.autograd.grad(by_torchdiffeq(driven, x0, t, 0.17)[-1].sum(), t)
    with torch.no_grad():
        moved = [SPARSE + sign * 1e-6 * way for way in torch.eye(4, dtype=torch.float64) for sign in (1.0, -1.0)]
        ends = torch.stack([by_torchdiffeq(driven, x0, times, 0.17)[-1].sum() for times in moved])
    torch.testing.assert_close(slopes, (ends[::2] - ends[1::2]) / 2e-6, rtol=1e-6, atol=1e-8)
    with pytest.raises(InputRefused, match=r"no gradients by t .*t\.detach"):
        by_adjoint(driven, x0, t)


@pytest.mark.parametrize("name", ["rate times step 1e6", "frictional", "damping law"])
def test_balance_holds_in_every_step_and_between_sparse_outputs(name: str) -> None:
    driven = CASES[name]()
    x0 = starts(driven, 2)
    t = torch.arange(17, dtype=torch.float64) / 8.0
    with torch.no_grad():
        x = by_torchdiffeq(driven, x0, t, None)
        nodes = 0.125 * (0.5 + 0.5 * np.polynomial.legendre.leggauss(2)[0])
        u = torch.stack([0.5 * (driven.input(s + nodes[0]) + driven.input(s + nodes[1])) for s in t[:-1]])
        balance = ledger(driven.system, x, u, 0.125)
        size = balance.supplied.abs().sum(-1) + balance.dissipated.sum(-1) + driven.system.energy(x).max() / 0.125
        sparse = by_torchdiffeq(driven, x0, t[::8], 0.125)
    assert (balance.dissipated >= 0.0).all()
    assert (balance.defect.abs() <= 1e-12 * size).all()
    torch.testing.assert_close(sparse, x[::8], rtol=1e-13, atol=1e-15)


def test_a_system_alone_has_its_inputs_at_zero() -> None:
    system = frictional().system
    x0, t = starts(frictional()), torch.arange(4, dtype=torch.float64) / 4.0
    expected = solve_dense(system, x0, torch.zeros(3, 1, dtype=torch.float64), 0.25)
    torch.testing.assert_close(by_torchdiffeq(system, x0, t, None), expected, rtol=1e-13, atol=0.0)
    assert (system.energy(expected).diff() <= 0.0).all()


def test_steps_divide_every_interval_and_see_the_input_inside() -> None:
    seen: list[float] = []

    def force(t: Tensor) -> Tensor:
        seen.append(float(t))
        return 0.0 * t

    driven = linear(0.5).system.with_input(force)
    t = torch.tensor([0.5, 0.8, 1.15], dtype=torch.float64)
    with torch.no_grad():
        by_torchdiffeq(driven, starts(driven), t, 0.1)
    ends = np.concatenate([[0.5, 0.6, 0.7], np.linspace(0.8, 1.15, 5)])
    means = 0.5 * (ends[1:] + ends[:-1])
    reach = np.diff(ends) / np.sqrt(12.0)
    assert sorted(seen) == pytest.approx(np.sort(np.concatenate([means - reach, means + reach])))


def test_long_intervals_are_differentiated_in_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    driven = frictional()
    _, whole = gradients(by_adjoint, driven, starts(driven, 2), SPARSE)
    monkeypatch.setattr(differentiable, "BLOCK", 4)
    _, parts = gradients(by_adjoint, driven, starts(driven, 2), SPARSE)
    agree(parts, whole, 1e-13)
