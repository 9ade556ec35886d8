"""Questions to a next recording: the models that compete for each tie, and for each element without a name.

| question | models |
|---|---|
| effects or places that are tied | one refit each |
| an element that a formula describes | the formula, the formulas that fit as well, and refits in its place |
| another element whose name is not claimed | the model with it, and refits in its place |

A refit in the place of an element is a rival if it fits as well (`phnn.diagnosis.trial.class_of`). Where the model
leaves a remainder that is no noise, it is one as well if it takes nine tenths of what the element takes: the remainder
may favour either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from phnn.criteria import CRITERIA, Criteria
from phnn.diagnose.linearised import tie
from phnn.diagnose.proposal import Question, Rival, refitted_rival
from phnn.diagnosis.finding import Finding, effects_of
from phnn.diagnosis.judge import Judgement
from phnn.diagnosis.retest import fit_with
from phnn.diagnosis.trial import Trial
from phnn.identification.fit import Fit


def questions(judgement: Judgement, criteria: Criteria = CRITERIA) -> tuple[Question, ...]:
    """All questions with two models or more; where there is none, that about the numbers of the element without a name
    that takes most."""
    if not judgement.findings:
        places = tied_members(judgement)
        return (Question(of_trials(places)),) if len(places) > 1 else ()
    found = sorted(judgement.findings, key=lambda f: -_takes(f))[: criteria.composition.asked_elements]
    every = [_question(judgement, f, criteria) for f in found]
    several = tuple(q for q in every if len(q.models) > 1)
    return several or tuple(q for q in every if q.element and q.models[0].own)[:1]


def tied_members(judgement: Judgement) -> tuple[Trial, ...]:
    """Refitted models that the recordings cannot tell apart: a class of effects, or where nothing is named and places
    are tied, the best model of each place that fits better than the base model."""
    members = next((f.members for f in judgement.findings if len(f.members) > 1 and not f.laws), ())
    location = judgement.location
    if members or judgement.findings or location is None or not location.tied:
        return members
    able = [t for t in judgement.tried if t.fit is not None and t.cost < judgement.linearised.fit.cost]
    best: dict[str, Trial] = {}
    for trial in sorted(able, key=lambda t: t.cost):
        best.setdefault(trial.candidate.effect.location, trial)
    return tuple(best[place] for place in (location.name, *location.tied) if place in best)


def of_trials(trials: Sequence[Trial]) -> tuple[Rival, ...]:
    """Refits as models that compete."""
    fits = [(t.candidate.effect, t.fit) for t in trials]
    return tuple(refitted_rival(e.name, f, e.parameters) for e, f in fits if f is not None)


def _takes(finding: Finding) -> float:
    """What an element takes of the residual, noise²."""
    found = finding.gained or finding.held_out
    return found.takes if found is not None else 0.0


def _question(judgement: Judgement, finding: Finding, criteria: Criteria) -> Question:
    """The question of one element: the present model with it, and its rivals."""
    effect, most = finding.effect, criteria.race.enter_last
    described = finding.described
    models = described.models[:most] if described is not None else ()
    models = models or (refitted_rival(effect.name, judgement.final, effect.parameters),)
    # One effect in another form has no rival in its own form.
    refits = [] if len(finding.laws) == 1 else _refits(judgement, finding, most - len(models), criteria)
    return Question((*models, *of_trials(refits)), effect.name if finding.provisional else "")


def _refits(judgement: Judgement, finding: Finding, most: int, criteria: Criteria) -> list[Trial]:
    """What was tried in the place of an element and comes near it, refitted beside all other elements of the model."""
    others = tuple(f for f in judgement.findings if f is not finding)
    taken = {e.name for e in (finding.effect, *effects_of(others))}
    reach = _Reach(judgement, finding, others, criteria)
    members = [t for t in finding.alike if t.candidate.effect.name not in taken]
    tried = [t for t in sorted(finding.trials, key=lambda t: t.fair_cost) if reach.may_reach(t)]
    chosen: dict[str, Trial] = {}
    for trial in (*members, *tried) if finding.provisional else members:
        if trial.fit is not None and trial.candidate.effect.name not in taken:
            chosen.setdefault(trial.candidate.effect.name, trial)
    again = [_again(judgement, finding, others, t, criteria) for t in list(chosen.values())[:most]]
    # What the diagnosis calls equivalent stays in any case.
    same = {t.candidate.effect.name for t in members}
    return [t for t in again if t.fit is not None and (t.candidate.effect.name in same or reach.reaches(t.fit))]


class _Reach:
    """How much a rival may leave.

    Args:
        others: the other elements of the model.
    """

    def __init__(self, judgement: Judgement, finding: Finding, others: Sequence[Finding], criteria: Criteria) -> None:
        rule, final = criteria.selection, judgement.final
        self._final, self._own = final, finding.trial.fit
        self._more = tie(final, rule.tie)
        matters = judgement.remainder_location is not None and judgement.remainder_immaterial is None
        if final.chi2 > rule.small_residual**2 or matters:
            alone = _alone(judgement, finding, others)
            takes = alone.cost - final.cost if alone is not None else 0.0
            self._more = max(self._more, rule.tie_of_remainder * final.beyond_noise, (1.0 - rule.explains_well) * takes)

    def reaches(self, fitted: Fit) -> bool:
        """Whether a refit to all identification recordings comes near the model."""
        return fitted.cost <= self._final.cost + self._more

    def may_reach(self, trial: Trial) -> bool:
        """Whether a refit to some of the recordings may, by what it leaves there more than the element does."""
        if trial.fit is None or self._own is None:
            return False
        share = trial.fit.residual.size / self._final.residual.size
        return trial.cost <= self._own.cost + share * self._more


def _alone(judgement: Judgement, finding: Finding, others: Sequence[Finding]) -> Fit | None:
    """The model without an element."""
    if not others:
        return judgement.linearised.fit
    return finding.others_alone or fit_with(judgement.linearised.fit, others, judgement.final.setup.values())


def _again(
    judgement: Judgement, finding: Finding, others: Sequence[Finding], trial: Trial, criteria: Criteria
) -> Trial:
    """A trial with its refit to all identification recordings beside all other elements, a few steps from there."""
    base, fitted = judgement.linearised.fit, trial.fit
    if fitted is None or (not others and fitted.residual.size == base.residual.size):
        return trial
    values = judgement.final.setup.values() | fitted.setup.values()
    all_of_them = (*others, replace(finding, trial=trial))
    return Trial(
        trial.candidate, fit_with(base, all_of_them, values, criteria.refits.second_evaluations, limits=criteria.refits)
    )
