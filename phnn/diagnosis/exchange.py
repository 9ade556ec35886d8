"""Elements of a complete model against their neighbours, each in its place beside all others.

The rivals of an element were refitted when it was added, and what came later was not in the model then. With all
others in place its neighbours, the effects that recordings cannot always tell from it, are refitted once more. An
element gives way to one with which the model has a clearly lower criterion of Schwarz (1978); the name stands for all
that come as near as chance allows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from phnn.diagnosis.finding import Finding, without_element
from phnn.diagnosis.refit import refit
from phnn.diagnosis.retest import without
from phnn.diagnosis.rules import Record
from phnn.diagnosis.rules.composition import ExchangeCase, is_exchanged
from phnn.diagnosis.search import Search
from phnn.diagnosis.trial import Trial, class_of, criterion, tie
from phnn.effects import Effect
from phnn.identification.fit import Fit


def exchanged(
    base: Fit, findings: tuple[Finding, ...], fitted: Fit, search: Search, record: Record, places: Sequence[int]
) -> tuple[tuple[Finding, ...], Fit]:
    """The elements of a model, some held against their neighbours in their places, and the fit of all of them.

    Args:
        base: the fit without any element.
        findings: the elements in the order in which they were added; learned ones have no neighbours.
        fitted: the fit with all of them.
        places: of the elements that are asked.
    """
    # Sums of squares are compared that differ by little: none may come from other sub-steps.
    base = replace(base, plan=fitted.plan)
    for place in places:
        finding = findings[place]
        rivals, others = _neighbours(finding, findings, search.effects), without_element(findings, finding)
        if finding.learned or not rivals or not others:
            continue
        alone = without(base, others, finding, fitted, search.criteria)
        if alone is None:
            continue
        again, best = _best(finding, alone, fitted, rivals, search, record)
        if best is not fitted:
            findings, fitted = tuple(replace(f, others_alone=None) for f in findings), best
        findings = (*findings[:place], replace(again, others_alone=alone), *findings[place + 1 :])
    return findings, fitted


def _neighbours(finding: Finding, findings: Sequence[Finding], effects: Sequence[Effect]) -> list[Effect]:
    """Effects that may be what an element is: its neighbours and the members of its class, further copies included."""
    used, members = {f.effect.name for f in findings}, {t.candidate.effect.name for t in finding.members}
    return [e for e in effects if e.name not in used and (e.name in members or e.is_neighbour_of(finding.effect))]


def _best(
    finding: Finding, alone: Fit, fitted: Fit, rivals: Sequence[Effect], search: Search, record: Record
) -> tuple[Finding, Fit]:
    """The element, or the rival that takes its place, with its class and the fit of the whole model.

    The element itself takes part in the race of refits, so that what falls far behind it is soon given up.
    """
    criteria, effect = search.criteria, finding.effect
    scored = search.scores_of(alone, (*rivals, effect)).naming.candidates
    found = [c for c in scored if c.effect is not effect]
    values = {n: fitted.setup.values()[n] for n in effect.parameters}
    own = [replace(c, values=values, others=()) for c in scored if c.effect is effect]
    search.progress(f"refit {len(found)} neighbours of {effect.name} in its place")
    trials = refit(alone, [*own, *found], search.executor, criteria=criteria)
    mine = Trial(finding.trial.candidate, fitted)
    others = sorted((t for t in trials if t.candidate.effect is not effect), key=criterion)
    # A special case claims less, and needs no evidence of its own.
    special = bool(others) and others[0].candidate.effect.name in effect.special_names
    least = 0.0 if special else tie(fitted, criteria.composition.exchange)
    case = ExchangeCase(criterion(mine), criterion(others[0]) if others else None, least)
    best, *rest = (*others, mine) if is_exchanged(case, effect.name, record) else (mine, *others)
    assert best.fit is not None
    rest.sort(key=criterion)
    members = class_of([best, *rest], rule=criteria.selection)
    if best is mine and {t.candidate.effect for t in members} == {t.candidate.effect for t in finding.members}:
        return finding, fitted
    # What was tried on other recordings, or beside fewer elements, is no measure for these refits.
    return replace(finding, trial=best, members=tuple(members), trials=(best, *rest)), best.fit
