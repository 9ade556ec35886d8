"""The work on one candidate that is refitted: steps from a start, from several, and on to convergence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from phnn.diagnose.ground import Ground
from phnn.diagnose.name import Candidate
from phnn.diagnose.starts import bold_starts, clamped
from phnn.diagnose.trial import Trial
from phnn.effects import Effect
from phnn.errors import PhnnError, SolverFailed
from phnn.identify.base import released
from phnn.identify.fit import TOLERANCE, Fit, distinct_optima, fit, variables_from
from phnn.identify.problem import Problem
from phnn.identify.staged import fit_identified, stated_only
from phnn.setup import Setup

Array = NDArray[np.float64]

# Evaluations of the three rounds.
_FIRST, _SECOND, _THIRD = 5, 8, 40
# Relative change at which a refit that leaves much stops.
_LOOSE = 1e-5
_OTHER_STARTS = 2
# Shares of the step that makes room for an effect, and the largest such step of an estimation coordinate.
_SHARES, _FARTHEST = (1.0, 0.3), 2.0


def first_steps(base: Fit, candidate: Candidate) -> Fit | None:
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


def from_several_starts(base: Fit, trial: Trial) -> Fit | None:
    """Further steps from there and from other starts: shapes of the effect, and other optima of the base."""
    candidate, effect = trial.candidate, trial.candidate.effect
    starts = [(base.setup, v) for v in candidate.others[:_OTHER_STARTS]]
    starts += [(setup, candidate.values) for setup in base.alternatives]
    tried = [_few_steps(base, effect, setup, values, _SECOND) for setup, values in starts]
    ends = [f for f in (*tried, further_steps(base, trial)) if f is not None]
    if not ends:
        return None
    best, alternatives = distinct_optima(ends)
    return replace(best, alternatives=alternatives)


def from_bold_starts(ground: Ground, base: Fit, trial: Trial) -> Fit | None:
    """The best after a few steps from starts at finite strengths."""
    effect = trial.candidate.effect
    tried = [_few_steps(base, effect, base.setup, values, _FIRST) for values in bold_starts(ground, effect)]
    return min((f for f in tried if f is not None), key=lambda f: f.cost, default=None)


def on_all_recordings(base: Fit, trial: Trial) -> Fit | None:
    """Further steps on all recordings from where few of them have led."""
    if trial.fit is None:
        return None
    try:
        return fit(trial.fit.setup, base.plan.coarse(), trial.fit.variables.names, base.held, _SECOND, origin=base)
    except PhnnError:
        return None


def moving(fitted: Fit) -> bool:
    """Whether a few steps have ended before they came to rest."""
    return fitted.evaluations in (_FIRST, _SECOND)


def further_steps(base: Fit, trial: Trial) -> Fit | None:
    """Further steps from where it is, unless it has come to rest."""
    found = trial.fit
    if found is None or not moving(found):
        return found
    try:
        onwards = fit(found.setup, found.plan, found.variables.names, base.held, _SECOND, origin=found)
    except PhnnError:
        return found
    return replace(onwards, alternatives=found.alternatives)


def finished(base: Fit, trial: Trial) -> Fit | None:
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
