"""The number of a model, against sums written out by hand, and the verdict: each rule decides a case of its own."""

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
from phnn.diagnose.number import Misfit, Visited, Weighed, best_to_write, log_weight, tolerated, weigh
from phnn.diagnose.verdict import EQUIVALENT, NAMED, NONE, RULES, UNKNOWN, Facts, Verdict, conclude, denied
from phnn.effects import Effect, effect, in_all_forms
from phnn.effects.learned import learned_elements

CRITERIA = Criteria()
NAMES = ["creep", "delay", "coulomb_friction", "quadratic_drag", "sensor_lag"]


def visited(
    *elements: Effect, left: tuple[float, ...] = (1.0, 1.0), held_out: tuple[float, ...] = (1.0,), samples: int = 2000
) -> Visited:
    """A model that leaves some mean squares of two fitted recordings and one held-out one."""
    parameters = {n: SimpleNamespace(fixed=False) for e in elements for n in e.parameters}
    fit: Any = SimpleNamespace(setup=SimpleNamespace(parameters=parameters), explained=0.99)
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


PROVEN = Facts(
    elements=1, learned=0, none=0.0, certain=0.99, alternatives=1, exchangeable=True, complete=1.0, base_left=9.0,
    explained=0.99, falls=True, new=True, promising=5, remaining=0, early=False, criteria=CRITERIA,
)  # fmt: skip


def decided(facts: Facts) -> tuple[str, str]:
    """The rule that applies first, and its word."""
    rule = next(r for r in RULES if r.applies(facts))
    return rule.name, rule.word


@pytest.mark.parametrize(
    ("changes", "rule", "word"),
    [
        ({}, "every_element_is_proven", NAMED),
        ({"promising": 0, "elements": 0, "none": 1.0, "base_left": 3.0}, "nothing_promises", NONE),
        ({"none": 0.7, "base_left": 1.1}, "the_base_model_is_enough", NONE),
        ({"none": 1.0, "elements": 0}, "nothing_helps", UNKNOWN),
        ({"promising": 0, "elements": 0, "none": 1.0, "base_left": 1.0, "explained": 0.02}, "nothing_helps", UNKNOWN),
        ({"early": True}, "the_search_ended_early", UNKNOWN),
        ({"learned": 1, "complete": 0.5}, "an_element_is_learned", UNKNOWN),
        ({"complete": 0.7}, "something_is_left", UNKNOWN),
        ({"falls": False}, "held_out_recordings_deny_it", UNKNOWN),
        ({"new": False}, "held_out_recordings_are_not_new", EQUIVALENT),
        ({"certain": 0.6, "alternatives": 3}, "a_class_is_proven", EQUIVALENT),
        ({"elements": 2, "certain": CRITERIA.proven}, "every_element_is_proven", NAMED),
        ({"certain": CRITERIA.proven - 1e-9, "alternatives": 3}, "a_class_is_proven", EQUIVALENT),
    ],
)
def test_every_rule_decides_a_case(changes: dict[str, object], rule: str, word: str) -> None:
    assert decided(replace(PROVEN, **changes)) == (rule, word)  # type: ignore[arg-type]


def test_rules_are_few_and_none_is_without_its_case() -> None:
    assert len(RULES) <= 10
    assert all(r.needed and r.numbers for r in RULES)
    assert len({r.name for r in RULES}) == len(RULES)


@pytest.mark.parametrize(("left", "bound"), [(1.0, 0.5), (4.8, 0.5), (30.0, 0.2)])
def test_what_a_model_leaves_lowers_all_probabilities_unless_nothing_explains_it(left: float, bound: float) -> None:
    model = visited(effect("creep"), left=(left, left), held_out=(left,))
    models = [model, visited(left=(900.0, 900.0), held_out=(900.0,))]
    found = [conclude(weigh(models, CRITERIA), model, True, (3, remaining), CRITERIA) for remaining in (0, 1)]
    assert [f.word for f in found] == [NAMED if left < 9.0 else UNKNOWN, UNKNOWN]
    # A half, or √(1.2/left).
    assert found[1].probability["creep"] == pytest.approx(bound, rel=0.01)
    assert found[1].claims[0].status == "likely"


def test_alternatives_of_which_one_is_that_nothing_is_missing_are_no_class() -> None:
    facts = replace(PROVEN, certain=0.1, alternatives=3, base_left=18.0, none=0.84)
    assert all(not rule.applies(facts) for rule in RULES)


