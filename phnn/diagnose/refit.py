"""Refit candidate effects in full, from several starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from operator import attrgetter
from typing import Any

from phnn.diagnose.ground import prepare
from phnn.diagnose.name import Candidate, first_by_name
from phnn.diagnose.starts import has_bold_starts
from phnn.diagnose.steps import (
    finished,
    first_steps,
    from_bold_starts,
    from_several_starts,
    further_steps,
    moving,
    on_all_recordings,
)
from phnn.diagnose.trial import LOUD, Trial, criterion
from phnn.effects import Effect
from phnn.ensemble import SERIAL, Executor
from phnn.identify.fit import Fit, fit
from phnn.identify.looks import first_look
from phnn.identify.staged import stated_only

# How many candidates go on from bold starts and enter the second and the third round.
_ENTER_BOLD, _ENTER_SECOND, _ENTER_THIRD = 6, 6, 4
# What saves less than this share of the best saving in the first round, or costs this many times as much after the
# second, cannot win.
_SAVES = 0.35
_NEAR = 2.0
# The same for one whose steps have come to rest, if it is no neighbour of the best: finer sub-steps and parameters that
# are set free move it little.
_NEAR_AT_REST = 1.3
# Scores are costs saved to first order; what scores below this share of the best cannot overtake it.
_WITHIN = 0.25
# Once a candidate leaves less than this share of the excess, only those that score nearly as high can still tie.
_SETTLED, _RIVAL = 0.05, 0.75
# Where the best one leaves more than this share, another may explain much more whose score does not show it.
_UNEXPLAINED = 0.1
# What leaves more than this share from where the score begins has been led nowhere by it.
_ASTRAY = 0.5
# Where all leave more than this share of a loud residual, it is vain to compare them.
_VAIN = 0.85
_CHUNK = 3
_COST = attrgetter("cost")


def refit(
    base: Fit, candidates: Sequence[Candidate], executor: Executor = SERIAL, hidden: Sequence[Candidate] = ()
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

    Raises:
        SolverFailed: a candidate kills every worker process that refits it.
    """
    unknown = [Trial(c, None) for c in hidden]
    trials = _as_scored(base, candidates, executor) if candidates else unknown
    if not trials:
        return []
    if not _settled(trials[0], base, _UNEXPLAINED):
        trials = _boldly(base, trials, unknown, executor)
    trials = _with_special(base, trials, unknown, executor)
    rivals = [t for t in trials if _comes_near(t, trials[0], base)]
    vain = base.chi2 > LOUD and not _settled(trials[0], base, _VAIN)
    trials = _again(finished, base, trials, rivals[: 1 if vain else _ENTER_THIRD], executor)
    return list(first_by_name(trials, lambda t: t.candidate.effect).values())


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


def _boldly(base: Fit, trials: list[Trial], hidden: list[Trial], executor: Executor) -> list[Trial]:
    """A few steps on few recordings from starts at finite strengths of all whose score has led nowhere; the best of
    them go on, on all recordings."""
    tried = {t.candidate.effect for t in trials}
    astray = [t for t in trials if not _settled(t, base, _ASTRAY)]
    todo = [*astray, *(h for h in hidden if h.candidate.effect not in tried)]
    todo = [Trial(t.candidate, None) for t in todo if has_bold_starts(t.candidate.effect)]
    if not todo:
        return trials
    few = _on_few_recordings(base)
    # Wherever the steps are made, they need no trajectories.
    ground = replace(prepare(_as_sent(few, executor)), trajectories=())
    begun = _again(partial(from_bold_starts, ground), few, todo, todo, executor)[:_ENTER_BOLD]
    further = _again(further_steps if few is base else on_all_recordings, base, begun, begun, executor)
    return _best_of_each([*trials, *further])


def _best_of_each(trials: Sequence[Trial]) -> list[Trial]:
    """The best trial of every effect, best first."""
    best: dict[Effect, Trial] = {}
    for trial in sorted(trials, key=criterion):
        best.setdefault(trial.candidate.effect, trial)
    return list(best.values())


