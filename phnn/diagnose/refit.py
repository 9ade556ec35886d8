"""Refits of a model with one more element: short, further, and to the end.

A short refit begins where the screen proposes, or at strengths far from there, with the base parameters moved to make
room for the element, and takes a few steps. What a search keeps goes further, and is at last carried to convergence.
Sub-steps are those of the plan that is given: coarse ones at first, at the end those of the search.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from phnn.diagnose.linearised import LinearisedFit, direction
from phnn.effects import Effect
from phnn.errors import PhnnError, SolverFailed
from phnn.identification.base import coarse_cost, released, resumed
from phnn.identification.fit import Fit, continued, fit, variables_from
from phnn.identification.plan import Plan
from phnn.identification.problem import Problem, variables_of
from phnn.identification.staged import fit_identified, stated_only
from phnn.rescue import attempt
from phnn.setup import Setup
from phnn.signals.least_squares import triangle

Array = NDArray[np.float64]

# Largest change of a base parameter before a refit begins: coordinates are logarithms, so 2 is a factor of seven.
_LONGEST = 2.0
# Shares of a strength that are tried, until one leaves less than the model without it.
_STRONG = (1.0, 0.3, 0.1, 0.03)
# Shares of the step that makes room for an element.
_SHARES = (1.0, 0.3)
# Strengths that the linear problem puts on a bound begin this share of the largest one away from it, by their typical
# sizes: from next to a bound the optimiser's first steps would all be short.
_FAINT = 0.02
# Multiples of the grid's strengths, which are small ones.
_STRENGTHS = tuple(10.0 ** (0.5 * k) for k in range(1, 10))
# Change of the output by a large strength, over the squares that are left: wanted, and most.
_WANTED, _MOST = 0.5, 3.0
_LARGE = 2
# Evaluations of a refit carried to its end; its tolerance near the noise, far from it, and there with all sub-steps.
_LAST, _NEAR, _FAR, _WHOLE = 25, 1e-5, 1e-4, 1e-3
# Mean square of the residual over that of the noise below which a fit is near it.
_CLOSE = 1.5
# Evaluations where a search has ended before a fit came to its end.
_BRIEF = 3


def short(base: Fit, plan: Plan, effect: Effect, starts: Sequence[Mapping[str, float]], evaluations: int) -> Fit | None:
    """Return the best fit on a plan after a few steps from some starts; None where none of them can be simulated."""
    tried = [attempt("start", partial(_steps_from, base, plan, effect, values, evaluations), None) for values in starts]
    return min((f for f in tried if f is not None), key=lambda f: f.cost, default=None)


def further(fitted: Fit, evaluations: int, plan: Plan) -> Fit:
    """Return the fit after further steps, with the sub-steps of a plan where these are finer than its own."""
    used = plan if (finer := plan.size > fitted.plan.size) else fitted.plan

    def onwards() -> Fit:
        return resumed(fit(fitted.setup, used, fitted.variables.names, fitted.held, evaluations, _NEAR, fitted))

    later_fit = attempt("further steps", onwards, fitted)
    return later_fit if finer or later_fit.cost < fitted.cost else fitted


def converged(fitted: Fit, plan: Plan, held: Mapping[str, str], keep: Sequence[str], brief: bool = False) -> Fit | None:
    """Return the fit carried to its end on a plan; None where it cannot be simulated there.

    Args:
        plan: recordings and sub-steps of the search.
        held: what the base model holds, and why.
        keep: parameters of the elements, which are estimated in any case.
        brief: a few steps instead, where there is no time left.
    """

    def steps(begun: Fit, used: Plan, far: float) -> Fit:
        tolerance, most = _NEAR if begun.chi2 < _CLOSE else far, _BRIEF if brief else _LAST
        later_fit = fit_identified(begun.setup, used, stated_only(held), most, begun, keep, tolerance)
        # What comes near the noise on the way goes on with the tolerance that holds there.
        return steps(later_fit, used, far) if later_fit.chi2 < _CLOSE <= begun.chi2 and not brief else later_fit

    def to_the_end() -> Fit:
        # Where the sum of squares is rough, larger steps are found with a quarter of the sub-steps.
        coarse = plan.coarse()
        if brief:
            return steps(fitted, plan, _FAR)
        if coarse.size == plan.size:
            return released(resumed(steps(fitted, plan, _FAR)), keep)
        return steps(released(resumed(steps(fitted, coarse, _FAR)), keep), plan, _WHOLE)

    return attempt("refit to the end", to_the_end, None)


class Wanted(NamedTuple):
    """Elements of a model that is to be fitted, and the values of all parameters to begin from."""

    elements: tuple[Effect, ...]
    starts: Sequence[Mapping[str, float]]


def rebuilt(base: Fit, plan: Plan, evaluations: int, wanted: Wanted) -> Fit | None:
    """Return the base model with some elements, fitted on a plan from the best of some values of all parameters; None
    where none can be simulated."""

    def begun(values: Mapping[str, float]) -> Setup:
        setup = base.setup.with_values({n: values[n] for n in base.setup.free if n in values})
        for element in wanted.elements:
            setup = element.add_to(setup, values)
        return setup

    def build() -> Fit:
        setups = [begun(values) for values in wanted.starts]
        setup = min(setups, key=lambda s: coarse_cost(s, plan)) if len(setups) > 1 else setups[0]
        keep = [n for e in wanted.elements for n in e.parameters]
        return fit_identified(setup, plan, stated_only(base.held), evaluations, base, keep, _FAR)

    return attempt("refit without an element", build, None)


def _steps_from(base: Fit, plan: Plan, effect: Effect, values: Mapping[str, float], evaluations: int) -> Fit:
    begun, origin = _begun(base, plan, effect, values)
    added = [n for n in effect.parameters if not begun.parameters[n].fixed]
    if effect.strengths:
        begun, touched = started(begun, plan, [*base.variables.names, *added], effect.strengths, origin)
        added = [n for n in added if n in touched]
    names = [*base.variables.names, *added]
    return fit(begun, plan, names, base.held, evaluations, origin=origin)


def _begun(base: Fit, plan: Plan, effect: Effect, values: Mapping[str, float]) -> tuple[Setup, Fit]:
    """The strongest start that leaves less than the base: what is weak enough does, if its direction is right."""
    best = None
    for share in _STRONG if len(effect.all_strengths) == 1 else _STRONG[:1]:
        begun = clamped(effect, base.setup, effect.scaled(values, share))
        start = attempt("start", partial(_adjusted, base, begun, plan), None)
        if start is not None and (best is None or start[0] < best[0]):
            best = start
        if best is not None and best[0] < base.cost:
            break
    if best is None:
        raise SolverFailed(f"{effect.name} cannot be simulated at the strengths from which a refit begins")
    return best[1:]


def _adjusted(base: Fit, begun: Setup, plan: Plan) -> tuple[float, Setup, Fit]:
    """Return a start whose base parameters and initial states make room for the effect, to first order; where they are,
    and what is left there first.

    Without that a strong effect beside parameters that took its part before is further off than no effect at all.
    """

    def moved(z: Array) -> Fit:
        return replace(base, z=z, setup=base.variables.setup(base.setup, z))

    expected = variables_of(begun, plan, ())

    def residual(z: Array) -> Array:
        variables = continued(expected, begun, plan, moved(z))
        return Problem(base.variables.setup(begun, z), plan, variables).residual(variables.start(begun))

    best, z = residual(base.z), base.z
    square = triangle(np.column_stack([base.jacobian, -best]))
    step, *_ = np.linalg.lstsq(square[:, :-1], square[:, -1], rcond=1e-10)
    for share in _SHARES if z.size else ():
        there = z + share * np.clip(step, -_LONGEST, _LONGEST)
        try:
            after = residual(there)
        except SolverFailed:
            continue
        if after @ after < best @ best:
            best, z = after, there
            break
    return float(best @ best), base.variables.setup(begun, z), moved(z)


def started(
    setup: Setup, plan: Plan, names: Sequence[str], strengths: Sequence[str], origin: Fit | None
) -> tuple[Setup, list[str]]:
    """Return the setup with strengths and base parameters moved to the minimum of the linearised least-squares problem,
    and the names on which an output depends.

    From small strengths the bounded optimiser takes dozens of steps to where this single one leads: each ends where the
    first of the strengths meets its bound. The setup stays as it was where no share of the step lowers χ².

    No output depends on a spring beyond the motion that was recorded. An optimiser may carry it anywhere within its
    bounds, and the model would push with any force where nothing was recorded.
    """
    problem = Problem(setup, plan, variables_from(setup, plan, names, origin))
    start = problem.variables.start(setup)
    jacobian, residual = problem.jacobian(start), problem.residual(start)
    touched = np.any(jacobian != 0.0, axis=0)
    least, most = problem.variables.bounds(setup)
    is_strength = touched & np.array([n in strengths for n in names] + [False] * (start.size - len(names)))
    reach = np.where(is_strength, np.inf, _LONGEST)
    lower, upper = np.maximum(least - start, -reach), np.minimum(most - start, reach)
    used = touched & (lower < upper)
    # The same problem in a small square.
    square = triangle(np.column_stack([jacobian[:, used], residual]))
    step = np.zeros(start.size)
    step[used] = lsq_linear(square[:, :-1], -square[:, -1], (lower[used], upper[used]), method="bvls").x
    cost = float(residual @ residual)
    for share in _SHARES:
        z = start + share * step
        room = np.minimum(_FAINT * float(np.abs(z[is_strength]).max(initial=0.0)), 0.5 * (most - least))
        z[is_strength] = np.clip(z, least + room, most - room)[is_strength]
        # Initial states stay with the origin of the fit.
        z[len(names) :] = start[len(names) :]
        try:
            after = problem.residual(z)
        except SolverFailed:
            continue
        if float(after @ after) < cost:
            setup = problem.variables.setup(setup, z)
            break
    return setup, [n for n, moves in zip(names, touched, strict=False) if moves]


def clamped(effect: Effect, setup: Setup, values: Mapping[str, float]) -> Setup:
    """Return the effect at starting values moved inside the bounds of its parameters."""
    defaults = dict(values)
    if not effect.one_sided:
        # Zero lies within the bounds of every strength that has two signs.
        defaults |= dict.fromkeys(effect.all_strengths, 0.0)
    probe = effect.add_to(setup, defaults)
    inside = {}
    for name in effect.parameters:
        p = probe.parameters[name]
        inside[name] = p.value if p.fixed else min(max(values[name], p.lower), p.upper)
    return effect.add_to(setup, inside)


def large_starts(model: LinearisedFit, effect: Effect) -> list[dict[str, float]]:
    """Return values of an effect's parameters at strengths that change the output about as much as the residual.

    A base model that has taken over much of a strong effect is so far off that a first derivative at strength zero
    knows neither its strength nor its shape, and may even have the wrong sign.
    """
    signs = (1.0,) if effect.one_sided else (1.0, -1.0)
    tried = [_strong(model, effect, p, sign) for p in effect.grid(model.scales) for sign in signs]
    ranked = sorted((t for t in tried if t is not None), key=lambda t: t[0])
    return [values for _, values in ranked[:_LARGE]]


def _strong(
    model: LinearisedFit, effect: Effect, point: Mapping[str, float], sign: float
) -> tuple[float, dict[str, float]] | None:
    """Return what is left with the strength of one shape that suits the residual, its square, and the values.

    None where the effect changes nothing that is not explained.

    Two neighbouring strengths are searched, whose changes are smaller and larger than wanted. A change that is far too
    small tells how many strengths to leave out, as it grows in proportion; a wrong guess is halved.
    """
    size = float(np.sum(model.residual**2))
    stronger = _stronger(effect, point, sign)
    best: tuple[float, dict[str, float]] | None = None
    below, above, at, before, nearest = -1, len(stronger), 0, 0.0, np.inf
    while below < at < above:
        try:
            change: Array | None = model.project(direction(model, effect, stronger[at]))
        except PhnnError:
            change = None
        share = np.inf if change is None else float(np.sum(change**2)) / size
        if change is not None and 0.0 < share <= _MOST:
            off = abs(np.log(share / _WANTED))
            if off < nearest:
                nearest, best = off, (float(np.sum((model.residual - change) ** 2)), stronger[at])
        # What changes less than a weaker effect does cannot be simulated, or is saturated.
        if before <= share < _WANTED:
            # Shares are squares: half a decade of strength is a decade of them.
            ahead = max(1, int(np.log10(_WANTED) - np.log10(share))) if share > 0.0 else 1
            below, at, before = at, min(at + ahead, above - 1), share
        else:
            above, at = at, (below + at) // 2
    return best


def _stronger(effect: Effect, point: Mapping[str, float], sign: float) -> list[dict[str, float]]:
    """Return the values of the effect at a point of its grid, ever stronger, as far as they can be."""
    points = [dict(point)]
    for strength in _STRENGTHS:
        values = effect.scaled(point, sign * strength)
        if values == points[-1]:
            break
        points.append(values)
    return points[1:]
