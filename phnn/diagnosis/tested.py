"""The gain of every element of a model on held-out recordings, and the resulting status of this element.

An element is what the model has and the model without it, refitted, has not. An effect that claims a name, took nearly
all and has learned elements of its kind beside it is another form of itself: all of them together are held against the
model without any, for the learned ones alone can take what the effect stands for. `phnn.diagnosis.confirm` decides what
follows for the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from phnn.criteria import Confirmation, Criteria
from phnn.diagnosis.finding import Finding
from phnn.diagnosis.judge import Judgement
from phnn.diagnosis.place import further_forms
from phnn.diagnosis.retest import without
from phnn.diagnosis.rules import Record
from phnn.diagnosis.rules.held_out import ELEMENT, ElementCase
from phnn.identification.evaluate import Evaluation, evaluate
from phnn.identification.fit import Fit
from phnn.identification.gain import Gain, gain
from phnn.identification.plan import Plan
from phnn.recordings.recording import Campaign


class Outcome(Enum):
    """What the held-out recordings say of one element; see the table in `phnn.diagnosis.confirm`."""

    PROVEN = "proven"
    OPEN = "open"
    PROVISIONAL = "provisional"
    IMMATERIAL = "immaterial"
    REFUTED = "refuted"


SURE = (Outcome.PROVEN, Outcome.OPEN)


@dataclass(frozen=True)
class Tested:
    """One element: what it gains on held-out and on identification recordings, and what follows.

    Attributes:
        alone: the model without it; the model itself where that cannot be fitted.
        held_out: None where nothing was held out.
        forms: learned elements that are more of it, which ``alone`` lacks as well.
    """

    finding: Finding
    outcome: Outcome
    alone: Fit
    held_out: Gain | None
    identified: Gain
    forms: tuple[Finding, ...] = ()

    @property
    def shown(self) -> Gain:
        """The gain on held-out recordings, on those identified where there are none."""
        return self.held_out or self.identified


def outcome_of(case: ElementCase, record: Record | None = None, element: str = "") -> Outcome:
    """What follows from the gains of one element, by the rules of `phnn.diagnosis.rules.held_out.ELEMENT`."""
    decided = (record or Record()).decide(ELEMENT, case, element)
    assert decided is not None
    return Outcome(decided.outcome)


def tested_elements(
    judgement: Judgement, before: Evaluation, campaign: Campaign, criteria: Criteria, record: Record
) -> tuple[Evaluation, list[Tested]]:
    """The final model's scores on all recordings, and each of its elements held against the model without it."""
    base, final, rule = judgement.linearised.fit, judgement.final, criteria.confirmation
    after, tested = score_on_all(final, campaign), []
    for finding in judgement.findings:
        forms = _forms(finding, judgement.findings, criteria)
        others = tuple(f for f in judgement.findings if f is not finding and f not in forms)
        alone = finding.others_alone if not forms else None
        if alone is None:
            alone = without(base, others, finding, final, criteria) if others else base
        if alone is None:
            tested.append(_untold(finding, final, after, campaign, rule))
            continue
        shown = before if alone is base else score_on_all(alone, campaign)
        held_out, identified = (
            gain(shown, after, campaign.recordings, use, rule.held_out_blocks, (alone.setup.own, final.setup.own))
            for use in ("confirmation", "identification")
        )
        assert identified is not None
        drifts = final.setup.own.drift_terms > alone.setup.own.drift_terms
        case = ElementCase(held_out, identified, rule, drifts)
        outcome = outcome_of(case, record, finding.effect.name)
        tested.append(Tested(finding, outcome, alone, held_out, identified, forms))
    return after, tested


def _forms(finding: Finding, findings: Sequence[Finding], criteria: Criteria) -> tuple[Finding, ...]:
    """Learned elements with which an effect is another form of itself: it took nearly all before they were added.

    Of several effects of the search it is not known which of them took it.
    """
    took = [f for f in findings if f.first is not None]
    if finding.provisional or took != [finding] or (finding.first or 0.0) < criteria.composition.first_takes:
        return ()
    return further_forms(finding, findings)


def _untold(finding: Finding, final: Fit, after: Evaluation, campaign: Campaign, rule: Confirmation) -> Tested:
    """An element without which the others cannot be fitted: it stays, and nothing is known of what it gains."""
    own, uses = (final.setup.own, final.setup.own), ("confirmation", "identification")
    held_out, identified = (gain(after, after, campaign.recordings, u, rule.held_out_blocks, own) for u in uses)
    assert identified is not None
    return Tested(finding, Outcome.PROVISIONAL, final, held_out, identified)


def score_on_all(fitted: Fit, campaign: Campaign) -> Evaluation:
    """A fit's scores on every recording of a campaign; held-out ones get the finest sub-steps of the fit's plan."""
    finest = fitted.plan.finest
    known = {r.name: r for r in fitted.plan.recordings}
    recordings = tuple(known.get(r.name, r) for r in campaign.recordings)
    steps = {r.name: fitted.plan.substeps.get(r.name, finest) for r in recordings}
    return evaluate(fitted.setup, Plan(recordings, steps, fitted.plan.workers), fitted.initial_states)
