"""Every rule of the verdict can apply, says by which numbers, and is recorded in the order in which it was asked."""

from __future__ import annotations

import json
import math
from dataclasses import fields, replace
from typing import Any

import pytest

from phnn.criteria import CRITERIA, Confirmation
from phnn.diagnosis.rules import Applied, Record, composition, held_out, search, verdict
from phnn.diagnosis.rules.composition import CLAIM, COPIES, EXCHANGE, GAIN, LAW, LEAVES
from phnn.diagnosis.rules.element import ELEMENT, LEFT, ElementCase, LeftCase
from phnn.diagnosis.rules.held_out import MODEL, NAMELESS, NUMERICS, REMAINDER
from phnn.diagnosis.rules.search import BASE, FORM, KEEP, REFIT, STEP
from phnn.diagnosis.rules.verdict import VERDICT
from phnn.identification.gain import Gain

RULE = CRITERIA.selection
TABLES = (
    BASE, REFIT, STEP, FORM, KEEP, LEAVES, GAIN, EXCHANGE, COPIES, CLAIM, LAW, VERDICT, ELEMENT, MODEL, NAMELESS,
    REMAINDER, LEFT, NUMERICS,
)  # fmt: skip


def a_gain(before: float, after: float, p: float | None = 1e-6) -> Gain:
    change = before**2 - after**2
    size = abs(change) ** 0.5 * (1.0 if change > 0.0 else -1.0)
    return Gain(before, after, 4e-8 * size, size, 100 if p is not None else 3, p, None if p is None else 1.0 - p)


def element(held: Gain | None, identified: Gain) -> ElementCase:
    return ElementCase(held, identified, CRITERIA.confirmation)


STEP_CASE = search.StepCase(share=0.95, chi2=9.0, significant=True, p_value=1e-4, criteria=CRITERIA)
KEEP_CASE = search.KeepCase(0.95, 9.0, remains=True, first=True, located=True, own=True, rule=RULE)
KEPT = verdict.VerdictCase(1, 1, 0.99, 1.0, False, 0.0, None, True, RULE)
SMALL = held_out.NamelessCase(0.05, 1.0, CRITERIA)
MODEL_CASE = held_out.ModelCase(2, 0, 0, 2, share=0.99, remains=False, base=SMALL, held_out=9.0, criteria=CRITERIA)
LARGE_BASE = replace(SMALL, share=3.0, chi2=9.0)
NOTHING_HELPS = replace(MODEL_CASE, proven=0, immaterial=2)
REMAINS = composition.LeavesCase(4.0, 1, lambda: 1e-4, CRITERIA)
COMPOSED = composition.ClaimCase(False, takes=4.0, leaves=0.1, criteria=CRITERIA)
NEAR = composition.LawCase(takes=9.6, learned=10.0, criteria=CRITERIA)
IN_ITS_PLACE = composition.ExchangeCase(own=100.0, other=93.0, least=6.0)
LARGE, SLIGHT = a_gain(5.0, 1.0), a_gain(1.010, 1.008)
PROVEN_BEFORE = replace(element(a_gain(3.7, 1.6, None), LARGE), proven_before=True)

