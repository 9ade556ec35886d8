"""The work on one candidate that is refitted: steps from a start, from several, and on to convergence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from phnn.criteria import REFITS, Refits
from phnn.diagnose.linearised import LinearisedFit
from phnn.diagnosis.name import Candidate
from phnn.diagnosis.starts import clamped, large_starts
from phnn.diagnosis.strengths import started
from phnn.diagnosis.trial import Trial
from phnn.effects import Effect
from phnn.errors import SolverFailed
from phnn.identification.fit import TOLERANCE, Fit, distinct_optima, fit, variables_from
from phnn.identification.problem import Problem
from phnn.identification.refinement import released
from phnn.identification.staged import fit_identified, stated_only
from phnn.rescue import attempt
from phnn.setup import Setup

Array = NDArray[np.float64]

# Shares of a strength from which a refit that has failed is begun again.
_WEAKER = (0.1, 0.01)
# Shares of the step that makes room for an effect.
_SHARES = (1.0, 0.3)


def first_steps(base: Fit, candidate: Candidate, limits: Refits = REFITS) -> Fit | None:
    """A few steps from the start that the score proposes."""
    start = base.setup, candidate.values
    return _few_steps(base, candidate.effect, *start, limits.first_evaluations, limits)


def _few_steps(
    base: Fit, effect: Effect, setup: Setup, values: Mapping[str, float], evaluations: int, limits: Refits
) -> Fit | None:
    """Steps with coarse sub-steps; None where the start cannot be simulated."""
    return attempt("start", partial(_steps_from, base, effect, setup, values, evaluations, limits), None)


def _steps_from(
    base: Fit, effect: Effect, setup: Setup, values: Mapping[str, float], evaluations: int, limits: Refits
) -> Fit:
    begun = clamped(effect, setup, values)
    own = [n for n in effect.parameters if not begun.parameters[n].fixed]
    names = [*base.variables.names, *own]
    origin = None
    if setup is base.setup:
        begun, origin = _adjusted(base, begun, limits.longest_step)
    plan = base.plan.coarse()
    if effect.strengths:
        begun = started(begun, plan, names, effect.strengths, origin, limits.longest_step)
    return fit(begun, plan, names, base.held, evaluations, origin=origin)


def _adjusted(base: Fit, begun: Setup, longest: float) -> tuple[Setup, Fit]:
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
        tried = base.z + share * np.clip(step, -longest, longest)
        try:
            cost = float(np.sum(residual(tried) ** 2))
        except SolverFailed:
            continue
        if cost < float(first @ first):
            z = tried
            break
    return base.variables.setup(begun, z), moved(z)


def from_several_starts(base: Fit, trial: Trial, limits: Refits = REFITS) -> Fit | None:
    """Further steps from there and from other starts: shapes of the effect, weaker ones, other optima of the base."""
    candidate, effect = trial.candidate, trial.candidate.effect
    starts = [(base.setup, v) for v in (*candidate.others[: limits.other_starts], *_weaker(base, trial))]
    starts += [(setup, candidate.values) for setup in base.alternatives]
    tried = [_few_steps(base, effect, setup, values, limits.second_evaluations, limits) for setup, values in starts]
    ends = [f for f in (*tried, further_steps(base, trial, limits)) if f is not None]
    if not ends:
        return None
    best, alternatives = distinct_optima(ends)
    return replace(best, alternatives=alternatives)


def _weaker(base: Fit, trial: Trial) -> list[dict[str, float]]:
    """Weaker starts where the first one has failed: a model that contains the base model never fits worse.

    What scores extrapolate to may lie beyond a threshold that only a small strength leaves untouched.
    """
    if trial.fit is not None and trial.fit.cost <= base.cost:
        return []
    effect, values = trial.candidate.effect, trial.candidate.values
    return [v for v in (effect.scaled(values, share) for share in _WEAKER) if v != values]


def from_large_starts(linearised: LinearisedFit, base: Fit, trial: Trial, limits: Refits = REFITS) -> Fit | None:
    """The best after a few steps from starts at finite strengths."""
    effect = trial.candidate.effect
    starts, length = large_starts(linearised, effect, limits), limits.first_evaluations
    tried = [_few_steps(base, effect, base.setup, values, length, limits) for values in starts]
    return min((f for f in tried if f is not None), key=lambda f: f.cost, default=None)


def on_all_recordings(base: Fit, trial: Trial, limits: Refits = REFITS) -> Fit | None:
    """Further steps on all recordings from where few of them have led."""
    if trial.fit is None:
        return None
    begun, length = trial.fit, limits.second_evaluations
    plan, names = base.plan.coarse(), begun.variables.names
    return attempt(
        "refit on all recordings", lambda: fit(begun.setup, plan, names, base.held, length, origin=base), None
    )


def moving(fitted: Fit, limits: Refits = REFITS) -> bool:
    """Whether a few steps have ended before they converged."""
    return fitted.evaluations in (limits.first_evaluations, limits.second_evaluations)


def further_steps(base: Fit, trial: Trial, limits: Refits = REFITS) -> Fit | None:
    """Further steps from where it is, unless it has converged."""
    found = trial.fit
    if found is None or not moving(found, limits):
        return found
    names, length = found.variables.names, limits.second_evaluations
    onwards = attempt(
        "further steps", lambda: fit(found.setup, found.plan, names, base.held, length, origin=found), found
    )
    return replace(onwards, alternatives=found.alternatives)


def finished(base: Fit, trial: Trial, limits: Refits = REFITS) -> Fit | None:
    """Carried to convergence with the sub-steps of the base fit; None where it cannot be simulated there."""
    if trial.fit is None:
        return None
    return attempt("refit to the end", partial(_converged, base, trial.candidate.effect, trial.fit, limits), None)


def _converged(base: Fit, effect: Effect, begun: Fit, limits: Refits) -> Fit:
    own, held = effect.parameters, stated_only(base.held)
    loose, length = limits.loose_tolerance, limits.last_evaluations
    full = fit_identified(begun.setup, base.plan, held, length, begun, own, tolerance_of(begun, loose))
    if tolerance_of(full, loose) < 0.5 * tolerance_of(begun, loose):
        full = fit_identified(full.setup, base.plan, held, length, full, own, tolerance_of(full, loose))
    return replace(released(full, own), alternatives=begun.alternatives)


def tolerance_of(found: Fit, loose: float) -> float:
    """The tolerance at which a refit stops: what leaves much is told apart from others by large differences only."""
    return max(TOLERANCE, loose * (1.0 - 1.0 / max(found.chi2, 1.0)))
