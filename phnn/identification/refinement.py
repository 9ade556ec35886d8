"""Fits whose sub-steps keep the numerical error below the noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from phnn.errors import SolverFailed
from phnn.identification.fit import Fit
from phnn.identification.numerics import NumericalError, numerical_error, substeps_for
from phnn.identification.plan import Plan
from phnn.identification.problem import Problem
from phnn.identification.staged import fit_identified, stated_only
from phnn.identification.stalled import resumed
from phnn.identification.variables import Variables
from phnn.setup import Setup


def with_bounded_error(first: Fit, bound: float, keep: Sequence[str] = ()) -> tuple[Fit, NumericalError]:
    """Refit with sub-steps for a bound, again where the fit has moved enough to need finer ones.

    Args:
        bound: on the numerical error over all recordings, in standard deviations of the noise.
        keep: parameters that are estimated in any case.
    """
    fitted = first
    for _ in range(3):
        plan = substeps_for(fitted.setup, fitted.plan, bound, fitted.initial_states)
        fitted = fit_identified(fitted.setup, plan, stated_only(fitted.held), origin=fitted, keep=keep)
        fitted = resumed(fitted)
        error = numerical_error(fitted)
        if error.sigma <= bound:
            break
    free = released(fitted, keep)
    if free is not fitted:
        fitted, error = free, numerical_error(free)
    return replace(fitted, alternatives=first.alternatives), error


def released(fitted: Fit, keep: Sequence[str] = ()) -> Fit:
    """A fit whose held parameters do not stand on a plateau far from where the recordings would notice them.

    A parameter that has run off to where nothing depends on it any more has no sensitivity there and is held. What it
    cost to run off shows only at a distance: the sum of squares is scanned over many decades of it, and where a better
    value lies the fit goes on from there with the parameter free.

    Args:
        keep: parameters that are estimated in any case.
    """
    held = stated_only(fitted.held)
    if fitted.variables.unknown:
        # Initial states would have to follow every value that is scanned.
        return fitted
    for name in [n for n in fitted.held if n not in held and fitted.setup.parameters[n].positive]:
        p = fitted.setup.parameters[name]
        values = [v for v in p.value * 10.0 ** np.arange(-9.0, 10.0) if p.lower < v < p.upper]
        setups = [fitted.setup.with_values({name: v}) for v in values]
        costs = [_coarse_cost(s, fitted.plan) for s in setups]
        best = int(np.argmin(costs))
        if costs[best] < _coarse_cost(fitted.setup, fitted.plan) - 1.0:
            moved = fit_identified(setups[best], fitted.plan, held, origin=fitted, keep=keep)
            fitted = moved if moved.cost < fitted.cost else fitted
    return fitted


def _coarse_cost(setup: Setup, plan: Plan) -> float:
    """Sum of squares of a setup on a plan with coarse sub-steps; infinite where it cannot be simulated."""
    problem = Problem(setup, plan.coarse(), Variables((), (), np.zeros(0), {}))
    try:
        residual = problem.residual(np.zeros(0))
    except SolverFailed:
        return float("inf")
    return float(residual @ residual)


def refined(fitted: Fit) -> tuple[Fit, NumericalError]:
    """The same fit with all sub-steps doubled."""
    doubled = {r.name: 2 * fitted.plan.steps_of(r) for r in fitted.plan.recordings}
    plan = replace(fitted.plan, substeps=doubled)
    held = stated_only(fitted.held)
    again = fit_identified(fitted.setup, plan, held, origin=fitted)
    return replace(again, alternatives=fitted.alternatives), numerical_error(again)