# What decides, of which case.
REACHED: list[tuple[Any, Any, str, str]] = [
    (BASE, search.BaseCase(0.3, RULE), "nothing_is_significant", "none"),
    (BASE, search.BaseCase(1e-4, RULE), "something_is_significant", "search"),
    (REFIT, replace(STEP_CASE, share=0.1, chi2=100.0), "best_refit_explains_too_little", "stop"),
    (STEP, replace(STEP_CASE, share=0.1), "effect_explains_too_little", "discard and stop"),
    (STEP, replace(STEP_CASE, significant=False, p_value=0.4), "model_leaves_nothing", "stop"),
    (STEP, replace(STEP_CASE, chi2=1.1), "model_leaves_little", "stop"),
    (FORM, replace(STEP_CASE, form=True, chi2=2.0), "effect_may_have_another_form", "stop"),
    (FORM, replace(STEP_CASE, form=True), "effect_or_two_in_its_place", "go on"),
    (KEEP, replace(KEEP_CASE, remains=False, share=0.1), "nothing_remains", "keep"),
    (KEEP, replace(KEEP_CASE, chi2=1.03, share=0.1), "remainder_is_within_noise_doubt", "keep"),
    (KEEP, replace(KEEP_CASE, share=0.6), "first_effect_explains_enough", "keep"),
    (KEEP, replace(KEEP_CASE, share=0.6, located=False), "effect_is_not_needed", "withdraw"),
    (KEEP, replace(KEEP_CASE, share=0.75, first=False), "further_effect_explains_enough", "keep"),
    (KEEP, replace(KEEP_CASE, share=0.75, first=False, own=False), "effect_is_not_needed", "withdraw"),
    (VERDICT, replace(KEPT, misplaced=True, chi2=4.0, share=0.9), "remainder_lies_elsewhere", "unknown"),
    (VERDICT, replace(KEPT, misplaced=True, chi2=4.0), "one_explanation", "named"),
    (VERDICT, replace(KEPT, effects=0), "no_effect_explains_it", "unknown"),
    (VERDICT, replace(KEPT, effects=2, share=0.9, chi2=4.0), "several_effects_confound", "unknown"),
    (VERDICT, replace(KEPT, excess=100.0, learned=40.0), "learned_element_explains_better", "unknown"),
    (VERDICT, replace(KEPT, members=3), "several_explain_equally_well", "equivalent"),
    (VERDICT, replace(KEPT, another_form=True), "another_form_is_named", "equivalent"),
    (VERDICT, replace(KEPT, new_in_held_out=False), "held_out_bring_nothing_new", "equivalent"),
    (VERDICT, KEPT, "one_explanation", "named"),
    (LEAVES, replace(REMAINS, chi2=1.01), "model_is_at_the_noise", "stop"),
    (LEAVES, replace(REMAINS, chi2=3.0, p_value=lambda: 0.2), "model_leaves_no_more_than_chance", "stop"),
    (LEAVES, replace(REMAINS, elements=5), "model_has_enough_elements", "stop"),
    (GAIN, composition.GainCase(LARGE, CRITERIA), "element_predicts_better", "add"),
    (GAIN, composition.GainCase(SLIGHT, CRITERIA), "element_does_not_predict_better", "leave out"),
    (CLAIM, replace(COMPOSED, nameless=True, first=0.95), "learned_element_has_no_name", "no name"),
    (CLAIM, replace(COMPOSED, leaves=0.3, first=0.95), "took_nearly_all_before", "name"),
    (CLAIM, replace(COMPOSED, leaves=0.3, first=0.85), "too_much_has_no_name", "no name"),
    (CLAIM, replace(COMPOSED, leaves=0.3), "too_much_has_no_name", "no name"),
    (CLAIM, COMPOSED, "little_has_no_name", "name"),
    (EXCHANGE, IN_ITS_PLACE, "neighbour_fits_better", "exchange"),
    (EXCHANGE, replace(IN_ITS_PLACE, other=95.0), "element_stays", "keep"),
    (EXCHANGE, replace(IN_ITS_PLACE, other=None), "element_stays", "keep"),
    (COPIES, composition.CopiesCase(2), "neighbour_acts_several_times", "no name"),
    (LAW, NEAR, "law_takes_nearly_all", "another form"),
    (LAW, replace(NEAR, takes=2.0, term=True), "element_is_a_sum_of_it", "another form"),
    (ELEMENT, element(None, SLIGHT), "nothing_held_out_and_small", "immaterial"),
    (ELEMENT, element(None, LARGE), "nothing_held_out_and_far", "open"),
    (ELEMENT, element(None, a_gain(3.0, 2.0)), "nothing_held_out", "refuted"),
    (ELEMENT, element(a_gain(3.0, 1.2, None), LARGE), "untested_and_far", "open"),
    (ELEMENT, element(None, a_gain(1.03, 1.01)), "nothing_held_out_and_small", "immaterial"),
    (ELEMENT, element(SLIGHT, SLIGHT), "changes_too_little", "immaterial"),
    (ELEMENT, element(a_gain(1.02, 1.0, None), SLIGHT), "changes_too_little", "immaterial"),
    (ELEMENT, element(a_gain(1.03, 1.01), a_gain(1.03, 1.01)), "changes_too_little", "immaterial"),
    (ELEMENT, element(a_gain(1.08, 1.0), SLIGHT), "error_falls", "proven"),
    (ELEMENT, element(a_gain(1.03, 1.01), LARGE), "error_falls", "proven"),
    (ELEMENT, replace(element(a_gain(1.1, 1.01), LARGE), drifts=True), "drift_is_within_the_noise", "immaterial"),
    (ELEMENT, replace(element(a_gain(3.0, 1.2), LARGE), drifts=True), "error_falls", "proven"),
    (ELEMENT, PROVEN_BEFORE, "untested_and_proven_before", "open"),
    (ELEMENT, replace(PROVEN_BEFORE, proven_before=False), "untested", "provisional"),
    (ELEMENT, replace(PROVEN_BEFORE, held_out=a_gain(3.0, 3.1, None)), "untested", "provisional"),
    (ELEMENT, element(a_gain(6.6, 2.1), LARGE), "error_falls", "proven"),
    (ELEMENT, element(a_gain(3.0, 3.1, 0.9), LARGE), "error_does_not_fall", "refuted"),
    (MODEL, NOTHING_HELPS, "all_are_immaterial", "none"),
    (MODEL, replace(NOTHING_HELPS, base=LARGE_BASE, held_out=1.0), "all_are_immaterial", "none"),
    (MODEL, replace(NOTHING_HELPS, base=LARGE_BASE), "none_is_confirmed", "unknown"),
    (MODEL, replace(NOTHING_HELPS, base=LARGE_BASE, held_out=math.nan), "none_is_confirmed", "unknown"),
    (MODEL, replace(MODEL_CASE, proven=0), "none_is_confirmed", "unknown"),
    (MODEL, replace(MODEL_CASE, share=0.3, remains=True), "confirmed_explain_too_little", "unknown"),
    (MODEL, replace(MODEL_CASE, proven=1), "not_all_are_proven", "equivalent"),
    (MODEL, replace(MODEL_CASE, form_is_gone=True), "catalogue_form_is_left", "named"),
    (MODEL, MODEL_CASE, "all_are_proven", "kept"),
    (NAMELESS, SMALL, "mismatch_is_immaterial", "none"),
    (NAMELESS, replace(SMALL, share=0.2, chi2=1.1), "mismatch_is_immaterial", "none"),
    (NAMELESS, replace(SMALL, gains=0.2), "mismatch_is_immaterial", "none"),
    (REMAINDER, SMALL, "remainder_is_immaterial", "immaterial"),
    (LEFT, LeftCase(0.22, 1.40, 1.64, CRITERIA), "more_is_left", "no name"),
    (NUMERICS, held_out.NumericsCase(0.5, 8.0, CRITERIA), "numerical_error_may_confound", "equivalent"),
]


