"""Elements of a model against their neighbours in their places."""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from unittest import mock

import pytest
from effects_together import VALUES, lacking, together

from phnn.criteria import CRITERIA
from phnn.diagnosis.exchange import exchanged
from phnn.diagnosis.finding import Finding
from phnn.diagnosis.rules import Record
from phnn.diagnosis.search import Search
from phnn.effects import catalogue
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
