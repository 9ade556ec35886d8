"""Refit candidate effects in full, from several starts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.diagnose.ground import Ground, prepare
from phnn.diagnose.name import Candidate, first_by_name
from phnn.diagnose.starts import bold_starts, clamped, has_bold_starts
from phnn.diagnose.trial import Trial, criterion
from phnn.effects import Effect
from phnn.ensemble import SERIAL, Executor
from phnn.errors import PhnnError, SolverFailed
from phnn.identify.base import released
from phnn.identify.fit import TOLERANCE, Fit, distinct_optima, fit, variables_from
from phnn.identify.problem import Problem
from phnn.identify.staged import fit_identified, stated_only
from phnn.setup import Setup

Array = NDArray[np.float64]

# Evaluations of the three rounds, and how many candidates go on from bold starts and enter the second and the third.
_FIRST, _SECOND, _THIRD = 5, 8, 40
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
# Relative change at which a refit that leaves much stops.
_LOOSE = 1e-5
_CHUNK = 3
_OTHER_STARTS = 2
# Shares of the step that makes room for an effect, and the largest such step of an estimation coordinate.
_SHARES, _FARTHEST = (1.0, 0.3), 2.0
_COST = attrgetter("cost")


def refit(
    base: Fit, candidates: Sequence[Candidate], executor: Executor = SERIAL, hidden: Sequence[Candidate] = ()
) -> list[Trial]:
    """Candidates refitted together with the base parameters, best first: a race in three rounds.

    All that score within reach of the best take a few steps from one start; those that save most go on from several
    starts; those that come near the best are carried to convergence. Where nothing explains much, all that have a
    strength, the hidden ones too, start again at finite strengths before. Special cases of the best one start from
    where it has led.

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
    trials = _again(_finished, base, trials, rivals[:_ENTER_THIRD], executor)
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
    """A few steps from starts at finite strengths of all whose score has led nowhere; further ones of the best."""
    tried = {t.candidate.effect for t in trials}
    astray = [t for t in trials if not _settled(t, base, _ASTRAY)]
    todo = [*astray, *(h for h in hidden if h.candidate.effect not in tried)]
    # Wherever the steps are made, they need no trajectories.
    ground = replace(prepare(_as_sent(base, executor)), trajectories=())
    begun = partial(_from_bold_starts, ground)
    trials = _again(begun, base, trials, [t for t in todo if has_bold_starts(t.candidate.effect)], executor)
    return _again(_further, base, trials, trials[:_ENTER_BOLD], executor)


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
        trials = _again(_from_several_starts, moved, rest, [Trial(begun, trial.fit)], executor)
    return trials


def _as_scored(base: Fit, candidates: Sequence[Candidate], executor: Executor) -> list[Trial]:
    """The first round, and the other starts of those that save most there."""
    trials = _first_round(base, candidates, executor)
    least = base.cost - _SAVES * (base.cost - trials[0].cost)
    # What ends above the base model, which it contains, had a bad start: nothing is known of it yet.
    rivals = [t for t in trials if not least < t.cost <= base.cost and _may_tie(t, trials[0], base)]
    return _again(_from_several_starts, base, trials, rivals[:_ENTER_SECOND], executor)


def _first_round(base: Fit, candidates: Sequence[Candidate], executor: Executor) -> list[Trial]:
    """A few steps of each, a few candidates at a time, until one explains nearly everything; best first."""
    tried = [c for c in candidates if c.score >= _WITHIN * candidates[0].score]
    trials: list[Trial] = []
    for first in range(0, len(tried), _CHUNK):
        some = tried[first : first + _CHUNK]
        if trials:
            best = min(trials, key=_COST)
            some = [c for c in some if _may_tie(Trial(c, None), best, base)]
        trials += [Trial(c, f) for c, f in zip(some, _fits(_first_steps, base, some, executor), strict=True)]
    return sorted(trials, key=_COST)


def _may_tie(trial: Trial, best: Trial, base: Fit) -> bool:
    """Whether a candidate can still end where the best one is."""
    return not _settled(best, base) or trial.candidate.score >= _RIVAL * best.candidate.score


def _settled(best: Trial, base: Fit, leaves: float = _SETTLED) -> bool:
    """Whether the best candidate explains nearly everything: it leaves less than a share of the excess."""
    return best.cost - base.residual.size < leaves * (base.cost - base.residual.size)


def _comes_near(trial: Trial, best: Trial, base: Fit) -> bool:
    """Whether a candidate before the last round can still end where the best one is."""
    moving = trial.fit is not None and _moving(trial.fit) and _may_tie(trial, best, base)
    neighbour = trial.candidate.effect.name in best.candidate.effect.neighbours
    return trial.cost <= (_NEAR if moving or neighbour else _NEAR_AT_REST) * best.cost


def _moving(fitted: Fit) -> bool:
    """Whether a few steps have ended before they came to rest."""
    return fitted.evaluations in (_FIRST, _SECOND)


