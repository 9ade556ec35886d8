"""Forward selection of effects with backward deletion, and when a selection stands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from phnn.criteria import CRITERIA, Criteria, Selection
from phnn.diagnose.linearised import tie
from phnn.diagnose.locations import Location
from phnn.diagnosis.finding import Finding, effects_of, own_parameters
from phnn.diagnosis.name import Candidate, Naming
from phnn.diagnosis.place import elsewhere, in_place, located, may_lie, of_its_kinds
from phnn.diagnosis.refit import refit
from phnn.diagnosis.retest import retested
from phnn.diagnosis.rules import Applied, Record
from phnn.diagnosis.rules.search import DISCARD, FORM, KEEP, REFIT, STEP, STOP, KeepCase, StepCase
from phnn.diagnosis.scored import Scored, excess
from phnn.diagnosis.search import Search
from phnn.diagnosis.trial import Trial, class_of, criterion
from phnn.identification.fit import Fit
from phnn.identification.options import Options
from phnn.identification.refinement import numerical_error, with_bounded_error
from phnn.rescue import attempt, kept, move


@dataclass(frozen=True)
class Selected:
    """A step of the selection.

    Attributes:
        findings: the effects so far; model: with them; share: of the excess that the last one explains.
        rules: all that were asked in the search; empty before its end.
        longest: of the finished search: the last step before effects were withdrawn; None where none were.
    """

    findings: tuple[Finding, ...]
    model: Scored
    share: float
    rules: tuple[Applied, ...] = ()
    longest: Selected | None = None


def select(base: Scored, search: Search) -> tuple[Selected, tuple[Trial, ...]]:
    """Forward selection with backward deletion; and what was tried for the first effect.

    Of two effects of one size the first explains but half, so that one is tried upon another while each takes some of
    what is left. Where the best one leaves something elsewhere, others that explain well come into question. What is
    kept in the end either leaves nothing significant, or its last effect took most of what there was and left nothing
    that has a location: a further effect has to remove most of what the one before left. One effect in another form
    gives way to two only where these leave nothing.

    Args:
        base: the base model, which leaves something significant.
    """
    record = Record()
    steps, tried = _forward(base, search, record)
    longest = steps[-1]
    while len(steps) > 1 and not _kept(steps, search.criteria, record):
        steps.pop()
    kept = steps[-1]
    return replace(kept, rules=tuple(record.asked), longest=None if kept is longest else longest), tried


def _forward(base: Scored, search: Search, record: Record) -> tuple[list[Selected], tuple[Trial, ...]]:
    """The steps of the forward selection, the base model first, and what was tried for the first effect."""
    steps = [Selected((), base, 1.0)]
    tried: tuple[Trial, ...] = ()
    # How many steps make up one that may be all there is in another form: more of them must leave nothing.
    enough: int | None = None
    while len(steps) <= search.max_effects and steps[-1].model.significant:
        nothing: tuple[tuple[Trial, ...], Selected | None, bool] = (), None, False
        trials, step, goes_on = move(f"element {len(steps)}", partial(_step, search, base, steps[-1], record), nothing)
        tried = tried or trials
        if step is None:
            break
        steps.append(step)
        left = step.model.remaining
        if not goes_on or left is None:
            break
        if enough is None:
            other_form = _in_another_form(step, _location(base), left, search.criteria)
            form = replace(_step_case(step, search.criteria), form=other_form)
            stop = record.decide(FORM, form, _added(step))
            enough = len(steps) if stop is not None else None
            if stop is not None and stop.outcome == STOP:
                break
    if enough is not None and steps[-1].model.remaining is not None:
        del steps[enough:]
    return steps, tried


def _step(
    search: Search, base: Scored, last: Selected, record: Record
) -> tuple[tuple[Trial, ...], Selected | None, bool]:
    """What was tried for one more effect, the step with it, None where none is worth one, and whether to go on."""
    trials = _refitted(search, base, last)
    step, goes_on = _next(search, base, last, trials, record)
    # Asked here, so that where it cannot be located the whole step has failed.
    return tuple(trials), step, goes_on and step is not None and step.model.remaining is not None


def _next(
    search: Search, base: Scored, last: Selected, trials: Sequence[Trial], record: Record
) -> tuple[Selected | None, bool]:
    """The step with one more effect, None where no trial is worth one, and whether the selection goes on after it."""
    if not trials or trials[0].fit is None:
        return None, False
    share = share_of(last.model.linearised.fit, trials[0].fit, last.model.naming)
    best = StepCase(share, trials[0].fit.chi2, None, None, search.criteria)
    if record.decide(REFIT, best, trials[0].candidate.effect.name) is not None:
        return None, False
    step = _with(search, base, last, trials)
    if not last.findings:
        step = _at_home(search, base, last, trials, step)
    stop = record.decide(STEP, _step_case(step, search.criteria), _added(step))
    if stop is not None and stop.outcome == DISCARD:
        return None, False
    return step, stop is None


def _location(base: Scored) -> Location:
    """Where the mismatch of a base model is that leaves something significant."""
    location = base.remaining
    assert location is not None
    return location


def _step_case(step: Selected, criteria: Criteria) -> StepCase:
    model = step.model
    return StepCase(step.share, model.linearised.fit.chi2, model.significant, model.naming.p_value, criteria)


def _added(step: Selected) -> str:
    """Name of the last effect of a step."""
    return step.findings[-1].effect.name if step.findings else ""


def _refitted(search: Search, base: Scored, last: Selected) -> list[Trial]:
    """Refits of what may be added next, best first."""
    here, criteria = last.model.remaining or _location(base), search.criteria
    rule, place = criteria.selection, criteria.location
    able = [c for c in last.model.naming.candidates if c.p_value < rule.level and may_lie(c.effect, here, place)]
    able = able[: rule.further_refits if last.findings else rule.first_refits]
    search.progress(f"refit {len(able)} candidates for element {len(last.findings) + 1}")
    # Where these explain little, the base model may have taken over so much that score and place deceive: then all of
    # the catalogue is tried.

    def keep(item: Candidate | Trial, fitted: Fit | None) -> None:
        if fitted is not None:
            only = Trial(item.candidate if isinstance(item, Trial) else item, fitted)
            finding = Finding(only, (only,), (only,), last.model.naming, level=rule.level)
            search.visit((*last.findings, finding), fitted)

    with kept(keep):
        trials = refit(last.model.linearised.fit, able, search.executor, last.model.naming.candidates, criteria)
    return in_place(_compared(trials, own_parameters(last.findings), rule), here, rule)


def _at_home(search: Search, base: Scored, last: Selected, trials: Sequence[Trial], step: Selected) -> Selected:
    """The step, or that with another effect which explains well and, unlike the best one, leaves nothing elsewhere.

    What fits better than that one stays in its class.
    """
    criteria, location = search.criteria, _location(base)
    if not misplaced(step, location, criteria):
        return step
    for rival in trials[1:]:
        if rival.fit is not None and _explains_well(rival.fit, last, criteria):
            tried = _with(search, base, last, [rival, *(t for t in trials if t is not rival)])
            left = tried.model.remaining
            if left is None or (located(left, criteria.location) and not misplaced(tried, location, criteria)):
                return tried
    return step


def _in_another_form(step: Selected, location: Location, left: Location, criteria: Criteria) -> bool:
    """Whether what is left may be another form of what was found, so that no further effect need be looked for.

    Functions of its own kind have to say so: a constant, of which there are none, has no other form.
    """
    has_forms = any(of_its_kinds(left, e) for e in effects_of(step.findings))
    well = step.share > criteria.selection.explains_well and located(left, criteria.location)
    return has_forms and well and not elsewhere(effects_of(step.findings), location, left, rule=criteria.location)


def misplaced(step: Selected, location: Location, criteria: Criteria = CRITERIA) -> bool:
    """Whether a selection leaves more than the noise level is known to, and that elsewhere than what was named."""
    left, over = step.model.remaining, step.model.linearised.fit.chi2
    rule = criteria.selection
    if left is None or not over > rule.noise_doubt**2:
        return False
    little = over < rule.small_residual**2
    return elsewhere(effects_of(step.findings), location, left, little, criteria.location)


def _kept(steps: Sequence[Selected], criteria: Criteria = CRITERIA, record: Record | None = None) -> bool:
    """Whether the last step of a selection stands, by the rules of `phnn.diagnosis.rules.search.KEEP`."""
    last, place = steps[-1], criteria.location
    left, whole, first = last.model.remaining, steps[0].model.remaining, len(steps) == 2
    placed = left is not None and located(left, place)
    if first:
        placed = placed or (whole is not None and located(whole, place))
    own = left is not None and (first or not elsewhere(effects_of(last.findings[-1:]), left, left, rule=place))
    chi2 = last.model.linearised.fit.chi2
    case = KeepCase(last.share, chi2, left is not None, first, placed, own, criteria.selection)
    found = (record or Record()).decide(KEEP, case, _added(last))
    return found is not None and found.outcome == "keep"


def _with(search: Search, base: Scored, last: Selected, trials: Sequence[Trial]) -> Selected:
    """The step with the best of some trials, what came before tested again."""
    best, fitted, rule = trials[0], trials[0].fit, search.criteria.selection
    assert fitted is not None
    model = search.scored(fitted)
    share = share_of(last.model.linearised.fit, fitted, last.model.naming)
    members = class_of(trials, model.significant, rule)
    if model.significant:
        members += [t for t in trials if t not in members and _as_well(t, best, last, search.criteria)]
        fitted = exact(fitted, [*own_parameters(last.findings), *best.candidate.effect.parameters], rule)
        best = members[0] = Trial(best.candidate, fitted)
    found = Finding(best, tuple(members), tuple(trials), last.model.naming, level=rule.level)
    findings = (*last.findings, found)
    findings, fitted = retested(
        base.linearised.fit, _location(base), findings, fitted, search.executor, search.criteria
    )
    if fitted is not model.linearised.fit:
        fitted = exact(fitted, own_parameters(findings), rule)
        model = search.scored(fitted)
    return Selected(findings, model, share)


def exact(fitted: Fit, keep: Sequence[str], rule: Selection) -> Fit:
    """The fit with sub-steps that bound the numerical error, where it has outgrown those of the base model.

    While much is left to be found, a small share of that is bound enough.
    """
    bound = max(Options.error_bound_sigma, rule.numerical_share * max(excess(fitted), 0.0) ** 0.5)
    if numerical_error(fitted).sigma <= bound:
        return fitted
    return attempt("finer steps", lambda: with_bounded_error(fitted, bound, keep)[0], fitted)


def _compared(trials: list[Trial], keep: Sequence[str], rule: Selection) -> list[Trial]:
    """The trials, best first, those that end near the best one compared without the numerical error of either."""
    if not trials or trials[0].fit is None:
        return trials
    most = trials[0].fair_cost + rule.compared_within * tie(trials[0].fit, rule.tie)
    near = [t for t in trials if t.fit is not None and t.fair_cost <= most]
    if len(near) < 2:
        return trials
    bounded = [
        replace(t, fit=exact(t.fit, [*keep, *t.candidate.effect.parameters], rule)) for t in near if t.fit is not None
    ]
    return sorted([*bounded, *(t for t in trials if t not in near)], key=criterion)


def _as_well(trial: Trial, best: Trial, last: Selected, criteria: Criteria) -> bool:
    """Whether an effect of the best one's kind explains well too: of the forms of one kind, none of them the true one,
    the one that comes nearest need not be its name."""
    effect, other = trial.candidate.effect, best.candidate.effect
    if trial.fit is None or (effect.location, effect.kind) != (other.location, other.kind):
        return False
    return _explains_well(trial.fit, last, criteria)


def _explains_well(fitted: Fit, last: Selected, criteria: Criteria) -> bool:
    share = share_of(last.model.linearised.fit, fitted, last.model.naming)
    return share > criteria.selection.explains_well


def share_of(before: Fit, after: Fit, scores: Naming) -> float:
    """Share of the explainable sum of squares that an effect has taken.

    Explainable is the excess over the noise, less its own spread, and at least what one direction would take.
    """
    spread = 2.0 * (2.0 * before.residual.size) ** 0.5
    explainable = max(excess(before) - spread, scores.statistic**2, 1e-300)
    return (before.cost - after.cost) / explainable
