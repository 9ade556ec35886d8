"""The recordings that were held out have the last word on every element that was found.

An element is what the model has and the model without it, refitted, has not. Its name stands only if the error on
held-out recordings falls, by more than chance would make it fall and by so much that it can be seen. Each element needs
its own gain: of a chain of elements none is carried by the others. As each passes on its own, no element is named
wrongly more often than the level says, and no correction for their number is due. An element that makes the held-out
error larger is taken out, unless a single observation shows a small rise only; the others are asked again, and an
element not proven at first is then proven only below the level over the number of all questions.

| on held-out recordings | the element is |
|---|---|
| falls by `named_gain`, p < level | proven: its name stands, unless the model leaves more, and another takes more |
| loses nine tenths of its excess, too few blocks for a p-value | open: at most ``equivalent`` |
| falls, too few blocks now, but proven before another element was taken out | open |
| anything else, too few blocks to refute it | provisional beside others that stand; alone it is refuted |
| falls by less, and by less than `real_gain` where it was found | immaterial: told with its size, not named |
| anything else | refuted: what it explained is real, and has no name |

With few blocks the held-out recordings prove nothing and refute nothing: one coherent drift is a single observation,
however many samples it has. A large fall then supports a class, for the identification recordings have tested the
element already; so does any fall of an element that was proven before. Anything less withdraws the name. Where nothing
is held out, the identification recordings decide in the same way, and nothing is proven.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

from phnn.criteria import Confirmation, Criteria
from phnn.diagnose.linearised import LinearisedFit
from phnn.diagnosis.finding import Finding, without_element
from phnn.diagnosis.judge import Immaterial, Judgement, immaterial, unexplained
from phnn.diagnosis.name import Naming
from phnn.diagnosis.place import in_another_form, may_be_part_of
from phnn.diagnosis.rules import Record
from phnn.diagnosis.rules.composition import ClaimCase, has_name, neighbour_acts_several_times
from phnn.diagnosis.rules.element import LEFT, LeftCase
from phnn.diagnosis.rules.held_out import MODEL, NAMELESS, REMAINDER, ModelCase, NamelessCase
from phnn.diagnosis.rules.verdict import VERDICT, another_form_is_named
from phnn.diagnosis.scored import Scored
from phnn.diagnosis.select import share_of
from phnn.diagnosis.tested import (
    SURE,
    Outcome,
    Tested,
    learned_forms,
    score_on_all,
    scored_one_by_one,
    tested_elements,
)
from phnn.effects import Effect
from phnn.identification.evaluate import Evaluation
from phnn.identification.fit import Fit
from phnn.recordings.recording import Campaign


def confirmed(
    judgement: Judgement,
    base: Fit,
    campaign: Campaign,
    criteria: Criteria,
    score_again: Callable[[Fit], Scored],
) -> tuple[Judgement, Evaluation, Evaluation]:
    """The judgement after the held-out recordings had the last word, and the scores of both models on all recordings.

    Args:
        judgement: of the identification recordings.
        base: the fit without any element.
        criteria: when an element is confirmed.
        score_again: scores of a model that has lost an element.
    """
    before, record = score_on_all(base, campaign), Record(list(judgement.rules))
    if judgement.location is None:
        return judgement, before, before
    after, tested = tested_elements(judgement, before, campaign, criteria, record)
    doubted = {t.finding.effect for t in tested if t.outcome not in SURE}
    proven = _proven(tested)
    tests = len(tested)
    while len(tested) > 1 and (harmful := [t for t in tested if not _helps(t, criteria.confirmation)]):
        judgement = _dropped(judgement, min(harmful, key=lambda t: t.shown.share_of_noise), score_again)
        after, tested = tested_elements(judgement, before, campaign, criteria, record, proven)
        tests += len(tested)
        proven = _proven(tested, proven)
        level = criteria.confirmation.held_out_level / tests
        tested = [_no_surer(t, level) if t.finding.effect in doubted else t for t in tested]
    tested = _without_doubtful_names(tested, criteria, record)
    claimed = [t for t in tested if not t.finding.provisional]
    # What is too small for a name takes none from the others.
    claimed = [t for t in claimed if t.outcome is not Outcome.IMMATERIAL] or claimed
    left, lost = before.over_noise("confirmation"), campaign.held_out_is_new and _form_is_gone(judgement, claimed)
    decided = record.decide(MODEL, _model_case(judgement, claimed, left, lost, criteria)) if claimed else None
    if decided is not None and decided.outcome == "none":
        first, shown = judgement.findings[0].effect.name, tested[0].shown
        small = Immaterial(first, abs(shown.rms), abs(shown.share_of_noise))
        judgement, after = immaterial(judgement, small), before
    elif decided is not None and decided.outcome != "unknown":
        judgement = _standing(judgement, tested, decided.outcome, criteria, record)
    else:
        judgement = _nameless(judgement, tested, criteria, record)
        after = before if judgement.final is base else after
    return replace(judgement, rules=tuple(record.asked)), before, after


def unconfirmed(judgement: Judgement, base: Fit, campaign: Campaign) -> tuple[Judgement, Evaluation, Evaluation]:
    """The judgement where held-out recordings could not be asked: nothing is named. The model stays only if it can be
    simulated on all recordings that the base model can."""
    before = scored_one_by_one(base, campaign)
    if judgement.location is None:
        return judgement, before, before
    after = before if judgement.final is base else scored_one_by_one(judgement.final, campaign)
    if len(after.parts) < len(before.parts):
        nameless = unexplained(judgement.linearised, judgement.naming, judgement.location, judgement.tried)
        return replace(nameless, rules=judgement.rules), before, before
    findings = tuple(replace(f, provisional=True) for f in judgement.findings)
    return replace(judgement, verdict="unknown", findings=findings), before, after


def _no_surer(tested: Tested, level: float) -> Tested:
    """Return the level of a later test: elements not proven at first share one level over all tests."""
    held = tested.case.held_out
    if tested.outcome is Outcome.PROVEN and held is not None and held.falls is not None and held.falls < level:
        return tested
    return replace(tested, outcome=Outcome.PROVISIONAL) if tested.outcome in SURE else tested


def _proven(tested: Sequence[Tested], before: Collection[Effect] = ()) -> set[Effect]:
    """Effects that are proven, and those that were before and cannot be tested any more."""

    def stands(t: Tested) -> bool:
        """Whether an element is among them."""
        untestable = t.case.held_out is not None and t.case.held_out.falls is None
        return t.outcome is Outcome.PROVEN or (untestable and t.finding.effect in before)

    return {t.finding.effect for t in tested if stands(t)}


def _helps(tested: Tested, rule: Confirmation) -> bool:
    """Whether an element stays in the model: held-out recordings can veto it, and what they leave open stays.

    Too few blocks for a test are a single observation. If it shows a small rise, less than the fall of the error where
    the element was identified, it leaves the element open. Whether an element has a name is another question.
    """
    shown, identified = tested.shown, tested.case.identified
    if tested.outcome in SURE:
        return True
    little = shown.after <= (1.0 + rule.untested_rise) * shown.before
    outweighed = little and shown.after * identified.after <= shown.before * identified.before
    open_ = tested.outcome is Outcome.PROVISIONAL and (shown.after <= shown.before or outweighed)
    return open_ or rule.falls(shown.before, shown.after, shown.share_of_noise)


def _without_doubtful_names(tested: Sequence[Tested], criteria: Criteria, record: Record) -> list[Tested]:
    """The elements, none of them with a name that takes less than another element and less than the model leaves, or
    beside a learned element at its own place that takes much as well.

    Either may be part of something that has no name. A learned element may also be more of the same: an effect that
    took nearly all before has its name beside learned elements of its own kind, for both together are another form of
    it.
    """

    def takes(t: Tested) -> float:
        return max(t.shown.takes, 0.0)

    def stands(t: Tested) -> bool:
        """Whether an element keeps its name."""
        effect, others = t.finding.effect, max((takes(o) for o in tested if o is not t), default=0.0)
        left = LeftCase(takes(t), others, t.left, criteria)
        if t.outcome in SURE and record.decide(LEFT, left, effect.name) is not None:
            return False
        beside = [o for o in tested if o.finding.nameless and may_be_part_of(o.finding.effect, effect)]
        if not beside:
            return True
        forms = learned_forms(t.finding, [o.finding for o in tested], criteria)
        first = t.finding.first if forms and takes(t) > 0.0 else None
        case = ClaimCase(t.finding.nameless, takes(t), sum(map(takes, beside)), criteria, first)
        return has_name(case, effect.name, record)

    def asked(t: Tested) -> Tested:
        kept = t.finding.provisional or stands(t)
        return t if kept else replace(t, finding=replace(t.finding, provisional=True))

    return [asked(t) for t in tested]


def _form_is_gone(judgement: Judgement, claimed: Sequence[Tested]) -> bool:
    """Whether another form alone kept a verdict from ``named``, and the learned elements that made it are gone."""
    applied, words = [r.rule for r in judgement.rules if r.applies], {rule.__name__ for rule in VERDICT}
    last = [rule for rule in applied if rule in words][-1:]
    if last != [another_form_is_named.__name__] or neighbour_acts_several_times.__name__ in applied:
        return False
    return not any(in_another_form(t.finding, judgement.findings) for t in claimed)


def _model_case(
    judgement: Judgement, tested: Sequence[Tested], held_out: float, form_is_gone: bool, criteria: Criteria
) -> ModelCase:
    counts = Counter(t.outcome for t in tested)
    share = share_of(judgement.linearised.fit, judgement.final, judgement.naming)
    return ModelCase(
        proven=counts[Outcome.PROVEN],
        open_=counts[Outcome.OPEN],
        immaterial=counts[Outcome.IMMATERIAL],
        size=len(tested),
        share=share,
        remains=judgement.remainder_location is not None,
        base=_nameless_case(judgement.linearised, judgement.naming, criteria),
        held_out=held_out,
        criteria=criteria,
        form_is_gone=form_is_gone,
    )


def _standing(
    judgement: Judgement, tested: Sequence[Tested], word: str, criteria: Criteria, record: Record
) -> Judgement:
    """The judgement with what its elements gain, and with a remainder that is told only where it matters."""
    verdict = judgement.verdict if word == "kept" else word
    small = _small_remainder(judgement, criteria, record)
    return replace(judgement, findings=_shown(tested), verdict=verdict, remainder_immaterial=small)


def _shown(tested: Sequence[Tested], nameless: bool = False) -> tuple[Finding, ...]:
    """Elements with what they gain; provisional are those that are not proven, or all."""
    return tuple(
        replace(
            t.finding,
            held_out=t.case.held_out,
            provisional=nameless or t.finding.provisional or t.outcome not in SURE,
        )
        for t in tested
    )


def _small_remainder(judgement: Judgement, criteria: Criteria, record: Record) -> Immaterial | None:
    """What is significant in the residual of the final model, where it is too small to matter."""
    if judgement.remainder is None or judgement.remainder_location is None:
        return None
    decided = record.decide(REMAINDER, _nameless_case(judgement.final_linearised, judgement.remainder, criteria))
    return _size(judgement.final_linearised, judgement.remainder) if decided is not None else None


def _dropped(judgement: Judgement, fallen: Tested, score_again: Callable[[Fit], Scored]) -> Judgement:
    """The judgement without one of several elements; what the rest leaves is scored again."""
    here = score_again(fallen.alone)
    rest = without_element(judgement.findings, fallen.finding)
    return replace(
        judgement,
        findings=tuple(replace(f, others_alone=None) for f in rest),
        final=fallen.alone,
        final_linearised=here.linearised,
        remainder=here.naming,
        remainder_location=here.remaining,
    )


def _nameless(judgement: Judgement, tested: Sequence[Tested], criteria: Criteria, record: Record) -> Judgement:
    """A judgement that names nothing: the model keeps what helps, and a mismatch has to be worth telling."""
    location = judgement.location
    assert location is not None
    able = tested if all(_helps(t, criteria.confirmation) for t in tested) else ()
    case = replace(
        _nameless_case(judgement.linearised, judgement.naming, criteria),
        proven=any(t.outcome in SURE for t in able),
        gains=max((t.shown.share_of_noise for t in able), default=0.0),
    )
    if record.decide(NAMELESS, case) is not None:
        return immaterial(judgement, _size(judgement.linearised, judgement.naming))
    if not able:
        return unexplained(judgement.linearised, judgement.naming, location, judgement.tried)
    small = _small_remainder(judgement, criteria, record)
    return replace(judgement, verdict="unknown", findings=_shown(able, nameless=True), remainder_immaterial=small)


def _nameless_case(linearised: LinearisedFit, naming: Naming, criteria: Criteria) -> NamelessCase:
    """What is significant in a model's residual: the strongest score ``S`` explains ``S/√N`` of the noise."""
    fitted = linearised.fit
    return NamelessCase(naming.statistic / math.sqrt(fitted.residual.size), fitted.chi2, criteria)


def _size(linearised: LinearisedFit, naming: Naming) -> Immaterial:
    """What the strongest score stands for, where the residual as a whole does not exceed the noise."""
    share = naming.statistic / math.sqrt(linearised.fit.residual.size)
    leading = next((c.effect.name for c in naming.candidates if c.score >= naming.generic), None)
    return Immaterial(leading, share * linearised.scales.noise, share)
