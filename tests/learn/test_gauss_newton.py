"""Gauss–Newton: exact derivatives by weights, quick descent, refusals; training by the adjoint ends where it ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import learn_example as example
import numpy as np
import pytest
import torch

from phnn.errors import InputRefused
from phnn.learn.objective import Objective, substeps_needed
from phnn.learn.solvers import NetworkPlant, Torchdiffeq, discrete_gradient
from phnn.learn.trainer import GaussNewton, QuasiNewton
from phnn.network import MultiPort
from phnn.nn import LearnedDissipation
from phnn.recordings.recording import Start


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


WRONG = {"k": 2.3e4, "alpha": 0.045, "C_1": 4.0e-7, "rho_1": 2e-3, "d_1": 5.0}


def coordinates(plant: NetworkPlant) -> np.ndarray:
    """Logarithms of the values."""
    return np.log([p.value for p in plant.network.parameters.values() if not p.fixed])


def test_the_adjoint_finds_the_optimum_of_gauss_newton_on_one_period_of_two_sines() -> None:
    direct, adjoint = example.parametric(**WRONG), example.parametric(**WRONG)
    exact = GaussNewton(Objective(direct, discrete_gradient, example.recordings(), substeps=4))
    for epoch in range(15):
        exact(epoch)
    objective = Objective(adjoint, Torchdiffeq(adjoint), example.recordings(), substeps=4)
    method, losses = QuasiNewton(objective, 10), []
    for epoch in range(20):
        losses.append(method(epoch))
        if epoch and losses[-2] - losses[-1] < 1e-9 * losses[-1]:
            break
    assert losses[-1] == pytest.approx(float(exact.objective().detach()), rel=1e-4)
    assert losses[-1] < 1.4 < 100.0 < losses[0]
    # The distance of the two ends in standard errors, whatever the recordings leave open (a factor common to most).
    _, jacobian = exact.linearised()
    apart = jacobian @ (coordinates(adjoint) - coordinates(direct))
    assert float(np.linalg.norm(apart)) < 0.3


def test_one_gradient_of_the_adjoint_is_that_of_the_exact_sweep() -> None:
    plant = example.neural(3)
    found = []
    for solver in (discrete_gradient, Torchdiffeq(plant)):
        plant.zero_grad()
        Objective(plant, solver, example.recordings(), 20, 2)().backward()
        found.append(torch.cat([p.grad.reshape(-1) for p in plant.trained() if p.grad is not None]))
    assert float((found[0] - found[1]).abs().max()) < 1e-8 * float(found[0].abs().max())


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