def _on_few_recordings(base: Fit) -> Fit:
    """The base fit seen by a first look, its parameters as they are."""
    few = first_look(base.plan)
    return base if few is base.plan else fit(base.setup, few, base.variables.names, base.held, 1, origin=base)


def _with_special(base: Fit, trials: list[Trial], hidden: list[Trial], executor: Executor) -> list[Trial]:
    """Further steps of the special cases of the best one, from where it has led.

    One that asks for another value of a stated parameter is none.
    """
    best, known = trials[0], first_by_name((*trials, *hidden), lambda t: t.candidate.effect)
    if best.fit is None:
        return trials
    found = best.fit.setup.values()
    for case in best.candidate.effect.contains:
        changed = case.values(found)
        if case.name not in known or set(changed) & set(stated_only(base.held)):
            continue
        values, trial = found | changed, known[case.name]
        there = base.setup.with_values({name: values[name] for name in base.setup.values()})
        begun = replace(trial.candidate, values={n: values[n] for n in trial.candidate.effect.parameters}, others=())
        rest = [t for t in trials if t is not trial]
        moved = replace(base, alternatives=(there,))
        trials = _again(from_several_starts, moved, rest, [Trial(begun, trial.fit)], executor)
    return trials


def _as_scored(base: Fit, candidates: Sequence[Candidate], executor: Executor) -> list[Trial]:
    """The first round, and the other starts of those that save most there."""
    trials = _first_round(base, candidates, executor)
    least = base.cost - _SAVES * (base.cost - trials[0].cost)
    # What ends above the base model, which it contains, had a bad start: nothing is known of it yet.
    rivals = [t for t in trials if not least < t.cost <= base.cost and _may_tie(t, trials[0], base)]
    return _again(from_several_starts, base, trials, rivals[:_ENTER_SECOND], executor)


def _first_round(base: Fit, candidates: Sequence[Candidate], executor: Executor) -> list[Trial]:
    """A few steps of each, a few candidates at a time, until one explains nearly everything; best first."""
    tried = [c for c in candidates if c.score >= _WITHIN * candidates[0].score]
    trials: list[Trial] = []
    for first in range(0, len(tried), _CHUNK):
        some = tried[first : first + _CHUNK]
        if trials:
            best = min(trials, key=_COST)
            some = [c for c in some if _may_tie(Trial(c, None), best, base)]
        trials += [Trial(c, f) for c, f in zip(some, _fits(first_steps, base, some, executor), strict=True)]
    return sorted(trials, key=_COST)


def _may_tie(trial: Trial, best: Trial, base: Fit) -> bool:
    """Whether a candidate can still end where the best one is."""
    return not _settled(best, base) or trial.candidate.score >= _RIVAL * best.candidate.score


def _settled(best: Trial, base: Fit, leaves: float = _SETTLED) -> bool:
    """Whether the best candidate explains nearly everything: it leaves less than a share of the excess."""
    return best.cost - base.residual.size < leaves * (base.cost - base.residual.size)


def _comes_near(trial: Trial, best: Trial, base: Fit) -> bool:
    """Whether a candidate before the last round can still end where the best one is."""
    may_move = trial.fit is not None and moving(trial.fit) and _may_tie(trial, best, base)
    neighbour = trial.candidate.effect.name in best.candidate.effect.neighbours
    return trial.cost <= (_NEAR if may_move or neighbour else _NEAR_AT_REST) * best.cost


def _as_sent(base: Fit, executor: Executor) -> Fit:
    """The base fit that refits get: threads of one that runs beside others would only get into each other's way."""
    return base if executor == SERIAL else replace(base, plan=replace(base.plan, workers=1))


def _fits(
    work: Callable[[Fit, Any], Fit | None], base: Fit, items: Sequence[Any], executor: Executor
) -> list[Fit | None]:
    """``work(base, item)`` of every item, on the very recordings of the base fit wherever it was done."""
    fits = executor.run(partial(work, _as_sent(base, executor)), items)
    return [f if f is None else replace(f, plan=replace(base.plan, substeps=f.plan.substeps)) for f in fits]
