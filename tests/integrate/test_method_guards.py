"""What surrounds the power-preserving step in torchdiffeq: its recording, wrong adjoints, and what is refused."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
import torchdiffeq
from torch import Tensor, nn

from phnn.errors import InputRefused, SolverFailed
from phnn.integrate.method import METHOD, solve
from phnn.integrate.scheme import Scheme
from phnn.network import Coupling, DrivenSystem, Network, Port, PortHamiltonianSystem, Resistor, Storage
from phnn.parameters import as_table, positive

torch.set_num_threads(1)

TIMES = torch.tensor([0.5, 1.1, 1.2, 2.03], dtype=torch.float64)


def oscillator(resistor: object = "coulomb", rate: float = 0.3, k: float = 8.0) -> DrivenSystem:
    """A driven mass of 2 kg on a spring, with friction that decays at ``rate`` where it is linear."""
    values = {"coulomb": {"f": 0.3, "v": 0.02}, "linear": {"b": 2.0 * rate}}.get(str(resistor), {})
    network = Network(
        (Storage("q", "spring", ("k",)), Storage("p", "capacitor", ("m",))),
        (Resistor("friction", resistor, {"p": 1.0}, tuple(values)),),
        (Coupling("q", "p"),),
        (Port("force", {"p": 1.0}),),
        as_table([positive(name, value, "1") for name, value in {"m": 2.0, "k": k, **values}.items()]),
    )
    return PortHamiltonianSystem(network).with_input(lambda t: torch.sin(3.0 * t))


def start(*batch: int) -> Tensor:
    return torch.randn(*batch, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(3))


def by_graph(driven: object, x0: object, t: Tensor, step: float | None = 0.1) -> Tensor:
    return torchdiffeq.odeint(driven, x0, t, method=METHOD, options={"step_size": step})


def by_adjoint(driven: object, x0: object, t: Tensor, step: float | None = 0.1) -> Tensor:
    return torchdiffeq.odeint_adjoint(driven, x0, t, method=METHOD, options={"step_size": step})


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


def relaxation(rate: float) -> PortHamiltonianSystem:
    """``ṗ = −b p/m``, whose step is ``p⁺ = (1 − r)/(1 + r) p`` with ``r = h b/(2m)``."""
    network = Network(
        (Storage("p", "capacitor", ("m",)),),
        (Resistor("damper", "linear", {"p": 1.0}, ("b",)),),
        (),
        (),
        as_table([positive("m", 2.0, "kg"), positive("b", 2.0 * rate, "N s/m")]),
        "p",
    )
    return PortHamiltonianSystem(network)


def slope_of_relaxation(rate: float, h: float, steps: int) -> float:
    """``∂p_N/∂b`` by hand, from ``p_0 = 1`` and ``m = 2 kg``."""
    r = 0.5 * rate * h
    factor = (1.0 - r) / (1.0 + r)
    return steps * factor ** (steps - 1) * (-2.0 / (1.0 + r) ** 2) * h / 4.0


def test_every_other_adjoint_of_the_step_is_refused() -> None:
    driven = oscillator()
    other = {"adjoint_method": "midpoint", "adjoint_options": {"step_size": 0.01}}
    x = torchdiffeq.odeint_adjoint(driven, start(), TIMES, method=METHOD, options={"step_size": 0.1}, **other)
    with pytest.raises(InputRefused, match=r"outputs are far apart .*leave adjoint_method out"):
        x.sum().backward()


def test_a_stiff_decay_has_an_exact_adjoint_at_any_spacing() -> None:
    x0, t = torch.ones(1, dtype=torch.float64), torch.tensor([0.0, 2.0], dtype=torch.float64)
    system, midpoint = relaxation(1e7), {"step_size": 0.1, "scheme": Scheme.MIDPOINT}
    x = torchdiffeq.odeint_adjoint(system, x0, t, method=METHOD, options=midpoint)
    x[-1, 0].backward()
    assert system.free.gradient("b") == pytest.approx(slope_of_relaxation(1e7, 0.1, 20), rel=1e-9)
    # The exact flow has nothing left of it after the first step.
    assert not torchdiffeq.odeint(system, x0, t, method=METHOD, options={"step_size": 0.1})[-1].any()


def test_without_torchdiffeqs_private_parts_the_steps_are_the_same() -> None:
    driven = oscillator()
    assert torch.equal(solve(driven, start(), TIMES, 0.1), by_graph(driven, start(), TIMES))


class Spiral(nn.Module):
    """A vector field without an energy."""

    def forward(self, t: Tensor, x: Tensor) -> Tensor:
        return x.flip(-1)


@pytest.mark.parametrize("by", [by_graph, by_adjoint])
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


class Falling(nn.Module):
    """A sector law that falls so steeply that a long step has no connected solution."""

    def forward(self, effort: Tensor) -> Tensor:
        return 50.0 * effort * torch.exp(-((effort / 0.1) ** 2))


def test_a_step_without_solution_is_named_by_its_own_time() -> None:
    driven = oscillator(Falling(), k=1e-6).system.with_input(lambda t: 0.2 * (t - 100.0))
    t = torch.arange(100.0, 130.0, 0.5, dtype=torch.float64)
    with pytest.raises(SolverFailed, match=r"the step from t = 1[0-2]\d(\.5)? s .* has no solution"):
        by_adjoint(driven, torch.zeros(2, dtype=torch.float64), t, None)
