"""The power-preserving step inside torchdiffeq: its balance, gradients exact at any step, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
import torchdiffeq
from networks import Falling, Quartic, ledger, solve_dense
from torch import Tensor, nn

from phnn.errors import InputRefused, SolverFailed
from phnn.integrate.method import METHOD, solve
from phnn.network import Coupling, DrivenSystem, Network, Port, PortHamiltonianSystem, Resistor, Storage
from phnn.nn import ConvexEnergyMLP, SectorMLP
from phnn.parameters import as_table, positive

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
    "energy alone": lambda: mass(Storage("q", Quartic()), Resistor("learned", SectorMLP(1.0, 1.0, 3), {"p": 1.0})),
}


def starts(driven: DrivenSystem, *batch: int) -> Tensor:
    generator = torch.Generator().manual_seed(3)
    return torch.randn(*batch, len(driven.system.state_names), dtype=torch.float64, generator=generator)


def by_torchdiffeq(driven: Any, x0: Any, t: Tensor, step: float | None = STEP) -> Tensor:
    return torchdiffeq.odeint(driven, x0, t, method=METHOD, options={"step_size": step})


def by_adjoint(driven: Any, x0: Any, t: Tensor, step: float | None = STEP) -> Tensor:
    return torchdiffeq.odeint_adjoint(driven, x0, t, method=METHOD, options={"step_size": step})


@pytest.mark.parametrize("name", ["rate times step 1e3", "frictional", "damping law", "energy alone"])
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


# What surrounds the step in torchdiffeq: its recording, wrong adjoints, and what is refused.

TIMES = torch.tensor([0.5, 1.1, 1.2, 2.03], dtype=torch.float64)


def oscillator(resistor: object = "coulomb", rate: float = 0.3, k: float = 8.0) -> DrivenSystem:
    """A driven mass of 2 kg on a spring, with friction that decays at ``rate`` where it is linear."""
    values = {"coulomb": {"f": 0.3, "v": 0.02}, "linear": {"b": 2.0 * rate}}.get(str(resistor), {})
    friction = Resistor("friction", resistor, {"p": 1.0}, tuple(values))
    driven = mass(Storage("q", "spring", ("k",)), friction, k=k, **values)
    return driven.system.with_input(lambda t: torch.sin(3.0 * t))


def start(*batch: int) -> Tensor:
    return starts(oscillator(), *batch)


def slopes(driven: DrivenSystem, *results: Tensor) -> list[Tensor]:
    """Gradients of a weighed sum of results by the parameters of the system that they came from."""
    weights = torch.randn(results[0].shape, dtype=torch.float64, generator=torch.Generator().manual_seed(4))
    loss = sum((weights * x**2).sum() for x in results)
    return list(torch.autograd.grad(loss, tuple(driven.parameters())))


def test_two_solves_before_one_backward_keep_apart() -> None:
    driven = oscillator()
    solves = [(start(2)[k], step) for k, step in enumerate((0.1, 0.3))]
    alone = [slopes(driven, by_adjoint(driven, x0, TIMES, step)) for x0, step in solves]
    together = slopes(driven, *(by_adjoint(driven, x0, TIMES, step) for x0, step in solves))
    for whole, first, second in zip(together, *alone, strict=True):
        assert whole.item() == pytest.approx((first + second).item(), rel=1e-13)
        assert abs(first - second) > 0.01 * abs(whole)


def test_a_retained_graph_gives_the_same_gradients_again() -> None:
    driven = oscillator()
    x = by_adjoint(driven, start(), TIMES)
    once = torch.autograd.grad(x[-1, 0], tuple(driven.parameters()), retain_graph=True)
    again = torch.autograd.grad(x[-1, 0], tuple(driven.parameters()))
    assert all(torch.equal(a, b) for a, b in zip(once, again, strict=True))


def test_every_other_adjoint_of_the_step_is_refused() -> None:
    driven = oscillator()
    other = {"adjoint_method": "midpoint", "adjoint_options": {"step_size": 0.01}}
    x = torchdiffeq.odeint_adjoint(driven, start(), TIMES, method=METHOD, options={"step_size": 0.1}, **other)
    with pytest.raises(InputRefused, match=r"outputs are far apart .*leave adjoint_method out"):
        x.sum().backward()


def test_without_torchdiffeqs_private_parts_the_steps_are_the_same() -> None:
    driven = oscillator()
    assert torch.equal(solve(driven, start(), TIMES, STEP), by_torchdiffeq(driven, start(), TIMES))


class Spiral(nn.Module):
    """A vector field without an energy."""

    def forward(self, t: Tensor, x: Tensor) -> Tensor:
        return x.flip(-1)


@pytest.mark.parametrize("by", [by_torchdiffeq, by_adjoint])
def test_systems_without_a_discrete_gradient_are_refused(by: Callable[..., Tensor]) -> None:
    with pytest.raises(InputRefused, match=r"a Spiral, which has no energy .*with_input\(u\)"):
        by(Spiral(), torch.zeros(2, dtype=torch.float64), TIMES)
    with pytest.raises(InputRefused, match="one state tensor"):
        by(oscillator("linear"), (start(),), TIMES)
    with pytest.raises(InputRefused, match="cannot be integrated backwards"):
        by(oscillator("linear"), start(), -TIMES)


@pytest.mark.parametrize(
    ("t", "options", "message"),
    [
        (TIMES, {"step_size": 0.0}, r"step_size = 0 s: give a positive"),
        (TIMES, {"step_size": float("nan")}, r"step_size = nan s"),
        (TIMES, {"interp": "cubic"}, "no option interp: leave it out, it takes step_size"),
        (TIMES.float(), {}, r"torch\.float32: .*\.double"),
        (TIMES[:1], {}, "at least two"),
        (TIMES + torch.tensor([0, 0, 0, torch.inf]), {}, "all finite"),
    ],
)
def test_unusable_times_and_options_are_refused(t: Tensor, options: dict[str, object], message: str) -> None:
    driven = oscillator("linear")
    with pytest.raises(InputRefused, match=message):
        torchdiffeq.odeint(driven, start(), t, method=METHOD, options=options)


def test_misplaced_adjoint_methods_and_events_are_refused() -> None:
    driven = oscillator("linear")
    x0 = start()
    x = torchdiffeq.odeint_adjoint(driven, x0, TIMES, method="rk4", adjoint_method=METHOD)
    with pytest.raises(InputRefused, match="for the steps of method='phnn' alone: give both"):
        x.sum().backward()
    with pytest.raises(InputRefused, match="does not look for events"):
        torchdiffeq.odeint(driven, x0, TIMES[:2], method=METHOD, event_fn=lambda t, x: x[..., 0] - 1.0)


def test_a_step_without_solution_is_named_by_its_own_time() -> None:
    driven = oscillator(Falling(), k=1e-6).system.with_input(lambda t: 0.2 * (t - 100.0))
    t = torch.arange(100.0, 130.0, 0.5, dtype=torch.float64)
    with pytest.raises(SolverFailed, match=r"the step from t = 1[0-2]\d(\.5)? s .* has no solution"):
        by_adjoint(driven, torch.zeros(2, dtype=torch.float64), t, None)
