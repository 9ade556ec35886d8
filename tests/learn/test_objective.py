"""The loss is residual over noise without the displacement zero; windows add their jumps; starts are estimated."""

from __future__ import annotations

from dataclasses import replace

import learn_example as example
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from phnn.errors import PhnnError
from phnn.laws import RESISTOR_LAWS
from phnn.learn.objective import Objective, estimated_start, evaluate
from phnn.learn.solvers import discrete_gradient, starts_at_zero, thinned
from phnn.learn.starts import motion_of, scales_of
from phnn.models.neural import inverse, thresholds
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
