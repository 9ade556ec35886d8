"""The screen, against least squares that share no code with it."""

from __future__ import annotations

from dataclasses import replace

import campaigns
import numpy as np
import pytest

from phnn.criteria import Criteria
from phnn.diagnose import screen as module
from phnn.diagnose.linearised import LinearisedFit, direction
from phnn.diagnose.screen import Screen
from phnn.effects import effect
from phnn.effects.learned import learned_elements
from phnn.effects.places import attached


@pytest.fixture(scope="module")
def base() -> LinearisedFit:
    return campaigns.linearised("creep")


def fall_by_refit(linearised: LinearisedFit, columns: np.ndarray) -> float:
    """By how much χ² falls when columns join the model's own sensitivities in one least-squares problem."""
    fit = linearised.fit
    before = np.linalg.lstsq(fit.jacobian, fit.residual, rcond=None)[0]
    design = np.column_stack([fit.jacobian, columns])
    after = np.linalg.lstsq(design, fit.residual, rcond=None)[0]
    left = [fit.residual - fit.jacobian @ before, fit.residual - design @ after]
    return float(left[0] @ left[0] - left[1] @ left[1])


@pytest.mark.parametrize("name", ["delay", "quadratic_stiffness", "electrostriction"])
def test_the_predicted_fall_is_that_of_a_joint_least_squares_fit(base: LinearisedFit, name: str) -> None:
    candidate = effect(name)
    (found,) = Screen(base, [candidate], Criteria())(base)
    best = 0.0
    for point in candidate.grid(base.scales):
        column = direction(base, candidate, point)
        slope = float(column @ base.residual)
        if slope > 0.0 or not candidate.one_sided:
            best = max(best, fall_by_refit(base, column))
    assert found.fall == pytest.approx(best, rel=1e-3, abs=1e-3)


def test_the_concealed_effect_promises_most_and_stands_out(base: LinearisedFit) -> None:
    names = ["delay", "creep", "quadratic_drag", "sensor_nonlinearity", "quadratic_stiffness"]
    found = Screen(base, [effect(n) for n in names], Criteria())(base)
    assert found[0].effect.name == "creep"
    assert found[0].score > Criteria().score
    assert [c.fall for c in found] == sorted((c.fall for c in found), reverse=True)


def test_nothing_stands_out_where_nothing_is_missing() -> None:
    base = campaigns.linearised()
    names = ["delay", "creep", "quadratic_drag", "sensor_nonlinearity", "quadratic_stiffness", "mains_pickup"]
    found = Screen(base, [effect(n) for n in names], Criteria())(base)
    material = Criteria().material ** 2 * base.residual.size
    assert not [c.effect.name for c in found if c.score > Criteria().score and c.fall > material]


def test_strengths_of_a_learned_element_stay_within_their_bounds(base: LinearisedFit) -> None:
    relaxation = learned_elements()["learned_relaxation"]
    (found,) = Screen(base, [relaxation], Criteria())(base)
    (alone,) = Screen(base, [effect("creep")], Criteria())(base)
    # Six springs at spaced times explain a creep of one time, and no more than all columns without bounds would.
    assert 0.5 * alone.fall < found.fall
    assert found.fall <= float(base.residual @ base.residual)


def test_directions_are_computed_once(base: LinearisedFit, monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Screen(base, [effect("delay"), effect("creep")], Criteria())
    first = screen(base)
    monkeypatch.setattr(module, "direction", lambda *_: pytest.fail("computed again"))
    again = screen(base)
    assert [(c.effect.name, c.fall) for c in again] == [(c.effect.name, c.fall) for c in first]


def test_a_further_copy_stands_in_the_screen_of_a_model_that_has_the_first(base: LinearisedFit) -> None:
    setup = base.fit.setup
    first, second, third = attached(effect("creep"), setup)
    values = {"k_s": 0.05 * setup.values()["k"], "tau_s": 0.3}
    grown = replace(base, fit=replace(base.fit, setup=first.add_to(setup, values)))
    screen = Screen(base, [first, second, third], Criteria())
    assert [c.effect for c in screen(base)] == [first]
    (found,) = screen(grown)
    assert found.effect == second
    assert found.fall == pytest.approx(screen(base)[0].fall)