@pytest.mark.parametrize(("table", "case", "rule", "outcome"), REACHED, ids=[f"{r[2]}-{r[3]}" for r in REACHED])
def test_the_rule_is_reached_and_recorded(table: Any, case: Any, rule: str, outcome: str) -> None:
    record = Record()
    decided = record.decide(table, case, "creep")
    assert decided is not None and (decided.rule, decided.outcome, decided.element) == (rule, outcome, "creep")
    assert record.asked[-1] is decided and not any(a.applies for a in record.asked[:-1])
    order = [r.__name__ for r in table]
    asked = [a.rule for a in record.asked]
    assert asked == sorted(asked, key=order.index)
    entry = json.loads(json.dumps(decided.document()))
    assert entry == {"rule": rule, "applies": True, "numbers": dict(decided.numbers), "outcome": outcome,
                     "element": "creep"}  # fmt: skip


def test_no_rule_is_left_out() -> None:
    names = [r.__name__ for table in TABLES for r in table]
    assert len(names) == len(set(names))
    assert {r[2] for r in REACHED} == set(names)
    assert all(rule.__doc__ for table in TABLES for rule in table)


@pytest.mark.parametrize(
    ("table", "case"),
    [
        (REFIT, STEP_CASE),
        (STEP, STEP_CASE),
        (FORM, STEP_CASE),
        (LEAVES, REMAINS),
        (COPIES, composition.CopiesCase(1)),
        (LAW, replace(NEAR, takes=9.4)),
        (LAW, replace(NEAR, learned=-1.0)),
        (LAW, replace(NEAR, learned=-1.0, term=True)),
        (NAMELESS, replace(SMALL, share=0.2, chi2=1.3)),
        (NAMELESS, replace(SMALL, proven=True)),
        (NAMELESS, replace(SMALL, gains=0.6)),
        (REMAINDER, replace(SMALL, share=0.2)),
        (REMAINDER, replace(SMALL, chi2=1.2)),
        (LEFT, LeftCase(0.09, 1.40, 1.02, CRITERIA)),
        (LEFT, LeftCase(1.40, 0.22, 1.64, CRITERIA)),
        (LEFT, LeftCase(100.0, 200.0, 8.0, CRITERIA)),
        (NUMERICS, held_out.NumericsCase(0.2, 2.0, CRITERIA)),
        (NUMERICS, held_out.NumericsCase(0.5, 20.0, CRITERIA)),
    ],
)
def test_where_no_rule_applies_nothing_is_decided_and_all_are_recorded(table: Any, case: Any) -> None:
    record = Record()
    assert record.decide(table, case) is None
    assert [a.rule for a in record.asked] == [r.__name__ for r in table]
    assert all(a.document()["outcome"] is None for a in record.asked)


