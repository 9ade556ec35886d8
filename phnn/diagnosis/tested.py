"""The gain of every element of a model on held-out recordings, and the resulting status of this element.

An element is what the model has and the model without it, refitted, has not. Beside learned elements of its kind an
effect that took nearly all of the excess before they were added gains little, for they can take what it stands for. Its
name is asked of the model that lacks them: with the effect against without. `phnn.diagnosis.confirm` decides what
follows for the model.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

from phnn.criteria import Criteria
from phnn.diagnosis.finding import Finding
from phnn.diagnosis.judge import Judgement
from phnn.diagnosis.place import further_forms, may_be_part_of
from phnn.diagnosis.retest import without
from phnn.diagnosis.rules import Record
from phnn.diagnosis.rules.element import ELEMENT, ElementCase
from phnn.effects import Effect
from phnn.identification.evaluate import Evaluation, evaluate
from phnn.identification.fit import Fit
from phnn.identification.gain import Gain, gain
from phnn.identification.plan import Plan
from phnn.recordings.recording import Campaign, Recording
from phnn.rescue import extra, needed


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
        case: its gains; of an effect in another form those of the effect without its learned elements.
        left: residual over noise that the model with all elements leaves, where `shown` is measured.
    """

    finding: Finding
    outcome: Outcome
    alone: Fit
    case: ElementCase
    left: float

    @property
    def shown(self) -> Gain:
        """The gain on held-out recordings, on those identified where there are none."""
        return self.case.shown


_Shown = tuple[Fit, Evaluation]


@dataclass(frozen=True)
class _Models:
    """The final model of a judgement, the models with some of its elements, and what they predict; each is fitted once.

    Attributes:
        before: scores of the base model.
    """

    judgement: Judgement
    before: Evaluation
    campaign: Campaign
    criteria: Criteria
    fitted: dict[tuple[int, ...], _Shown | None] = field(default_factory=dict)

    def without(self, *gone: Finding) -> _Shown | None:
        """The model without some elements; None where it cannot be fitted."""
        known = tuple(sorted(id(f) for f in gone))
        if known not in self.fitted:
            self.fitted[known] = self._fitted(*gone)
        return self.fitted[known]

    def _fitted(self, *gone: Finding) -> _Shown | None:
        j, base = self.judgement, self.judgement.linearised.fit
        if not gone:
            return j.final, score_on_all(j.final, self.campaign)
        others = tuple(f for f in j.findings if all(f is not g for g in gone))
        if not others:
            return base, self.before
        fitted = gone[0].others_alone if len(gone) == 1 else None
        if fitted is None:
            part = f"held-out test without {' and '.join(f.effect.name for f in gone)}"
            fitted = extra(part, lambda: without(base, others, gone[0], j.final, self.criteria), None)
        return None if fitted is None else (fitted, score_on_all(fitted, self.campaign))

    def case(self, fewer: _Shown, more: _Shown) -> ElementCase:
        """What one model gains over another."""
        rule, own = self.criteria.confirmation, (fewer[0].setup.own, more[0].setup.own)
        held_out, identified = (
            gain(fewer[1], more[1], self.campaign.recordings, use, rule.held_out_blocks, own)
            for use in ("confirmation", "identification")
        )
        assert identified is not None
        return ElementCase(held_out, identified, rule, own[1].drift_terms > own[0].drift_terms)


def outcome_of(case: ElementCase, record: Record | None = None, element: str = "") -> Outcome:
    """What follows from the gains of one element, by the rules of `phnn.diagnosis.rules.element.ELEMENT`."""
    decided = (record or Record()).decide(ELEMENT, case, element)
    assert decided is not None
    return Outcome(decided.outcome)


def tested_elements(
    judgement: Judgement,
    before: Evaluation,
    campaign: Campaign,
    criteria: Criteria,
    record: Record,
    proven: Collection[Effect] = (),
) -> tuple[Evaluation, list[Tested]]:
    """The final model's scores on all recordings, and each of its elements held against the model without it.

    Args:
        before: scores of the base model.
        proven: effects that were proven beside elements that the model has lost since.
    """
    models = _Models(judgement, before, campaign, criteria)
    whole = models.without()
    assert whole is not None
    return whole[1], [_tested(f, models, whole, record, f.effect in proven) for f in judgement.findings]


def _tested(finding: Finding, models: _Models, whole: _Shown, record: Record, proven_before: bool) -> Tested:
    alone = models.without(finding)
    if alone is None:
        # It stays, and nothing is known of what it gains.
        case = models.case(whole, whole)
        return Tested(finding, Outcome.PROVISIONAL, whole[0], case, case.shown.after)
    case = models.case(alone, whole)
    left = case.shown.after
    forms = learned_forms(finding, models.judgement.findings, models.criteria)
    if forms and not case.rises:
        neither, effect = models.without(finding, *forms), models.without(*forms)
        if neither is not None and effect is not None:
            case = models.case(neither, effect)
    case = replace(case, proven_before=proven_before)
    outcome = outcome_of(case, record, finding.effect.name)
    return Tested(finding, outcome, alone[0], case, left)


def learned_forms(finding: Finding, findings: Sequence[Finding], criteria: Criteria) -> tuple[Finding, ...]:
    """Learned elements with which an effect is in another form: it took nearly all of the excess before they came.

    There are none where a learned element of another kind at its place may be what both stand for, nor where the search
    had several effects, for it is not known which of them took nearly all.
    """
    if finding.provisional or (finding.first or 0.0) < criteria.composition.first_takes:
        return ()
    if any(f.first is not None and f is not finding for f in findings):
        return ()
    forms = further_forms(finding, findings)
    beside = [f for f in findings if f.nameless and may_be_part_of(f.effect, finding.effect)]
    return forms if all(any(f is g for g in forms) for f in beside) else ()


def scored_one_by_one(fitted: Fit, campaign: Campaign) -> Evaluation:
    """As `score_on_all`, without the recordings that cannot be simulated."""
    nothing = Evaluation({}, ())

    def one(recording: Recording) -> Evaluation:
        alone = replace(campaign, recordings=(recording,))
        return needed(f"scores on {recording.name}", lambda: score_on_all(fitted, alone), nothing)

    found = [one(r) for r in campaign.recordings]
    return Evaluation({n: y for e in found for n, y in e.outputs.items()}, tuple(p for e in found for p in e.parts))


def score_on_all(fitted: Fit, campaign: Campaign) -> Evaluation:
    """A fit's scores on every recording of a campaign; held-out ones get the finest sub-steps of the fit's plan."""
    finest = fitted.plan.finest
    known = {r.name: r for r in fitted.plan.recordings}
    recordings = tuple(known.get(r.name, r) for r in campaign.recordings)
    steps = {r.name: fitted.plan.substeps.get(r.name, finest) for r in recordings}
    return evaluate(fitted.setup, Plan(recordings, steps, fitted.plan.workers), fitted.initial_states)
