"""Elements of a complete model against their neighbours, each in its place beside all others.

The rivals of an element were refitted when it was added, and what came later was not in the model then. With all
others in place its neighbours, the effects that recordings cannot always tell from it, are refitted once more. An
element gives way to one with which the model has a clearly lower criterion of Schwarz (1978); the name stands for all
that come as near as chance allows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from phnn.criteria import Criteria
from phnn.diagnose.linearised import tie
from phnn.diagnosis.finding import Finding, without_element
from phnn.diagnosis.name import Candidate
from phnn.diagnosis.refit import refit
from phnn.diagnosis.retest import fit_with, without
from phnn.diagnosis.rules import Record
from phnn.diagnosis.rules.composition import ExchangeCase, is_exchanged
from phnn.diagnosis.scored import Scored
from phnn.diagnosis.search import Search
from phnn.diagnosis.trial import Trial, class_of, criterion
from phnn.effects import Effect
from phnn.identification.fit import Fit


def exchanged(
    base: Fit, findings: tuple[Finding, ...], model: Scored, search: Search, record: Record, places: Sequence[int]
) -> tuple[tuple[Finding, ...], Fit]:
    """The elements of a model, some held against their neighbours in their places, and the fit of all of them.

    Each is asked once, in order. What was exchanged lacks the share of the excess that the search's effects took.

    Args:
        base: the fit without any element.
        findings: the elements in the order in which they were added.
        model: the fit with all of them, and whether it leaves something.
        places: of the elements that are asked; learned ones among them are left as they are.
    """
    fitted = model.linearised.fit
    # Sums of squares are compared that differ by little: none may come from other sub-steps.
    base = replace(base, plan=fitted.plan)
    for place in places:
        finding = findings[place]
        others, rivals = without_element(findings, finding), _neighbours(finding, findings, search.effects)
        if finding.learned or not rivals or not others or _needed_by(finding, others):
            continue
        alone = without(base, others, finding, fitted, search.criteria)
        if alone is None:
            continue
        trials = [_in_place(base, findings, place, t) for t in _refitted(finding, alone, fitted, rivals, search)]
        again = _best(finding, trials, fitted, model.significant, search.criteria, record)
        if again is not finding and again.trial.fit is not None and again.trial.fit is not fitted:
            findings, fitted = tuple(replace(f, others_alone=None) for f in findings), again.trial.fit
        findings = (*findings[:place], replace(again, others_alone=alone), *findings[place + 1 :])
    return findings, fitted


def _neighbours(finding: Finding, findings: Sequence[Finding], effects: Sequence[Effect]) -> list[Effect]:
    """Effects that may be what an element is: its neighbours and the members of its class, further copies included."""
    used, members = {f.effect.name for f in findings}, {t.candidate.effect.name for t in finding.members}
    return [e for e in effects if e.name not in used and (e.name in members or e.is_neighbour_of(finding.effect))]


def _needed_by(finding: Finding, others: Sequence[Finding]) -> bool:
    """Whether a further copy of an effect stands on it."""
    return any(set(f.effect.after) & set(finding.effect.parameters) for f in others)


def _refitted(
    finding: Finding, alone: Fit, fitted: Fit, rivals: Sequence[Effect], search: Search
) -> list[tuple[Candidate, Fit]]:
    """The element and its rivals refitted to convergence beside all other elements.

    What falls far behind the element is soon given up.
    """
    effect = finding.effect
    scored = search.scores_of(alone, (*rivals, effect)).naming.candidates
    values = {n: fitted.setup.values()[n] for n in effect.parameters}
    own = [replace(c, values=values, others=()) for c in scored if c.effect is effect]
    found = [c for c in scored if c.effect is not effect]
    search.progress(f"refit {len(found)} neighbours of {effect.name} in its place")
    trials = refit(alone, [*own, *found], search.executor, criteria=search.criteria)
    return [(t.candidate, t.fit) for t in trials if t.fit is not None and t.converged]


def _in_place(base: Fit, findings: Sequence[Finding], place: int, refitted: tuple[Candidate, Fit]) -> Trial:
    """A rival with the fit of the model in which it was added in the place of the element, not after all others."""
    candidate, ended = refitted
    trial = Trial(candidate, ended)
    if place == len(findings) - 1:
        return trial
    model = (*findings[:place], replace(findings[place], trial=trial), *findings[place + 1 :])
    return Trial(candidate, fit_with(base, model, ended.setup.values(), origin=ended))


def _best(
    finding: Finding, trials: Sequence[Trial], fitted: Fit, significant: bool, criteria: Criteria, record: Record
) -> Finding:
    """The element, or the rival that takes its place, with its class.

    Earlier members of the class that were not refitted to the end stay in it.

    Args:
        significant: whether the model leaves something, which may favour either.
    """
    effect, rule, mine = finding.effect, criteria.selection, Trial(finding.trial.candidate, fitted)
    others = sorted((t for t in trials if t.candidate.effect is not effect), key=criterion)
    # The refit may have left a local optimum of the model.
    mine = next((t for t in trials if t not in others and t.cost < fitted.cost - tie(fitted, rule.tie)), mine)
    # A special case claims less, and needs no evidence of its own.
    special = bool(others) and others[0].candidate.effect.name in effect.special_names
    least = 0.0 if special else tie(fitted, criteria.composition.exchange)
    if significant and not special:
        least = max(least, rule.tie_of_remainder * fitted.beyond_noise)
    case = ExchangeCase(criterion(mine), criterion(others[0]) if others else None, least)
    best, *rest = (*others, mine) if is_exchanged(case, effect.name, record) else (mine, *others)
    rest.sort(key=criterion)
    members = class_of([best, *rest], significant, rule)
    same = {t.candidate.effect for t in members} == {t.candidate.effect for t in finding.members}
    if best.fit is fitted and same:
        return finding
    asked = {t.candidate.effect for t in (best, *rest)}
    members += [t for t in finding.members if t.candidate.effect not in asked]
    # What was tried on other recordings, or beside fewer elements, is no measure for these refits.
    first = finding.first if best is mine else None
    return replace(finding, trial=best, members=tuple(members), trials=(best, *rest), first=first)
