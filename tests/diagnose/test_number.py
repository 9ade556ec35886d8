"""The number of a model, against sums written out by hand and against what it promises."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phnn.criteria import Criteria
from phnn.diagnose.number import Misfit, Visited, best_to_write, log_weight, tolerated, weigh
from phnn.effects import Effect, effect
from phnn.effects.learned import learned_elements
from phnn.errors import InputRefused

CRITERIA = Criteria()
NAMES = ["creep", "delay", "coulomb_friction", "quadratic_drag", "sensor_lag"]


def visited(
    *elements: Effect, left: tuple[float, ...] = (1.0, 1.0), held_out: tuple[float, ...] = (1.0,), samples: int = 2000
) -> Visited:
    """A model that leaves some mean squares of two fitted recordings and one held-out one."""
    parameters = {n: SimpleNamespace(fixed=False) for e in elements for n in e.parameters}
    fit: Any = SimpleNamespace(setup=SimpleNamespace(parameters=parameters))
    fitted = {f"r{i}": Misfit(v * samples, samples) for i, v in enumerate(left)}
    unseen = {f"h{i}": Misfit(v * samples, samples) for i, v in enumerate(held_out)}
    return Visited(elements, fit, fitted, unseen, converged=True)


def test_the_number_is_the_sum_in_its_docstring() -> None:
    model = visited(effect("creep"), left=(1.3, 0.9), held_out=(1.1,))
    rho = {"r0": 0.02}
    counts = [2000 / (1 + 2000 * 0.02), 2000 / (1 + 2000 * 0.005)]
    likelihood = counts[0] * 1.3 + counts[1] * 0.9
    wanted = -0.5 * likelihood - 0.5 * 2 * math.log(sum(counts)) - CRITERIA.price_effect
    assert log_weight(model, rho, CRITERIA) == pytest.approx(wanted, rel=1e-12)


def test_terms_of_each_recording_are_paid_for_like_parameters() -> None:
    model = visited(effect("mains_pickup"))
    paid = log_weight(model, {}, CRITERIA) - log_weight(replace(model, nuisances=12), {}, CRITERIA)
    counts = 2 * 2000 / (1 + 2000 * 0.005)
    assert paid == pytest.approx(6 * math.log(counts), rel=1e-12)


def test_a_learned_element_costs_more_than_an_effect() -> None:
    learned = learned_elements()["learned_spring"]
    assert not learned.several_of
    difference = log_weight(visited(learned), {}, CRITERIA) - log_weight(visited(), {}, CRITERIA)
    assert difference < -CRITERIA.price_learned


def test_half_of_what_the_best_model_leaves_is_tolerated_and_no_less_than_the_floor() -> None:
    models = [visited(left=(9.0, 9.0)), visited(effect("creep"), left=(3.1, 1.0))]
    rho = tolerated(models, CRITERIA)
    assert rho["r0"] == pytest.approx(0.5 * (3.1 - CRITERIA.slack))
    assert rho["r1"] == pytest.approx(0.5 * CRITERIA.material**2)


@given(st.lists(st.floats(0.5, 50.0), min_size=2, max_size=6))
@settings(max_examples=50, deadline=None)
def test_probabilities_are_those_of_alternatives(left: list[float]) -> None:
    models = [visited(left=(left[0], 1.0))]
    models += [visited(effect(n), left=(v, 1.0)) for n, v in zip(NAMES, left[1:], strict=False)]
    found = weigh(models, CRITERIA)
    assert sum(found.probability.values()) == pytest.approx(1.0)
    assert sum(share for _, share in found.alternatives) == pytest.approx(1.0)
    assert found.logs[0] == max(found.logs)
    assert list(found.probability.values()) == sorted(found.probability.values(), reverse=True)


def test_all_forms_and_copies_of_an_effect_count_together() -> None:
    creep, relaxation = effect("creep"), learned_elements()["learned_relaxation"]
    found = weigh([visited(left=(20.0, 20.0)), visited(creep), visited(relaxation)], CRITERIA)
    assert found.probability["creep"] == pytest.approx(1.0)


def test_a_model_that_is_far_from_all_recordings_makes_nothing_certain() -> None:
    near = weigh([visited(effect("creep"), left=(1.0, 1.0)), visited(effect("delay"), left=(1.1, 1.1))], CRITERIA)
    models = [visited(effect("creep"), left=(30.0, 30.0)), visited(effect("delay"), left=(33.0, 33.0))]
    assert near.probability["creep"] > 0.95
    assert weigh(models, CRITERIA).probability["creep"] < 0.9
    # Unless what it leaves is the noise itself.
    assert weigh(models, CRITERIA, exact=models[0]).probability["creep"] > 0.95


def test_more_samples_than_the_misfit_allows_do_not_count() -> None:
    few = [visited(samples=1000, left=(1.02, 1.02)), visited(effect("creep"), samples=1000)]
    many = [visited(samples=1_000_000, left=(1.02, 1.02)), visited(effect("creep"), samples=1_000_000)]
    odds = [np.diff(weigh(models, CRITERIA).logs)[0] for models in (few, many)]
    assert abs(odds[0] - odds[1]) < 3.0


@given(st.lists(st.tuples(st.floats(0.5, 9.0), st.floats(0.5, 9.0)), min_size=1, max_size=5))
@settings(max_examples=50, deadline=None)
def test_the_model_that_is_written_predicts_no_worse_than_the_base(left: list[tuple[float, float]]) -> None:
    base = visited(left=(5.0, 5.0), held_out=(5.0,))
    others = [visited(effect(n), left=(a, a), held_out=(b,)) for n, (a, b) in zip(NAMES, left, strict=False)]
    chosen = best_to_write([base, *others], CRITERIA)
    assert math.sqrt(chosen.left_held_out) <= math.sqrt(5.0) * (1.0 + CRITERIA.material_share) + 1e-12


def test_a_small_gain_is_written_though_no_name_is_sure() -> None:
    base, small = visited(left=(1.08, 1.08), held_out=(1.08,)), visited(effect("creep"))
    assert best_to_write([base, small], CRITERIA) is small


def test_held_out_recordings_are_no_part_of_the_number() -> None:
    near, far = visited(effect("creep"), held_out=(1.0,)), visited(effect("creep"), held_out=(50.0,))
    assert log_weight(near, {}, CRITERIA) == log_weight(far, {}, CRITERIA)


def test_without_held_out_recordings_the_fitted_ones_decide() -> None:
    base, better = visited(left=(5.0, 5.0), held_out=()), visited(effect("creep"), held_out=())
    assert best_to_write([base, better], CRITERIA) is better


def test_criteria_are_few_and_each_names_its_case() -> None:
    rows = Criteria.table()
    assert len(rows) <= 16
    assert all(row["needed"] and row["meaning"] and row["unit"] for row in rows)


@pytest.mark.parametrize(
    ("given_values", "told"),
    [
        ({"materal": 1.0}, "material"),
        ({"material": -1.0}, "positive"),
        ({"short": 2.5}, "whole"),
        ({"beam": True}, "positive"),
    ],
)
def test_criteria_that_are_wrong_are_refused(given_values: dict[str, float], told: str) -> None:
    with pytest.raises(InputRefused, match=told):
        Criteria().with_values(given_values)


def test_criteria_are_replaced_by_name() -> None:
    changed = Criteria().with_values({"material": 0.2, "beam": 2})
    assert changed.changed() == {"material": 0.2, "beam": 2}
    assert isinstance(changed.beam, int)
