"""Gauss–Newton steps: exact derivatives by weights, quick descent, refusal where they cannot be had."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import learn_example as example
import numpy as np
import pytest
import torch

from phnn.errors import InputRefused
from phnn.learn.gauss_newton import GaussNewton
from phnn.learn.objective import Objective
from phnn.learn.solvers import Torchdiffeq, compiled
from phnn.recordings.recording import Start


def unknown_start() -> list:
    first, second = example.recordings()
    return [first, replace(second, start=Start("unknown"))]


@pytest.mark.parametrize("others", [{}, {"law": "monotone"}, {"spring_width": 3}], ids=str)
def test_derivatives_by_weights_and_initial_states_are_exact(others: dict[str, Any]) -> None:
    plant = example.neural(3, **others)
    method = GaussNewton(Objective(plant, compiled, unknown_start()))
    o = method.objective
    residual, jacobian = method.linearised()
    assert residual @ residual / residual.size == pytest.approx(float(o().detach()))
    random = torch.Generator().manual_seed(0)
    for _ in range(3):
        direction = [torch.randn(p.shape, generator=random, dtype=torch.float64) for p in o.trained()]
        moved = []
        for sign in (1e-6, -1e-6):
            with torch.no_grad():
                for p, d in zip(o.trained(), direction, strict=True):
                    p.add_(sign * d)
                moved.append(o.residuals(o.outputs()).numpy())
                for p, d in zip(o.trained(), direction, strict=True):
                    p.sub_(sign * d)
        slope = jacobian @ torch.cat([d.reshape(-1) for d in direction]).numpy()
        difference = (moved[0] - moved[1]) / 2e-6
        assert np.abs(slope - difference).max() < 1e-4 * np.abs(difference).max()


def test_parametric_values_are_found_in_a_few_steps() -> None:
    plant = example.parametric(k=2.3e4, alpha=0.045, C_1=4.0e-7, rho_1=2e-3, d_1=5.0)
    objective = Objective(plant, compiled, example.recordings(), substeps=4)
    method = GaussNewton(objective)
    losses = [method(epoch) for epoch in range(15)]
    true = float(Objective(example.parametric(), compiled, example.recordings(), substeps=4)().detach())
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
        Objective(plant, compiled, example.recordings(), 28),
        Objective(plant, Torchdiffeq(plant), example.recordings()),
    ):
        with pytest.raises(InputRefused, match="set gauss_newton=0"):
            GaussNewton(objective)