def concluded(*models: Visited, chosen: int = 0, new: bool = True) -> Verdict:
    """The verdict on some models of which one is written."""
    return conclude(weigh(models, CRITERIA), models[chosen], new, (3, 0), CRITERIA)


BASE = visited(left=(9.0, 9.0), held_out=(9.0,))
CREEP = visited(effect("creep"))


def test_one_proven_effect_is_named() -> None:
    found = concluded(CREEP, BASE, visited(effect("delay"), left=(4.0, 4.0), held_out=(4.0,)))
    assert found.word == NAMED
    assert [c.name for c in found.claimed] == ["creep"]
    assert found.claims[0].share == pytest.approx(1.0)
    assert found.claims[0].without is BASE


def test_effects_that_explain_as_much_are_a_class() -> None:
    found = concluded(visited(effect("delay")), BASE, visited(effect("sensor_lag")))
    assert found.word == EQUIVALENT
    assert [e.name for e in found.claims[0].alike] == ["sensor_lag"]
    assert found.claims[0].status == EQUIVALENT


def test_sets_that_share_nothing_are_no_class() -> None:
    found = concluded(visited(effect("delay"), effect("slew_limit")), BASE, visited(effect("amplifier_lowpass")))
    assert found.word == UNKNOWN and not found.claimed


def test_of_two_elements_the_proven_one_is_named_inside_a_class() -> None:
    first = visited(effect("creep"), effect("delay"))
    found = concluded(first, BASE, visited(effect("creep"), effect("sensor_lag")))
    assert found.word == EQUIVALENT
    assert {c.name: c.status for c in found.claims} == {"creep": NAMED, "delay": EQUIVALENT}


def test_a_learned_element_leaves_the_whole_unknown() -> None:
    found = concluded(visited(effect("creep"), learned_elements()["learned_spring"]), BASE)
    assert found.word == UNKNOWN
    assert [c.claimed for c in found.claims] == [False, False]
    # Effects alone leave nine times the noise: √(1.2/9).
    assert found.probability["creep"] == pytest.approx(0.365, rel=0.01)


def test_held_out_recordings_that_deny_an_element_take_its_name() -> None:
    worse = visited(effect("creep"), held_out=(9.0,))
    assert concluded(worse, visited(left=(9.0, 9.0), held_out=(1.0,))).word == UNKNOWN


@pytest.mark.parametrize(("unseen", "no_promise"), [((1.5,), True), ((1.42,), True), ((1.3,), False), ((), False)])
def test_what_was_tried_and_does_not_predict_promises_nothing(unseen: tuple[float, ...], no_promise: bool) -> None:
    model = visited(effect("creep"), left=(1.4, 1.4), held_out=(1.42,) if unseen else ())
    tried = visited(effect("creep"), effect("delay"), left=(1.3, 1.3), held_out=unseen)
    assert denied(effect("delay"), model, {tried.key: tried}, CRITERIA) == no_promise
    assert not denied(effect("sensor_lag"), model, {tried.key: tried}, CRITERIA)
    assert not denied(effect("delay"), model, {tried.key: replace(tried, converged=False)}, CRITERIA)


def test_what_is_fitted_anew_to_every_recording_predicts_nothing() -> None:
    ramp, wandering = in_all_forms([effect("sensor_drift")])
    assert concluded(replace(visited(wandering), nuisances=16), BASE).word == UNKNOWN
    assert concluded(visited(ramp), BASE).word == NAMED


def test_nothing_is_claimed_where_the_base_model_is_enough() -> None:
    base, model = visited(), visited(effect("creep"))
    found = conclude(weigh([base, model], CRITERIA), model, True, (3, 0), CRITERIA)
    assert found.word == NONE
    assert found.claims == ()
    assert found.probability["none"] > 0.5


def test_the_rule_that_decided_comes_last_with_its_numbers() -> None:
    found = concluded(CREEP, BASE)
    assert [r.applies for r in found.rules] == [False] * (len(found.rules) - 1) + [True]
    row = found.rules[-1].document()
    assert (row["rule"], row["outcome"]) == ("every_element_is_proven", NAMED)
    assert row["numbers"]["certain"] > 0.95


def test_rounding_makes_no_probability_larger_than_one() -> None:
    model: Any = SimpleNamespace(families=("creep",))
    totals = [Weighed((model,) * n, -np.log(np.arange(1.0, n + 1.0))).probability["creep"] for n in range(2, 60)]
    assert 1.0 - 1e-12 < min(totals) <= max(totals) <= 1.0
