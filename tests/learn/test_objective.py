"""The loss and its windows, the solvers that agree on states and gradients, and Gauss–Newton."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import learn_example as example
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from torch import Tensor

from phnn.errors import InputRefused, PhnnError
from phnn.laws import RESISTOR_LAWS
from phnn.learn.objective import Objective, estimated_start, evaluate, substeps_needed
from phnn.learn.solvers import (
    NetworkPlant,
    Plant,
    Solver,
    Torchdiffeq,
    discrete_gradient,
    solver_for,
    starts_at_zero,
    thinned,
    windows_of,
)
from phnn.learn.starts import motion_of, scales_of
from phnn.learn.trainer import GaussNewton
from phnn.models.neural import inverse, thresholds
from phnn.network import MultiPort
from phnn.nn import LearnedDissipation
from phnn.recordings.recording import Part, Start
from phnn.setup import Setup
from phnn.trajectory import simulate


@pytest.mark.parametrize("stride", [1, 2, 5])
def test_thinning_keeps_samples_and_parts(stride: int) -> None:
    r = replace(example.recording(), parts=(Part("head", 0, 50, "nuisance"), Part("tail", 50, 81, "confirmation")))
    less = thinned(r, stride)
    assert less.dt == pytest.approx(stride * r.dt)
    np.testing.assert_array_equal(less.y, r.y[::stride])
    kept = np.zeros(81, dtype=bool)
    kept[::stride] = True
    for use in ("nuisance", "confirmation"):
        np.testing.assert_array_equal(less.mask(use), r.mask(use)[kept])
    assert less.noise == r.noise


def test_only_rest_without_input_is_a_known_start() -> None:
    r = example.recording()
    assert starts_at_zero(r)
    for start in (Start("rest", 2.0), Start("unknown"), Start("periodic")):
        assert not starts_at_zero(replace(r, start=start))


def test_the_loss_is_one_at_the_truth_and_sees_no_zero() -> None:
    objective = Objective(example.parametric(), discrete_gradient, example.recordings(), substeps=4)
    loss = float(objective().detach())
    # 162 samples: the standard deviation of the loss is 0.11.
    assert loss == pytest.approx(1.0, abs=0.35)
    shifted = [replace(r, y=r.y + 1e-3) for r in example.recordings()]
    assert float(Objective(example.parametric(), discrete_gradient, shifted, substeps=4)().detach()) == pytest.approx(
        loss
    )


@settings(max_examples=8, deadline=None)
@given(st.integers(20, 81))
def test_windows_on_the_way_of_the_model_change_nothing(length: int) -> None:
    plant = example.parametric(d_1=6.0)
    whole = Objective(plant, discrete_gradient, example.recordings())
    cut = Objective(plant, discrete_gradient, example.recordings(), length)
    assert float(cut().detach()) == pytest.approx(float(whole().detach()), rel=1e-9)


def test_a_jump_counts_as_the_residual_it_makes() -> None:
    plant = example.parametric()
    (r, _) = example.recordings()
    objective = Objective(plant, discrete_gradient, [r], 41, continuity=7.0)
    (second,) = [k for k, w in enumerate(objective.windows) if w.continues]
    assert objective.unknown == [second]
    noise = r.noise / float(np.std(r.y))
    before = float(objective().detach())
    parts = {}
    for weight in (7.0, 14.0):
        objective.continuity = weight
        with torch.no_grad():
            objective.offsets.fill_(2.0 * noise)
            parts[weight] = float(objective())
    # Two typical noises in every state: four a state and join, whatever the residual becomes by it.
    assert parts[14.0] - parts[7.0] == pytest.approx(7.0 * 4.0, rel=1e-6)
    assert parts[7.0] > before


def test_an_unknown_start_is_found_from_the_first_samples() -> None:
    whole = example.recording(50.0, 161)
    first = 50
    tail = replace(
        whole, name="tail", t=whole.t[first:] - whole.t[first], u=whole.u[first:], y=whole.y[first:],
        start=Start("unknown"), parts=(Part("head", 0, 50, "nuisance"), Part("tail", 50, 111, "confirmation")),
    )  # fmt: skip
    plant = example.parametric()
    x0 = estimated_start(plant, discrete_gradient, tail, 2)
    true = simulate(Setup(plant.network), whole, 2).states[2 * first]
    assert float(x0[1]) == pytest.approx(true[1], abs=0.05e-4)
    scores = evaluate(plant, discrete_gradient, [whole, tail], 2, {})
    (held,) = [p for p in scores.parts if p.use == "confirmation"]
    assert held.residual_over_noise < 1.5
    assert scores.parts[0].residual_over_noise == pytest.approx(1.0, abs=0.2)


@settings(max_examples=25, deadline=None)
@given(st.floats(0.5, 20.0), st.floats(1e-6, 10.0))
def test_thresholds_of_a_dead_zone_are_its_own(width: float, rho: float) -> None:
    def law(effort: torch.Tensor) -> torch.Tensor:
        return RESISTOR_LAWS["dead_zone"].flow(effort, None, rho, width)

    largest = rho * 0.4 * width
    assert thresholds(law, largest, 2.0 * width) == pytest.approx((-0.5 * width, 0.5 * width), rel=1e-6)
    flows = np.array([-largest, 0.3 * largest])
    np.testing.assert_allclose(inverse(law, flows, 2.0 * width), flows / rho + 0.5 * width * np.sign(flows), rtol=1e-6)
    with pytest.raises(PhnnError, match="carries no"):
        inverse(law, 10.0 * flows, width)


def test_scales_come_from_the_recordings() -> None:
    found = scales_of(example.recordings())
    motion = motion_of(example.recordings())
    assert found.input == pytest.approx(75.0, rel=1e-3)
    assert found.time == pytest.approx(1.0 / (2 * np.pi * 120.0), rel=0.02)
    assert found.output == motion.reach == pytest.approx(max(0.5 * np.ptp(r.y) for r in example.recordings()))
    assert motion.speed == pytest.approx(2 * np.pi * 120.0 * 0.5 * np.ptp(example.recordings()[1].y), rel=0.05)


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


@pytest.mark.parametrize("kind", ["fully_neural", "neural_ode"])
def test_adaptive_torchdiffeq_is_exact_on_recordings_of_different_rates(kind: str) -> None:
    plant = KINDS[kind]()
    found = whole(Torchdiffeq(plant, "dopri5", adjoint=False, rtol=3e-6, atol=1e-7), plant)
    assert error(found, reference(plant)) < 1e-4


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


def unknown_start() -> list:
    first, second = example.recordings()
    return [first, replace(second, start=Start("unknown"))]


def hybrid() -> NetworkPlant:
    """The known network and a law on two efforts that only torch evaluates."""
    law = LearnedDissipation(2, effort_scale=(20.0, 0.1), flow_scale=(1e-5, 1e-3), width=4)
    network = example.parametric().network.extend(multi_ports=(MultiPort("learned", law, on=("Q_1", "p")),))
    return NetworkPlant(network, example.parametric().scale)


PLANTS: dict[str, Callable[[], NetworkPlant]] = {
    "parametric": example.parametric, "hybrid": hybrid, "damping": lambda: example.neural(3),
    "monotone": lambda: example.neural(3, law="monotone"), "spring": lambda: example.neural(3, spring_width=3),
}  # fmt: skip


@pytest.mark.parametrize("kind", PLANTS)
def test_derivatives_by_weights_and_initial_states_are_exact(kind: str) -> None:
    method = GaussNewton(Objective(PLANTS[kind](), discrete_gradient, unknown_start(), substeps=2))
    o, random = method.objective, torch.Generator().manual_seed(0)
    residual, jacobian = method.linearised()
    assert residual @ residual / residual.size == pytest.approx(float(o().detach()))
    before = o.present()
    for _ in range(3):
        direction, moved = [torch.randn(p.shape, generator=random, dtype=torch.float64) for p in before], []
        for sign in (1e-6, -1e-6):
            o.move_to([p + sign * d for p, d in zip(before, direction, strict=True)])
            moved.append(o.residuals(o.outputs()).detach().numpy())
        difference = (moved[0] - moved[1]) / 2e-6
        by = jacobian @ torch.cat([d.flatten() for d in direction]).numpy()
        assert np.abs(by - difference).max() < 1e-4 * np.abs(difference).max()


def test_parametric_values_are_found_in_a_few_steps() -> None:
    plant = example.parametric(k=2.3e4, alpha=0.045, C_1=4.0e-7, rho_1=2e-3, d_1=5.0)
    objective = Objective(plant, discrete_gradient, example.recordings(), substeps=4)
    method = GaussNewton(objective)
    losses = [method(epoch) for epoch in range(15)]
    true = float(Objective(example.parametric(), discrete_gradient, example.recordings(), substeps=4)().detach())
    assert losses[0] > 1e3
    assert 0.5 < losses[-1] < true
    assert all(b <= a for a, b in pairwise(losses))
    found, values = plant.network.parameters, example.VALUES
    for top, bottom in (("k", "alpha"), ("alpha", "C_1"), ("rho_1", "C_1")):
        assert found[top].value / found[bottom].value == pytest.approx(values[top] / values[bottom], rel=0.03)
    assert found["d_1"].value == pytest.approx(values["d_1"], rel=0.02)


def test_what_it_cannot_do_is_refused() -> None:
    plant = example.neural(3)
    for objective in (
        Objective(plant, discrete_gradient, example.recordings(), 28),
        Objective(plant, Torchdiffeq(plant), example.recordings()),
    ):
        with pytest.raises(InputRefused, match="set gauss_newton=0"):
            GaussNewton(objective)


def test_a_law_on_several_variables_is_found_by_gauss_newton_in_torch() -> None:
    method = GaussNewton(Objective(hybrid(), discrete_gradient, unknown_start(), substeps=2))
    losses = [method(epoch) for epoch in range(4)]
    assert losses[-1] < 0.9 * losses[0]
    assert all(b <= a for a, b in pairwise(losses))


def test_substeps_of_laws_without_a_kernel_are_found_on_pieces() -> None:
    plant, known = hybrid(), example.parametric()
    found = [substeps_needed(p, discrete_gradient, example.recordings()) for p in (plant, known)]
    assert found[0] > 1
    assert max(found) <= 2 * min(found)
