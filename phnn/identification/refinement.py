"""Fits whose sub-steps keep the numerical error below the noise.

A state that switches a law at a sample more or less makes the sum of squares rough on a small scale: descent stops in
front of the first local minimum of a non-smooth cost, though the derivatives predict a large decrease beyond. Such fits
are resumed with a larger step (`resumed`).

A coherent error far below the noise can be significant over many samples and would then be named as physics. So
the error is measured by halving the step and by changing the reconstruction, and what base parameters and zero
absorb is projected out; the norm of the rest, over the whole plan, is in units of one standard deviation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from phnn.errors import PhnnError, SolverFailed
from phnn.identification.fit import Fit, fit
from phnn.identification.plan import Plan
from phnn.identification.problem import Problem, Variables, beyond_limit, without_nuisances
from phnn.identification.staged import fit_identified, stated_only
from phnn.recordings.recording import Recording
from phnn.setup import Setup
from phnn.trajectory import simulate

Array = NDArray[np.float64]

# Least predicted decrease of the cost: a share of the excess over the noise, and residual variances.
_SHARE, _LEAST = 0.1, 12.0
# Lengths of the large step, how often it is made, and the largest change of a coordinate.
_LENGTHS, _TIMES, _FARTHEST = (2.0, 1.0, 0.5), 5, 2.0
_FEW = 8
# Room that is left between the bounds of a step where there is none.
_NONE = 1e-12


def resumed(fitted: Fit) -> Fit:
    """The fit, or a better one from a larger step where the cost is not smooth on a small scale.

    The predicted decrease by a step ``s`` inside the bounds is ``|r|² − |r + J s|²``; at an optimum it is zero, or
    limited by the bounds.
    """
    for _ in range(_TIMES):
        step, promise = _step(fitted)
        excess, least = fitted.beyond_noise, _LEAST * max(1.0, fitted.chi2)
        if promise < max(_SHARE * excess, least):
            break
        tried = [f for length in _LENGTHS if (f := _from(fitted, length * step)) is not None]
        best = min(tried, key=lambda f: f.cost, default=fitted)
        if best.cost > fitted.cost - least:
            break
        fitted = best
    return fitted


def _step(fitted: Fit) -> tuple[Array, float]:
    """Return the step inside the bounds with the largest predicted decrease, and this decrease."""
    if not fitted.z.size:
        return fitted.z, 0.0
    q, triangle = np.linalg.qr(fitted.jacobian)
    lower, upper = fitted.variables.bounds(fitted.setup)
    # Rounding may have left an estimate a little beyond its bound.
    low = np.minimum(np.maximum(lower - fitted.z, -_FARTHEST), -_NONE)
    high = np.maximum(np.minimum(upper - fitted.z, _FARTHEST), _NONE)
    step = lsq_linear(triangle, -q.T @ fitted.residual, (low, high)).x
    return step, fitted.cost - float(np.sum((fitted.residual + fitted.jacobian @ step) ** 2))


def _from(fitted: Fit, step: Array) -> Fit | None:
    """Fitted anew from a step away."""
    z = fitted.z + step
    there = fitted.variables.setup(fitted.setup, z)
    origin = replace(fitted, z=z, setup=there)
    try:
        return fit(there, fitted.plan, fitted.variables.names, fitted.held, _FEW, origin=origin)
    except PhnnError:
        return None


MAX_SUBSTEPS = 64


@dataclass(frozen=True)
class NumericalError:
    """Attributes:
    error: (N,) weighted error over the identification samples, stacked over recordings.
    sigma: its norm after projection on what base and zero cannot absorb.
    shares: weighted norm by recording before the projection.
    """

    error: Array
    sigma: float
    shares: dict[str, float]


def substeps_for(setup: Setup, plan: Plan, bound: float, initial: Mapping[str, Array] | None = None) -> Plan:
    """The plan with sub-steps doubled, recording by recording, until the solver error is below the bound.

    The bound [standard deviations] is shared evenly among the recordings, 1.5 times over, because the projection that
    is not made here takes away more than half.
    """
    chosen = dict(plan.substeps)
    share = 1.5 * bound / np.sqrt(len(plan.recordings))

    def run(recording: Recording, steps: int) -> Array:
        return simulate(setup, recording, steps, initial=(initial or {}).get(recording.name)).y

    def enough(recording: Recording) -> int:
        steps = plan.steps_of(recording)
        coarse = run(recording, steps)
        while steps < MAX_SUBSTEPS:
            fine = run(recording, 2 * steps)
            mask = recording.mask("identification")
            hidden = beyond_limit(recording, fine, mask, setup.own)
            change = without_nuisances(coarse - fine, mask, recording, setup.own, hidden)
            if 4.0 / 3.0 * np.linalg.norm(change) / recording.noise <= share:
                break
            steps, coarse = 2 * steps, fine
        return steps

    for recording, steps in zip(plan.recordings, plan.each(enough, simulations=3.0), strict=True):
        chosen[recording.name] = steps
    return replace(plan, substeps=chosen)


def numerical_error(fit: Fit) -> NumericalError:
    """Error of solver and reconstruction at a fit."""
    plan = fit.plan

    def one(recording: Recording) -> Array:
        steps, initial = plan.steps_of(recording), fit.initial(recording.name)
        base = simulate(fit.setup, recording, steps, initial=initial).y
        solver = (simulate(fit.setup, recording, 2 * steps, initial=initial).y - base) * 4.0 / 3.0
        reconstruction = np.zeros_like(solver)
        if recording.interpolation == "cubic":
            reconstruction = simulate(fit.setup, recording, steps, method="quintic", initial=initial).y - base
        mask = recording.mask("identification")
        hidden = beyond_limit(recording, base, mask, fit.setup.own)
        return without_nuisances(solver + reconstruction, mask, recording, fit.setup.own, hidden) / recording.noise

    parts = plan.each(one, simulations=4.0)
    error = np.concatenate(parts)
    rest = error
    if fit.jacobian.shape[1]:
        q, _ = np.linalg.qr(fit.jacobian)
        rest = error - q @ (q.T @ error)
    names = [r.name for r in plan.recordings]
    shares = {n: float(np.linalg.norm(p)) for n, p in zip(names, parts, strict=True)}
    return NumericalError(error, float(np.linalg.norm(rest)), shares)


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