def _as_sent(base: Fit, executor: Executor) -> Fit:
    """The base fit that refits get: threads of one that runs beside others would only get into each other's way."""
    return base if executor == SERIAL else replace(base, plan=replace(base.plan, workers=1))


def _fits(
    work: Callable[[Fit, Any], Fit | None], base: Fit, items: Sequence[Any], executor: Executor
) -> list[Fit | None]:
    """``work(base, item)`` of every item, on the very recordings of the base fit wherever it was done."""
    fits = executor.run(partial(work, _as_sent(base, executor)), items)
    return [f if f is None else replace(f, plan=replace(base.plan, substeps=f.plan.substeps)) for f in fits]


def _first_steps(base: Fit, candidate: Candidate) -> Fit | None:
    """A few steps from the start that the score proposes."""
    return _few_steps(base, candidate.effect, base.setup, candidate.values, _FIRST)


def _few_steps(base: Fit, effect: Effect, setup: Setup, values: Mapping[str, float], evaluations: int) -> Fit | None:
    """Steps with coarse sub-steps; None where the start cannot be simulated."""
    try:
        begun = clamped(effect, setup, values)
        own = [n for n in effect.parameters if not begun.parameters[n].fixed]
        names = [*base.variables.names, *own]
        origin = None
        if setup is base.setup:
            begun, origin = _adjusted(base, begun)
        return fit(begun, base.plan.coarse(), names, base.held, evaluations, origin=origin)
    except PhnnError:
        return None


def _adjusted(base: Fit, begun: Setup) -> tuple[Setup, Fit]:
    """A start whose base parameters and initial states make room for the effect, to first order; and where they are.

    Without that a strong effect beside parameters that took its part before is further off than no effect at all.
    """
    if not base.z.size:
        return begun, base
    plan = base.plan.coarse()

    def moved(z: Array) -> Fit:
        return replace(base, z=z, setup=base.variables.setup(base.setup, z))

    def residual(z: Array) -> Array:
        variables = variables_from(begun, plan, (), moved(z))
        return Problem(base.variables.setup(begun, z), plan, variables).residual(variables.start(begun))

    first = residual(base.z)
    step, *_ = np.linalg.lstsq(base.jacobian, -first, rcond=1e-10)
    z = base.z
    for share in _SHARES:
        tried = base.z + share * np.clip(step, -_FARTHEST, _FARTHEST)
        try:
            cost = float(np.sum(residual(tried) ** 2))
        except SolverFailed:
            continue
        if cost < float(first @ first):
            z = tried
            break
    return base.variables.setup(begun, z), moved(z)


def _from_several_starts(base: Fit, trial: Trial) -> Fit | None:
    """Further steps from there and from other starts: shapes of the effect, and other optima of the base."""
    candidate, effect = trial.candidate, trial.candidate.effect
    starts = [(base.setup, v) for v in candidate.others[:_OTHER_STARTS]]
    starts += [(setup, candidate.values) for setup in base.alternatives]
    tried = [_few_steps(base, effect, setup, values, _SECOND) for setup, values in starts]
    ends = [f for f in (*tried, _further(base, trial)) if f is not None]
    if not ends:
        return None
    best, alternatives = distinct_optima(ends)
    return replace(best, alternatives=alternatives)


def _from_bold_starts(ground: Ground, base: Fit, trial: Trial) -> Fit | None:
    """The best so far, or a better one after a few steps from starts at finite strengths."""
    effect, so_far = trial.candidate.effect, trial.fit
    tried = [_few_steps(base, effect, base.setup, values, _FIRST) for values in bold_starts(ground, effect)]
    better = min((f for f in tried if f is not None), key=lambda f: f.cost, default=so_far)
    if so_far is None or better is None:
        return better
    return replace(better, alternatives=so_far.alternatives) if better.cost < so_far.cost else so_far


def _further(base: Fit, trial: Trial) -> Fit | None:
    """Further steps from where it is, unless it has come to rest."""
    found = trial.fit
    if found is None or not _moving(found):
        return found
    try:
        onwards = fit(found.setup, found.plan, found.variables.names, base.held, _SECOND, origin=found)
    except PhnnError:
        return found
    return replace(onwards, alternatives=found.alternatives)


def _finished(base: Fit, trial: Trial) -> Fit | None:
    """Carried to convergence with the sub-steps of the base fit; None where it cannot be simulated there."""
    if trial.fit is None:
        return None
    own, held, begun = trial.candidate.effect.parameters, stated_only(base.held), trial.fit
    try:
        full = fit_identified(begun.setup, base.plan, held, _THIRD, begun, own, _tolerance(begun))
        if _tolerance(full) < 0.5 * _tolerance(begun):
            full = fit_identified(full.setup, base.plan, held, _THIRD, full, own, _tolerance(full))
        full = released(full, own)
    except PhnnError:
        return None
    return replace(full, alternatives=begun.alternatives)


def _tolerance(found: Fit) -> float:
    """Where a refit stops: what leaves much is told apart from others by large differences only."""
    return max(TOLERANCE, _LOOSE * (1.0 - 1.0 / max(found.chi2, 1.0)))
