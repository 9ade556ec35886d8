"""Texts of a learned element that is an effect of the catalogue in another form."""

from __future__ import annotations

from dataclasses import replace

import campaigns

from phnn.diagnosis.diagnosis import Diagnosis
from phnn.diagnosis.questions import tied_members
from phnn.diagnosis.trial import Trial
from phnn.effects import effect
from phnn.report.named import supports
from phnn.report.result import document
from phnn.report.sentence import sentence
from phnn.report.tried import tried_rows


def diagnosis(*laws: str, provisional: bool = False) -> Diagnosis:
    """A diagnosis whose one element counts as learned, and these effects can nearly replace it."""
    found = campaigns.diagnosis("quadratic_drag")
    (finding,) = found.judgement.findings
    near = tuple(Trial(replace(finding.trial.candidate, effect=effect(n)), finding.trial.fit) for n in laws)
    finding = replace(finding, learned=True, laws=near, provisional=provisional)
    verdict = "unknown" if provisional else "equivalent"
    return replace(found, judgement=replace(found.judgement, findings=(finding,), verdict=verdict))


def test_the_sentence_names_the_effect_and_says_that_its_form_is_another() -> None:
    assert "oulomb friction in another form" in sentence(diagnosis("coulomb_friction"))
    both = sentence(diagnosis("coulomb_friction", "creep"))
    assert "coulomb friction (or creep) in another form" in both
    assert "cannot exclude" in both


def test_the_entry_has_the_name_of_the_effect_and_the_form_of_the_element() -> None:
    (entry,) = document(diagnosis("coulomb_friction", "creep"))["missing"]
    assert (entry["effect"], entry["status"], entry["form"]) == ("coulomb_friction", "equivalent", "quadratic_drag")
    assert entry["equivalent_to"] == ["creep"]
    assert "It is coulomb friction or creep in another form" in entry["statement"]


def test_without_a_claim_the_effect_is_the_nearest_one() -> None:
    found = diagnosis("coulomb_friction", provisional=True)
    (entry,) = document(found)["missing"]
    assert (entry["effect"], entry["nearest"]) == ("unknown", "coulomb_friction")
    assert "form" not in entry
    assert supports(found)[0].effect == "quadratic_drag"


def test_evidence_is_that_of_the_effect_and_no_recording_is_proposed_against_it() -> None:
    found = diagnosis("coulomb_friction")
    (support,) = supports(found)
    assert support.effect == "coulomb_friction in another form"
    assert support.expected == effect("coulomb_friction").fingerprint
    outcomes = {row.effect: row.outcome for row in tried_rows(found)}
    assert outcomes["coulomb_friction"].startswith("can nearly replace the learned element")
    assert tied_members(found.judgement) == ()
