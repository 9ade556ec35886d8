"""All solvers find the same states and gradients, which stiff reference solvers and finite differences confirm."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import learn_example as example
import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from torch import Tensor

from phnn.errors import InputRefused
from phnn.learn.objective import Objective
from phnn.learn.solvers import Plant, Solver, Torchdiffeq, discrete_gradient, solver_for, thinned, windows_of

KINDS: dict[str, Callable[[], Plant]] = {
    "neural": example.neural, "fully_neural": example.fully_neural, "neural_ode": example.neural_ode,
}  # fmt: skip


def whole(solver: Solver, plant: Plant, substeps: int = 1) -> list[Tensor]:
    """Outputs on both recordings from rest."""
    with torch.no_grad():
        return Objective(plant, solver, example.recordings(), 0, substeps).outputs()


def reference(plant: Plant) -> list[np.ndarray]:
    """The same with scipy, which takes only the right-hand side."""
    found = []
    for r in example.recordings():
        spline = make_interp_spline(r.t, r.u, k=3)

        def field(t: float, x: np.ndarray, u: Callable[[float], float] = spline) -> np.ndarray:
            with torch.no_grad():
                scaled = torch.from_numpy(x) * plant.scale
                return (plant.rate(scaled, torch.tensor(float(u(t)), dtype=torch.float64)) / plant.scale).numpy()

        zero = np.zeros(plant.scale.numel())
        path = solve_ivp(field, (0.0, r.t[-1]), zero, "LSODA", r.t, rtol=1e-7, atol=1e-9)
        with torch.no_grad():
            found.append(plant.measured(torch.from_numpy(path.y.T) * plant.scale).numpy())
    return found


def error(found: list[Tensor], exact: list[np.ndarray]) -> float:
    return max(float(np.abs(a.numpy() - b).max() / np.abs(b).max()) for a, b in zip(found, exact, strict=True))


@cache
def adaptive(kind: str) -> list[np.ndarray]:
    """What dopri5 makes of them."""
    plant = KINDS[kind]()
    return [y.numpy() for y in whole(Torchdiffeq(plant, "dopri5", adjoint=False, rtol=3e-6, atol=1e-7), plant)]


@pytest.mark.parametrize("kind", ["fully_neural", "neural_ode"])
def test_adaptive_torchdiffeq_is_exact_on_recordings_of_different_rates(kind: str) -> None:
    assert error([torch.from_numpy(y) for y in adaptive(kind)], reference(KINDS[kind]())) < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "solver"), [("neural", discrete_gradient), ("fully_neural", discrete_gradient)])
def test_power_preserving_marches_converge_with_the_square_of_the_step(kind: str, solver: Solver) -> None:
    plant = KINDS[kind]()
    exact = adaptive(kind)
    coarse, fine = (error(whole(solver, plant, n), exact) for n in (2, 4))
    assert coarse < 0.02
    assert 3.0 < coarse / fine < 5.5


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("neural", {"name": "discrete_gradient"}),
        ("neural", {"name": "torchdiffeq"}),
        ("neural", {"name": "torchdiffeq", "adjoint": False}),
        pytest.param("neural", {"name": "torchdiffeq", "method": "phnn"}, marks=pytest.mark.slow),
        pytest.param("neural", {"name": "torchdiffeq", "method": "phnn", "adjoint": False}, marks=pytest.mark.slow),
        ("fully_neural", {"name": "discrete_gradient"}),
        ("fully_neural", {"name": "torchdiffeq", "method": "rk4", "adjoint": False}),
        ("neural_ode", {"name": "torchdiffeq", "method": "rk4", "adjoint": False}),
    ],
    ids=lambda v: v if isinstance(v, str) else "-".join(str(w) for w in v.values()),
)
def test_gradients_are_those_of_the_states_computed(kind: str, options: dict[str, object]) -> None:
    plant = KINDS[kind]()
    objective = Objective(plant, solver_for(options, plant), [thinned(example.recording(), 4)], 12, 2)
    random = torch.Generator().manual_seed(1)
    with torch.no_grad():
        objective.offsets.copy_(0.1 * torch.randn(objective.offsets.shape, generator=random, dtype=torch.float64))
    objective().backward()
    direction = [torch.randn(p.shape, generator=random, dtype=torch.float64) for p in objective.trained()]
    pairs = list(zip(objective.trained(), direction, strict=True))
    slope = sum(float((p.grad * d).sum()) for p, d in pairs if p.grad is not None)
    size, values = 1e-7, []
    for sign in (1.0, -1.0):
        with torch.no_grad():
            for p, d in pairs:
                p.add_(sign * size * d)
            values.append(float(objective()))
            for p, d in pairs:
                p.sub_(sign * size * d)
    assert slope == pytest.approx((values[0] - values[1]) / (2 * size), rel=2e-4)


@pytest.mark.parametrize("kind", ["fully_neural", "neural_ode"])
def test_windows_in_a_batch_do_not_see_each_other(kind: str) -> None:
    plant = KINDS[kind]()
    solver = discrete_gradient if kind == "fully_neural" else Torchdiffeq(plant, "rk4", adjoint=False)
    windows = windows_of(example.recordings(), 30, 1) + windows_of(example.recordings(), 60, 1)
    random = torch.Generator().manual_seed(3)
    x0 = 0.3 * plant.scale * torch.randn(len(windows), 3, generator=random, dtype=torch.float64)
    with torch.no_grad():
        together = solver(plant, windows, x0)
        for k, w in enumerate(windows):
            (alone,) = solver(plant, [w], x0[k : k + 1])
            torch.testing.assert_close(together[k], alone, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize(
    ("plant", "options", "words"),
    [
        (example.neural_ode, {"name": "discrete_gradient"}, "needs an energy.*NeuralODE"),
        (example.neural_ode, {"name": "torchdiffeq"}, "for networks: take rk4 or dopri5"),
        (example.neural, {"name": "euler"}, "choose discrete_gradient or torchdiffeq"),
        (example.neural, {"name": "torchdiffeq", "order": 4}, "takes method, adjoint, rtol and atol"),
        (example.neural, {"name": "discrete_gradient", "rtol": 1e-3}, "has no options"),
    ],
)
def test_solvers_that_do_not_suit_are_refused(
    plant: Callable[[], Plant], options: dict[str, object], words: str
) -> None:
    with pytest.raises(InputRefused, match=words):
        solver_for(options, plant())
