"""torchdiffeq as a first-class solver, and the guards around it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from torch import Tensor, nn

from phnn.errors import InputRefused, SolverFailed
from phnn.integrate.ode import ADAPTIVE, FIXED, fastest_decay, odeint
from phnn.network import Coupling, Network, Port, PortHamiltonianSystem, Resistor, Storage
from phnn.nn import ConvexEnergyMLP
from phnn.parameters import as_table, positive

torch.set_num_threads(1)


def oscillator(b: float = 0.5, storage: object = "spring") -> PortHamiltonianSystem:
    """A driven mass on a spring with a damper."""
    stiffness = [positive("k", 8.0, "N/m")] if storage == "spring" else []
    network = Network(
        (Storage("q", storage, tuple(p.name for p in stiffness)), Storage("p", "capacitor", ("m",))),
        (Resistor("damper", "linear", {"p": 1.0}, ("b",)),),
        (Coupling("q", "p"),),
        (Port("force", {"p": 1.0}),),
        as_table([*stiffness, positive("m", 2.0, "kg"), positive("b", b, "N s/m")]),
    )
    return PortHamiltonianSystem(network)


def times(end: float, count: int) -> Tensor:
    return torch.linspace(0.0, end, count, dtype=torch.float64)


def rest(*batch: int) -> Tensor:
    return torch.zeros(*batch, 2, dtype=torch.float64)


@pytest.mark.parametrize(
    # The first of them takes the most steps.
    "method",
    [pytest.param(m, marks=pytest.mark.slow) if m == "adaptive_heun" else m for m in ADAPTIVE + FIXED],
)
def test_every_method_agrees_with_scipy(method: str) -> None:
    driven = oscillator().with_input(lambda t: torch.sin(3.0 * t))
    t = times(1.0, 101)
    with torch.no_grad():
        x = odeint(driven, rest(), t, method=method, rtol=1e-5)

    def rate(time: float, x: np.ndarray) -> list[float]:
        return [x[1] / 2.0, -8.0 * x[0] - 0.25 * x[1] + np.sin(3.0 * time)]

    reference = solve_ivp(rate, (0.0, 1.0), [0.0, 0.0], rtol=1e-10, atol=1e-12, t_eval=t.numpy()).y.T
    tolerance = {"euler": 3e-2, "bosh3": 1e-3, "fehlberg2": 2e-3}.get(method, 2e-4)
    assert np.abs(x.numpy() - reference).max() < tolerance * np.abs(reference).max()


@pytest.mark.parametrize(
    "storage",
    ["spring", pytest.param(ConvexEnergyMLP(1.0, 4.0, 4), marks=pytest.mark.slow)],
    ids=["analytic", "neural"],
)
def test_adjoint_gradients_agree_with_those_through_the_steps(storage: object) -> None:
    system = oscillator(storage=storage)
    driven = system.with_input(lambda t: torch.sin(3.0 * t))
    found = []
    for adjoint in (False, True):
        system.zero_grad()
        x0 = torch.tensor([0.3, -0.2], dtype=torch.float64, requires_grad=True)
        x = odeint(driven, x0, times(2.0, 21), rtol=1e-9, atol=1e-11, adjoint=adjoint)
        (x[:, 0] ** 2).sum().backward()
        grads = {n: p.grad.clone() for n, p in system.named_parameters() if p.grad is not None}
        found.append((x0.grad, grads))
    torch.testing.assert_close(found[0], found[1], rtol=1e-5, atol=1e-8)
    assert "free.z.b" in found[1][1]


def test_parameters_of_an_input_module_get_their_gradient() -> None:
    class Sine(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.amplitude = nn.Parameter(torch.tensor(1.0, dtype=torch.float64))

        def forward(self, t: Tensor) -> Tensor:
            return self.amplitude * torch.sin(3.0 * t)

    drive = Sine()
    x = odeint(oscillator().with_input(drive), rest(), times(2.0, 21), adjoint=True)
    x[-1, 0].backward()
    # The output is linear in the amplitude, which is one.
    assert drive.amplitude.grad is not None
    assert drive.amplitude.grad.item() == pytest.approx(x[-1, 0].item(), rel=1e-5)


def test_adjoint_refuses_a_tensor_it_would_not_differentiate_by() -> None:
    amplitude = torch.tensor(1.0, dtype=torch.float64, requires_grad=True)
    driven = oscillator().with_input(lambda t: amplitude * torch.sin(3.0 * t))
    with pytest.raises(InputRefused, match=r"register it .*nn\.Module"):
        odeint(driven, rest(), times(2.0, 21), adjoint=True)
    odeint(driven, rest(), times(2.0, 21)).sum().backward()
    assert amplitude.grad is not None


@pytest.mark.slow
def test_adjoint_is_refused_on_a_grid_too_coarse_for_its_fastest_mode() -> None:
    # b/m = 50 1/s with outputs one second apart: torchdiffeq alone returns a gradient that is wrong by orders.
    driven = oscillator(b=100.0).with_input(lambda t: torch.cos(t))
    assert fastest_decay(driven, torch.tensor(0.0, dtype=torch.float64), rest()) == pytest.approx(50.0, rel=1e-2)
    with pytest.raises(InputRefused, match=r"decays at 49\.\d .* product of 49\.\d .*adjoint=False"):
        odeint(driven, rest(), times(4.0, 5), adjoint=True)
    slopes = []
    for adjoint in (False, True):
        driven.zero_grad()
        odeint(driven, rest(), times(1.0, 41), adjoint=adjoint)[-1, 0].backward()
        slopes.append(driven.system.free.gradient("b"))
    assert slopes[1] == pytest.approx(slopes[0], rel=1e-4)


class Input(nn.Module):
    """An input that stops being a number."""

    def __init__(self, last: float) -> None:
        super().__init__()
        self.last = last

    def forward(self, t: Tensor) -> Tensor:
        return torch.where(t > self.last, torch.nan, torch.sin(t))


def test_a_first_evaluation_that_is_not_finite_is_named() -> None:
    with pytest.raises(SolverFailed, match=r"at t = 0 s .*input u\(t\)"):
        odeint(oscillator().with_input(Input(-1.0)), rest(), times(1.0, 5))
    with pytest.raises(SolverFailed, match="at t = 0 s the state"):
        odeint(oscillator(), rest() + torch.inf, times(1.0, 5))
    system = oscillator()
    with torch.no_grad():
        system.free.z["k"].fill_(torch.nan)
    with pytest.raises(SolverFailed, match="parameter k is not finite"):
        odeint(system, rest(), times(1.0, 5))


def test_underflow_in_dt_is_explained_by_its_nan() -> None:
    with torch.no_grad(), pytest.raises(SolverFailed, match=r"at t = 0\.(4|5)\d* s the input u\(t\) is not finite"):
        odeint(oscillator().with_input(Input(0.4)), rest(), times(1.0, 5))


class Cliff(nn.Module):
    """Finite everywhere, but without a solution beyond t = 1."""

    def forward(self, t: Tensor, x: Tensor) -> Tensor:
        return x**2 * torch.ones_like(x)


def test_underflow_in_dt_without_a_nan_names_its_time() -> None:
    x0 = torch.ones(1, dtype=torch.float64)
    with torch.no_grad(), pytest.raises(SolverFailed, match=r"at t = (0\.99\d*|1) s"):
        odeint(Cliff(), x0, times(2.0, 3))


def test_too_many_steps_name_the_stiffness() -> None:
    with torch.no_grad(), pytest.raises(SolverFailed, match="stiff"):
        odeint(oscillator(b=1e6), rest() + 1.0, times(1.0, 3), max_steps=100)


def test_a_fixed_grid_that_is_too_coarse_is_not_returned() -> None:
    with torch.no_grad(), pytest.raises(SolverFailed, match="rk4 is unstable"):
        odeint(oscillator(b=1e6), rest() + 1.0, times(100.0, 101), method="rk4")


def pulse(t: Tensor) -> Tensor:
    """A force of 1000 N for half a millisecond."""
    return torch.where((t >= 3.0) & (t < 3.0005), 1000.0, 0.0 * t)


def test_jump_times_keep_a_short_pulse() -> None:
    driven = oscillator().with_input(pulse)
    t = times(6.0, 7)
    knots = torch.tensor([3.0005, 3.0, 3.0, 50.0, -1.0], dtype=torch.float64)
    with torch.no_grad():
        missed, kept = odeint(driven, rest(), t), odeint(driven, rest(), t, jump_t=knots)
    assert missed.abs().max() == 0.0
    # The pulse gives an impulse of 0.5 N s, then the oscillation decays freely.
    w = np.sqrt(4.0 - 0.125**2)
    expected = 0.5 / (2.0 * w) * np.exp(-0.125 * 2.99975) * np.sin(w * 2.99975)
    assert kept[-1, 0].item() == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("method", ["dopri8", "bosh3"])
def test_outputs_are_not_spoiled_by_interpolation(method: str) -> None:
    t = times(2.0, 31)
    with torch.no_grad():
        fine = odeint(oscillator(), rest() + 0.1, t, rtol=1e-10)
        found = odeint(oscillator(), rest() + 0.1, t, method=method, rtol=1e-7)
    # torchdiffeq's own outputs are off by more than 1e-5 here.
    torch.testing.assert_close(found, fine, rtol=0.0, atol=3e-7)


@pytest.mark.parametrize(
    ("x0", "t", "method", "jump_t", "message"),
    [
        (rest().float(), times(1.0, 3), "dopri5", None, r"initial state .*\.double"),
        (rest(), times(1.0, 3).float(), "dopri5", None, r"output times .*\.double"),
        (rest(), -times(1.0, 3), "dopri5", None, "increasing"),
        (rest(), times(1.0, 3)[:1], "dopri5", None, "at least two"),
        (rest(), times(1.0, 3), "implicit_adams", None, "implicit_adams"),
        (rest(), times(1.0, 3), "rk4", times(1.0, 3), "jump times into t"),
    ],
)
def test_unusable_arguments_are_refused(
    x0: Tensor, t: Tensor, method: str, jump_t: Tensor | None, message: str
) -> None:
    with pytest.raises(InputRefused, match=message):
        odeint(oscillator(), x0, t, method=method, jump_t=jump_t)