@pytest.mark.parametrize(
    ("before", "after", "p_value", "adds"),
    [
        (3.0, 2.5, 1e-3, True),  # a third of the excess, three standard errors
        (3.0, 2.5, 0.04, True),  # far
        (3.0, 2.5, 0.06, False),
        (3.0, 2.5, None, True),
        (3.0, 2.8, 1e-3, True),  # a seventh
        (3.0, 2.8, 2e-3, False),
        (3.0, 2.8, None, False),
        (3.0, 2.95, 1e-9, False),  # a twentieth is not enough, however sure
        (3.0, 3.1, 1.0, False),
        (3.0, 3.1, None, False),
        (1.0, 0.99, 1e-9, True),
    ],
)
def test_what_the_recordings_that_choose_ask_for(
    before: float, after: float, p_value: float | None, adds: bool
) -> None:
    assert CRITERIA.composition.falls(before, after, p_value) == adds


def test_a_criterion_moves_the_rule_that_reads_it() -> None:
    found = element(a_gain(1.08, 1.0), a_gain(1.1, 1.0))
    for changed in (Confirmation(material=0.5), Confirmation(material_share=0.1)):
        decided = Record().decide(ELEMENT, replace(found, rule=changed))
        assert decided is not None and decided.outcome == "immaterial"
    assert {f.name for f in fields(Applied)} == {"rule", "applies", "outcome", "numbers", "element"}


def test_a_large_remainder_is_composed_further_even_where_it_may_be_chance() -> None:
    def never() -> float:
        raise AssertionError("scores take long and are not asked for")

    assert Record().decide(LEAVES, replace(REMAINS, chi2=5.0, p_value=never)) is None
