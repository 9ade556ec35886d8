"""Refit candidate effects in full, from several starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from operator import attrgetter
from typing import Any

from phnn.criteria import CRITERIA, Criteria, Race
from phnn.diagnose.linearised import prepare
from phnn.diagnosis.name import Candidate, first_by_name, score
from phnn.diagnosis.starts import has_large_starts
from phnn.diagnosis.steps import (
    finished,
    first_steps,
    from_large_starts,
    from_several_starts,
    further_steps,
    moving,
    on_all_recordings,
)
from phnn.diagnosis.trial import Trial, criterion
from phnn.effects import Effect
from phnn.identification.fit import Fit, fit
from phnn.identification.staged import stated_only
from phnn.identification.subset import representative_subset
from phnn.parallel import SERIAL, Executor
from phnn.rescue import results

# Candidates of the first round that are refitted before the next ones are compared with the best of them.
_CHUNK = 3
_COST = attrgetter("cost")


def refit(
    base: Fit,
    candidates: Sequence[Candidate],
    executor: Executor = SERIAL,
    hidden: Sequence[Candidate] = (),
    criteria: Criteria = CRITERIA,
) -> list[Trial]:
    """Candidates refitted together with the base parameters, best first: a race in three rounds.

    All that score within reach of the best take a few steps from one start; those that save most go on from several
    starts; those that come near the best are carried to convergence, or one where nothing explains a thing. Where
    nothing explains much, all that have a strength, the hidden ones too, start again at finite strengths before, on few
    recordings. Special cases of the best one start from where it has led.

    Args:
        base: the fit without them.
        candidates: best score first.
        hidden: others, whose score says too little to come into question by it.
        executor: where; away from this thread every refit keeps to one thread, and the results stay the same.
        criteria: which refits go on, and how long.

    Raises:
        SolverFailed: a candidate kills every worker process that refits it, and nobody accounts for that.
        Stopped: the time of a search is up.
    """
    race, unknown = criteria.race, [Trial(c, None) for c in hidden]
    trials = _as_scored(base, candidates, executor, criteria) if candidates else unknown
    if not trials:
        return []
    if not _leaves_less(race.unexplained_left, trials[0], base):
        trials = _from_large_starts(base, trials, unknown, executor, criteria)
    trials = _with_special(base, trials, unknown, executor, criteria)
    rivals = [t for t in trials if _comes_near(t, trials[0], base, criteria)]
    large = base.chi2 > race.large_residual**2
    comparable = not large or _leaves_less(race.incomparable_left, trials[0], base)
    last = rivals[: race.enter_last if comparable else 1]
    ended = {t.candidate.effect for t in last}
    trials = _again(partial(finished, limits=criteria.refits), base, trials, last, executor)
    best = first_by_name(trials, lambda t: t.candidate.effect).values()
    return [replace(t, converged=t.fit is not None and t.candidate.effect in ended) for t in best]


def refitted_effects(
    alone: Fit, effects: Sequence[Effect], executor: Executor = SERIAL, criteria: Criteria = CRITERIA
) -> list[tuple[Effect, Fit]]:
    """Effects refitted beside a fit without them; their scores only give starts."""
    naming = score(prepare(alone).on_subset(), effects, None, 0)
    trials = refit(alone, naming.candidates, executor, criteria=criteria)
    return [(t.candidate.effect, t.fit) for t in trials if t.fit is not None]


def _again(
    work: Callable[[Fit, Any], Fit | None],
    base: Fit,
    trials: Sequence[Trial],
    some: Sequence[Trial],
    executor: Executor,
) -> list[Trial]:
    """Further work on some of the trials; all of them, best first."""
    done = [Trial(t.candidate, f) for t, f in zip(some, _fits(work, base, some, executor), strict=True)]
    return sorted([*done, *(t for t in trials if t not in some)], key=criterion)


def _from_large_starts(
    base: Fit, trials: list[Trial], hidden: list[Trial], executor: Executor, criteria: Criteria
) -> list[Trial]:
    """Refit effects that explain little so far: a few steps on few recordings from finite strengths; the best ones
    continue on all recordings."""
    tried = {t.candidate.effect for t in trials}
    failed = [t for t in trials if not _leaves_less(criteria.race.failed_left, t, base)]
    todo = [*failed, *(h for h in hidden if h.candidate.effect not in tried)]
    todo = [Trial(t.candidate, None) for t in todo if has_large_starts(t.candidate.effect)]
    if not todo:
        return trials
    few = _on_few_recordings(base)
    # Wherever the steps are made, they need no trajectories.
    linearised = replace(prepare(_as_sent(few, executor)), trajectories=())
    limits = criteria.refits
    begun = _again(partial(from_large_starts, linearised, limits=limits), few, todo, todo, executor)
    begun = begun[: criteria.race.enter_large]
    onwards = partial(further_steps if few is base else on_all_recordings, limits=limits)
    further = _again(onwards, base, begun, begun, executor)
    return _best_of_each([*trials, *further])


def _best_of_each(trials: Sequence[Trial]) -> list[Trial]:
    """The best trial of every effect, best first."""
    best: dict[Effect, Trial] = {}
    for trial in sorted(trials, key=criterion):
        best.setdefault(trial.candidate.effect, trial)
    return list(best.values())


def _on_few_recordings(base: Fit) -> Fit:
    """The base fit on the first few recordings, its parameters as they are."""
    few = representative_subset(base.plan)
    return base if few is base.plan else fit(base.setup, few, base.variables.names, base.held, 1, origin=base)


def _with_special(
    base: Fit, trials: list[Trial], hidden: list[Trial], executor: Executor, criteria: Criteria
) -> list[Trial]:
    """Further steps of the special cases of the best one, from where it has led.

    Special cases are skipped that would change a parameter which the user fixed.
    """
    best, known = trials[0], first_by_name((*trials, *hidden), lambda t: t.candidate.effect)
    if best.fit is None:
        return trials
    found = best.fit.setup.values()
    for case in best.candidate.effect.special_cases:
        changed = case.values(found)
        if case.name not in known or set(changed) & set(stated_only(base.held)):
            continue
        values, trial = found | changed, known[case.name]
        there = base.setup.with_values({name: values[name] for name in base.setup.values()})
        begun = replace(trial.candidate, values={n: values[n] for n in trial.candidate.effect.parameters}, others=())
        rest = [t for t in trials if t is not trial]
        moved = replace(base, alternatives=(there,))
        work = partial(from_several_starts, limits=criteria.refits)
        trials = _again(work, moved, rest, [Trial(begun, trial.fit)], executor)
    return trials


def _as_scored(base: Fit, candidates: Sequence[Candidate], executor: Executor, criteria: Criteria) -> list[Trial]:
    """Refit all candidates shortly, then the best ones from their other starts."""
    race, trials = criteria.race, _first_round(base, candidates, executor, criteria)
    least = base.cost - race.least_saving * (base.cost - trials[0].cost)
    # What ends above the base model, which it contains, had a bad start: nothing is known of it yet.
    rivals = [t for t in trials if not least < t.cost <= base.cost and _may_tie(t, trials[0], base, race)]
    work = partial(from_several_starts, limits=criteria.refits)
    return _again(work, base, trials, rivals[: race.enter_second], executor)


def _first_round(base: Fit, candidates: Sequence[Candidate], executor: Executor, criteria: Criteria) -> list[Trial]:
    """A few steps of each, a few candidates at a time, until one explains nearly everything; best first."""
    race, work = criteria.race, partial(first_steps, limits=criteria.refits)
    tried = [c for c in candidates if c.score >= race.least_score * candidates[0].score]
    trials: list[Trial] = []
    for first in range(0, len(tried), _CHUNK):
        some = tried[first : first + _CHUNK]
        if trials:
            best = min(trials, key=_COST)
            some = [c for c in some if _may_tie(Trial(c, None), best, base, race)]
        trials += [Trial(c, f) for c, f in zip(some, _fits(work, base, some, executor), strict=True)]
    return sorted(trials, key=_COST)


def _may_tie(trial: Trial, best: Trial, base: Fit, race: Race) -> bool:
    """Whether a candidate can still end where the best one is."""
    if not _leaves_less(race.explained_left, best, base):
        return True
    return trial.candidate.score >= race.rival_score * best.candidate.score


def _leaves_less(share: float, trial: Trial, base: Fit) -> bool:
    """Whether a refit leaves less than a share of the excess."""
    return trial.cost - base.residual.size < share * (base.cost - base.residual.size)


def _comes_near(trial: Trial, best: Trial, base: Fit, criteria: Criteria) -> bool:
    """Whether a candidate before the last round can still end where the best one is."""
    race = criteria.race
    may_move = trial.fit is not None and moving(trial.fit, criteria.refits) and _may_tie(trial, best, base, race)
    neighbour = trial.candidate.effect.name in best.candidate.effect.neighbours
    return trial.cost <= (race.near_moving if may_move or neighbour else race.near_at_rest) * best.cost


def _as_sent(base: Fit, executor: Executor) -> Fit:
    """The base fit that refits get: threads of one that runs beside others would only get into each other's way."""
    return base if executor == SERIAL else replace(base, plan=replace(base.plan, workers=1))


def _fits(
    work: Callable[[Fit, Any], Fit | None], base: Fit, items: Sequence[Any], executor: Executor
) -> list[Fit | None]:
    """``work(base, item)`` of every item, on the very recordings of the base fit wherever it was done."""
    names = [getattr(item, "candidate", item).effect.name for item in items]
    fits = results(executor.each, partial(work, _as_sent(base, executor)), items, names)
    return [f if f is None else replace(f, plan=replace(base.plan, substeps=f.plan.substeps)) for f in fits]
