"""Elements of a model against their neighbours in their places."""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from unittest import mock

import campaigns
import numpy as np
import pytest
from effects_together import VALUES, lacking, together

from phnn.criteria import CRITERIA
from phnn.diagnosis.exchange import _best, _needed_by, exchanged
from phnn.diagnosis.finding import Finding
from phnn.diagnosis.name import Candidate
from phnn.diagnosis.rules import Record
from phnn.diagnosis.search import Search
from phnn.diagnosis.trial import Trial, criterion
from phnn.effects import catalogue, effect
from phnn.effects.places.attached import attached
from phnn.identification.fit import Fit

SEARCHED = ("quadratic_drag", "creep", "extra_hysteron")


def left(whole: Fit, significant: bool = False) -> Any:
    """A fit, and whether it leaves something."""
    return mock.Mock(linearised=mock.Mock(fit=whole), significant=significant)


def asked(true: str, claimed: str) -> tuple[tuple[Finding, ...], Fit, Fit, Record]:
    """What becomes of a model with one effect where another is true, beside a drag: elements, fits before and after."""
    base, record = lacking("quadratic_drag", true), Record()
    findings, whole = together(base, "quadratic_drag", claimed)
    search = Search([catalogue()[n] for n in SEARCHED])
    after, fitted = exchanged(base, findings, left(whole), search, record, (0, 1))
    return after, whole, fitted, record


@pytest.mark.parametrize(
    ("true", "claimed"),
    [("creep", "extra_hysteron"), pytest.param("extra_hysteron", "creep", marks=pytest.mark.slow)],
)
def test_the_true_neighbour_takes_the_place(true: str, claimed: str) -> None:
    after, before, fitted, record = asked(true, claimed)
    assert [f.effect.name for f in after] == ["quadratic_drag", true]
    assert after[1].alike[0].candidate.effect.name == true
    assert fitted.chi2 == pytest.approx(1.0, abs=0.05)
    assert fitted.cost < before.cost + CRITERIA.selection.tie
    assert set(VALUES[true]) <= set(fitted.setup.parameters)
    assert not set(VALUES[claimed]) & set(fitted.setup.parameters)
    assert len({t.fit.residual.size for t in after[1].trials if t.fit is not None}) == 1
    # The model without it comes with it, of the same recordings and steps.
    alone = after[1].others_alone
    assert alone is not None and alone.plan.substeps == fitted.plan.substeps
    assert [(a.rule, a.element) for a in record.asked if a.applies] == [("neighbour_fits_better", claimed)]


@pytest.mark.parametrize("true", ["creep", pytest.param("extra_hysteron", marks=pytest.mark.slow)])
def test_a_true_effect_keeps_its_place_and_name(true: str) -> None:
    after, before, fitted, record = asked(true, true)
    assert fitted is before
    assert [f.effect.name for f in after] == ["quadratic_drag", true]
    assert [t.candidate.effect.name for t in after[1].alike] == [true]
    assert len(after[1].trials) == 1 and after[1].others_alone is not None
    assert [(a.rule, a.element) for a in record.asked if a.applies] == [("element_stays", true)]


def test_one_element_and_learned_ones_are_not_asked() -> None:
    base = lacking("quadratic_drag", "creep")
    findings, whole = together(base, "creep")
    record = Record()
    search = Search(list(catalogue().values()))
    assert exchanged(base, findings, left(whole), search, record, (0,)) == (findings, whole)
    two = (*findings, replace(findings[0], learned=True))
    learned = tuple(replace(f, learned=True) for f in two)
    assert exchanged(base, learned, left(whole), search, record, (0, 1)) == (learned, whole)
    assert record.asked == []


def test_neighbours_are_mutual() -> None:
    creep, hysteron, drag = (effect(n) for n in ("creep", "extra_hysteron", "quadratic_drag"))
    assert creep.is_neighbour_of(hysteron) and hysteron.is_neighbour_of(creep)
    assert not creep.is_neighbour_of(drag) and not creep.is_neighbour_of(creep)
    slew = effect("slew_limit")
    assert slew.is_neighbour_of(drag) and drag.is_neighbour_of(slew)


def at(whole: Fit, name: str, chosen: float) -> Trial:
    """A fit as if it had this value of Schwarz's criterion."""
    trial = Trial(Candidate(effect(name), VALUES[name], (), 10.0, 1e-3), whole)
    cost = whole.cost + chosen - criterion(trial)
    return replace(trial, fit=replace(whole, residual=whole.residual * np.sqrt(cost / whole.cost)))


@pytest.mark.parametrize(
    ("claimed", "other", "lower", "significant", "goes"),
    [
        ("extra_hysteron", "creep", 3.0, False, True),  # a special case has only to be lower
        ("extra_hysteron", "creep", -1.0, False, False),
        ("creep", "extra_hysteron", 3.0, False, False),
        ("creep", "extra_hysteron", 8.0, False, True),
        ("creep", "extra_hysteron", 100.0, True, False),  # less than a fifth of what is left
    ],
)
def test_how_much_better_a_neighbour_has_to_be(
    claimed: str, other: str, lower: float, significant: bool, goes: bool
) -> None:
    base = lacking("quadratic_drag", "creep")
    wholes = {n: together(base, "quadratic_drag", n)[1] for n in (claimed, other)}
    here = 1.2 * base.residual.size if significant else base.residual.size
    mine = at(wholes[claimed], claimed, here)
    assert mine.fit is not None
    again = _best(
        Finding(mine, (mine,), (mine,), mock.sentinel.naming, first=0.95), [at(wholes[other], other, here - lower)],
        mine.fit, significant, CRITERIA, Record(),
    )  # fmt: skip
    assert again.effect.name == (other if goes else claimed)
    assert again.first == (None if goes else 0.95)


def test_a_member_that_was_not_refitted_stays_in_the_class() -> None:
    base = lacking("quadratic_drag", "creep")
    findings, whole = together(base, "quadratic_drag", "creep")
    earlier = Trial(Candidate(effect("charge_leakage"), {}, (), 1.0, 1.0), None)
    finding = replace(findings[1], members=(*findings[1].members, earlier))
    rival = at(whole, "quadratic_drag", criterion(findings[1].trial) + 5.0)
    again = _best(finding, [rival], whole, False, CRITERIA, Record())
    assert again.effect is finding.effect
    assert {t.candidate.effect.name for t in again.members} >= {"creep", "charge_leakage"}


def test_a_first_copy_stays_below_a_second() -> None:
    first, second, *_ = attached(effect("creep"), campaigns.base().setup)
    one, two = (Finding(Trial(Candidate(e, {}, (), 1.0, 1.0), None), (), (), mock.Mock()) for e in (first, second))
    assert _needed_by(one, [two])
    assert not _needed_by(two, [one])
