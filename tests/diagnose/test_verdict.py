"""The verdict: each rule decides a case of its own, and names follow from probabilities."""

from __future__ import annotations

from dataclasses import replace

import pytest
from test_number import visited

from phnn.criteria import Criteria
from phnn.diagnose.number import Visited, weigh
from phnn.diagnose.verdict import EQUIVALENT, NAMED, NONE, RULES, UNKNOWN, Facts, Verdict, conclude
from phnn.effects import effect, in_all_forms
from phnn.effects.learned import learned_elements

CRITERIA = Criteria()
PROVEN = Facts(
    elements=1, learned=0, none=0.0, certain=0.99, alternatives=1, complete=1.0, base_left=9.0, falls=True, new=True,
    promising=5, remaining=0, early=False, criteria=CRITERIA,
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
        ({"early": True}, "the_search_ended_early", UNKNOWN),
        ({"learned": 1, "complete": 0.5}, "an_element_is_learned", UNKNOWN),
        ({"complete": 0.7}, "something_is_left", UNKNOWN),
        ({"falls": False}, "held_out_recordings_deny_it", UNKNOWN),
        ({"new": False}, "held_out_recordings_are_not_new", EQUIVALENT),
        ({"certain": 0.6, "alternatives": 3}, "a_class_is_proven", EQUIVALENT),
    ],
)
def test_every_rule_decides_a_case(changes: dict[str, object], rule: str, word: str) -> None:
    assert decided(replace(PROVEN, **changes)) == (rule, word)  # type: ignore[arg-type]


def test_rules_are_few_and_none_is_without_its_case() -> None:
    assert len(RULES) <= 10
    assert all(r.needed and r.numbers for r in RULES)
    assert len({r.name for r in RULES}) == len(RULES)


def test_what_a_model_leaves_lowers_all_probabilities_unless_nothing_explains_it() -> None:
    models = [visited(effect("creep"), left=(4.8, 4.8), held_out=(4.8,)), visited(left=(90.0, 90.0), held_out=(90.0,))]
    found = [conclude(weigh(models, CRITERIA), models[0], True, (3, remaining), CRITERIA) for remaining in (0, 1)]
    assert [f.word for f in found] == [NAMED, UNKNOWN]
    assert found[0].probability["creep"] > 0.95
    # √(1.2/4.8)
    assert found[1].probability["creep"] == pytest.approx(0.5, rel=0.01)
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
