"""Training through `odeint_adjoint` ends where Gauss–Newton ends."""

from __future__ import annotations

import learn_example as example
import numpy as np
import pytest
import torch

from phnn.learn.gauss_newton import GaussNewton
from phnn.learn.methods import QuasiNewton
from phnn.learn.objective import Objective
from phnn.learn.plant import NetworkPlant
from phnn.learn.solvers import Torchdiffeq, compiled

WRONG = {"k": 2.3e4, "alpha": 0.045, "C_1": 4.0e-7, "rho_1": 2e-3, "d_1": 5.0}


def coordinates(plant: NetworkPlant) -> np.ndarray:
    """Logarithms of the values."""
    return np.log([plant.network.parameters[n].value for n in plant.names])


def test_the_adjoint_finds_the_optimum_of_gauss_newton_on_one_period_of_two_sines() -> None:
    direct, adjoint = example.parametric(**WRONG), example.parametric(**WRONG)
    exact = GaussNewton(Objective(direct, compiled, example.recordings(), substeps=4))
    for epoch in range(40):
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
    for solver in (compiled, Torchdiffeq(plant)):
        plant.zero_grad()
        Objective(plant, solver, example.recordings(), 20, 2)().backward()
        found.append(torch.cat([p.grad.reshape(-1) for p in plant.trained() if p.grad is not None]))
    assert float((found[0] - found[1]).abs().max()) < 1e-8 * float(found[0].abs().max())
