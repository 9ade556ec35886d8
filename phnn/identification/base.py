"""The base model of a campaign, fitted with sub-steps that keep the numerical error below the noise.

A state that switches a law at a sample more or less makes the sum of squares rough on a small scale: descent stops at a
local minimum, though the derivatives predict a large decrease beyond. Such fits are resumed with a larger step.

A coherent error far below the noise can be significant over many samples and would then be named as physics. So the
error is measured by halving the step and by changing the reconstruction, and what base parameters and zero absorb is
projected out; the norm of the rest, over the whole plan, is in units of one standard deviation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from phnn.errors import InputRefused, PhnnError, SolverFailed
from phnn.identification import prepare
from phnn.identification.fit import Fit, fit
from phnn.identification.plan import Options, Plan
from phnn.identification.problem import Problem, Variables, beyond_limit, starts_unknown, without_nuisances
from phnn.identification.staged import (
    FURTHER_STARTS,
    fit_identified,
    held_at,
    held_by_statement,
    identify_actuator,
    stated_only,
)
from phnn.identification.starting_points import mechanical_points, scaled_points
from phnn.models.actuator import bouc_wen
from phnn.network.roles import drive_ratio, motions
from phnn.recordings.recording import Anchor, Campaign, Recording
from phnn.rescue import late, used_up
from phnn.setup import Setup
from phnn.signals.least_squares import triangle
from phnn.trajectory import simulate

Array = NDArray[np.float64]

# Least predicted decrease of the cost: a share of the excess over the noise, and residual variances.
_SHARE, _LEAST = 0.1, 12.0
# Lengths of the large step, how often it is made, and the largest change of a coordinate.
_LENGTHS, _TIMES, _FARTHEST = (2.0, 1.0, 0.5), 5, 2.0
# Directions that are looked along where nothing is promised, and how far, in standard deviations of each.
_WEAKEST, _DEVIATIONS = 3, (-20.0, -10.0, -5.0, 5.0, 10.0, 20.0)
# Share of a predicted decrease that has to come before another one is believed.
_KEPT = 0.5
_FEW = 8
# Room that is left between the bounds of a step where there is none.
_NONE = 1e-12


def resumed(fitted: Fit) -> Fit:
    """Return the fit, or a better one from a larger step where the cost is not smooth on a small scale.

    The predicted decrease by a step ``s`` inside the bounds is ``|r|² − |r + J s|²``; at an optimum it is zero, or
    limited by the bounds. Near the noise derivatives may hide what is beyond: there steps along the directions that the
    recordings know least show whether less is left beyond it.
    """
    for _ in range(_TIMES):
        step, promise = predicted_step(fitted)
        excess, least = fitted.beyond_noise, _LEAST * max(1.0, fitted.chi2)
        promised = promise >= max(_SHARE * excess, least)
        if used_up() or not (promised or least < excess < fitted.residual.size):
            break
        steps = [length * step for length in _LENGTHS] if promised else _beyond_rough(fitted)
        tried = [f for s in steps if (f := _from(fitted, s)) is not None]
        before, best = fitted.cost, min(tried, key=lambda f: f.cost, default=fitted)
        if best.cost < before - least:
            fitted = best
        if best.cost > before - (max(least, _KEPT * promise) if promised else least):
            break
    return fitted


def _beyond_rough(fitted: Fit) -> list[Array]:
    """Return the step that leaves least, of some standard deviations along the directions that the recordings know
    least; none where each of them leaves more."""
    if not fitted.z.size:
        return []
    _, size, directions = np.linalg.svd(triangle(fitted.jacobian))
    size = np.maximum(size, np.finfo(float).eps * size[0])
    ahead = np.outer(_DEVIATIONS, 1.0 / size[-_WEAKEST:])[..., None] * directions[-_WEAKEST:]
    lower, upper = fitted.variables.bounds(fitted.setup)
    steps = np.clip(fitted.z + ahead.reshape(-1, fitted.z.size), lower, upper) - fitted.z
    problem = Problem(fitted.setup, fitted.plan, fitted.variables)
    lengths = [problem.size(fitted.z + step)[-1] for step in steps]
    best = int(np.argmin(lengths))
    return [steps[best]] if lengths[best] ** 2 < fitted.cost else []


def predicted_step(fitted: Fit) -> tuple[Array, float]:
    """Return the step inside the bounds with the largest predicted decrease, and this decrease."""
    # Derivatives of which the rounding of a variable alone is more than the noise predict nothing.
    if not fitted.z.size or np.finfo(float).eps * np.linalg.norm(fitted.jacobian, axis=0).max() > 1.0:
        return np.zeros(fitted.z.size), 0.0
    square = triangle(np.column_stack([fitted.jacobian, fitted.residual]))
    slopes, along = square[:-1, :-1], square[:-1, -1]
    lower, upper = fitted.variables.bounds(fitted.setup)
    # Rounding may have left an estimate a little beyond its bound.
    low = np.minimum(np.maximum(lower - fitted.z, -_FARTHEST), -_NONE)
    high = np.maximum(np.minimum(upper - fitted.z, _FARTHEST), _NONE)
    step = lsq_linear(slopes, -along, (low, high)).x
    return step, float(along @ along - np.sum((along + slopes @ step) ** 2))


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
# Largest numerical error of a model over the norm of what it leaves beyond the noise: the steps of a model that is far
# from the recordings need not be finer.
NUMERICAL = 0.001
# Share of the same norm that the numerical error may have before parameters absorb some of it; near the noise, where
# these have to be right as well, multiples of the bound on the rest.
_ABSORBED, _WHOLE = 0.02, 1.5


@dataclass(frozen=True)
class NumericalError:
    """Attributes:
    error: (N,) weighted error over the identification samples, stacked over recordings.
    sigma: its norm after projection on what base and zero cannot absorb.
    """

    error: Array
    sigma: float


def substeps_for(fitted: Fit, plan: Plan, bound: float, error: NumericalError | None = None) -> Plan:
    """Return the plan with sub-steps doubled, recording by recording, until a model's solver error is below the bound.

    The bound [standard deviations] on what parameters do not absorb is shared evenly among the recordings.

    Args:
        error: of the model on the plan, which tells how much of it parameters absorb.
    """
    whole = max(_WHOLE * bound, _ABSORBED * fitted.beyond_noise**0.5)
    if error is not None and error.sigma > bound:
        whole = min(whole, float(np.linalg.norm(error.error)) * bound / error.sigma)
    setup, share = fitted.setup, whole / np.sqrt(len(plan.recordings))

    def run(recording: Recording, steps: int) -> Array:
        return simulate(setup, recording, steps, initial=fitted.initial(recording.name)).y

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

    steps = plan.each(enough, simulations=3.0)
    return replace(plan, substeps={r.name: n for r, n in zip(plan.recordings, steps, strict=True)})


def numerical_error(fit: Fit) -> NumericalError:
    """Return the error of solver and reconstruction at a fit."""
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

    error = np.concatenate(plan.each(one, simulations=4.0))
    q, _ = np.linalg.qr(fit.jacobian)
    return NumericalError(error, float(np.linalg.norm(error - q @ (q.T @ error))))


def with_bounded_error(first: Fit, bound: float) -> tuple[Fit, NumericalError]:
    """Refit with sub-steps for a bound, again where the fit has moved enough to need finer ones.

    Args:
        bound: on the numerical error over all recordings, in standard deviations of the noise.
    """
    # What is absorbed is known with steps that are fine enough for the derivatives.
    fitted, plan = first, substeps_for(first, first.plan, bound)
    for _ in range(3):
        fitted = resumed(fit_identified(fitted.setup, plan, stated_only(fitted.held), origin=fitted))
        error = numerical_error(fitted)
        if error.sigma <= bound:
            break
        plan = substeps_for(fitted, fitted.plan, bound, error)
    free = released(fitted)
    return (fitted, error) if free is fitted else (free, numerical_error(free))


def released(fitted: Fit, keep: Sequence[str] = ()) -> Fit:
    """Return a fit whose held parameters do not stand on a plateau far from where the recordings would notice them.

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
        if used_up():
            break
        p = fitted.setup.parameters[name]
        values = [v for v in p.value * 10.0 ** np.arange(-9.0, 10.0) if p.lower < v < p.upper]
        setups = [fitted.setup.with_values({name: v}) for v in values]
        costs = [coarse_cost(s, fitted.plan) for s in setups]
        best = int(np.argmin(costs))
        if costs[best] < coarse_cost(fitted.setup, fitted.plan) - 1.0:
            moved = fit_identified(setups[best], fitted.plan, held, origin=fitted, keep=keep)
            fitted = moved if moved.cost < fitted.cost else fitted
    return fitted


def coarse_cost(setup: Setup, plan: Plan) -> float:
    """Return the sum of squares of a setup on a plan with coarse sub-steps; infinite where it cannot be simulated."""
    problem = Problem(setup, plan.coarse(), Variables((), (), np.zeros(0), {}))
    try:
        residual = problem.residual(np.zeros(0))
    except SolverFailed:
        return float("inf")
    return float(residual @ residual)


_QUICK, _FULL = 12, 60
# A network explains recordings badly if it leaves more than this share of their mean square, and the reversed output
# well if it leaves less than that share of what it left of the recorded one.
_BADLY, _WELL = 0.5, 0.25
# Windows of an equation of motion; share of the input's square that it may leave; standard errors of its stiffness.
_WINDOWS, _FOLLOWED, _SURE = 20, 0.05, 5.0
_FINALISTS = 3
# Weighted mean square up to which a short fit is near the noise and nothing further starts.
_NEAR = 1.4


def identify_network(
    setup: Setup, plan: Plan, known: Mapping[str, Anchor], starts: int, seed: int, from_recordings: bool = False
) -> Fit:
    """Fit a network to the identification samples of a plan.

    Where no start comes near the noise, the starting values may belong to another time scale: there the network in
    units that suit the recordings (`scaled_points`) starts too.

    Args:
        setup: the network with starting values and the values of the anchors; the first start are these.
        plan: recordings and sub-steps.
        known: anchors; a known parameter is held at its value.
        starts: number of starting points; all but the first have every positive parameter multiplied by a factor around
            one, ``exp N(0, 1)``, and every other moved by its typical size.
        seed: of these factors.
        from_recordings: the starting values say nothing, and the recordings give them (`scaled_points`).

    Raises:
        InputRefused: the output falls where the input rises, or the plant is unstable.
        PhnnError: no starting point can be simulated.
    """
    held = held_at(known)
    tried: list[Fit] = []
    stated = {n: a.value for n, a in known.items()}
    points = scaled_points(setup, plan, stated) if from_recordings else []
    setup = points[0] if points else setup
    failure = _tried(points or _starts(setup, held, starts, seed), plan, held, tried)
    if not points and min((f.chi2 for f in tried), default=np.inf) > _NEAR and not late(FURTHER_STARTS):
        failure = _tried(scaled_points(setup, plan, stated), plan, held, tried) or failure
    if not tried:
        raise PhnnError(f"no starting point of {setup.name} can be simulated ({failure}): give other starting values")
    finished: list[Fit] = []
    for first in sorted(tried, key=lambda f: f.cost)[:_FINALISTS]:
        if finished and late(FURTHER_STARTS):
            break
        finished.append(fit_identified(first.setup, plan, held, _FULL, first))
    best = min(finished, key=lambda f: f.cost)
    whole = not any(r.sensor.rectified or r.sensor.is_limited for r in best.plan.recordings)
    if whole and best.explained <= 1.0 - _BADLY:
        _can_be_explained(best, setup, held, stated)
        _can_rest(best)
    return best


def _tried(points: Sequence[Setup], plan: Plan, held: Mapping[str, str], tried: list[Fit]) -> PhnnError | None:
    """Add a short fit from each starting point, and return the last failure."""
    failure = None
    for start in points:
        if tried and late(FURTHER_STARTS):
            break
        try:
            tried.append(fit_identified(start, plan, held, _QUICK))
        except PhnnError as error:
            failure = error
    return failure


def _can_be_explained(fitted: Fit, setup: Setup, held: Mapping[str, str], stated: Mapping[str, float]) -> None:
    """Refuse recordings that a network explains badly as they are and well with the output reversed."""
    recordings = fitted.plan.recordings
    turned = replace(fitted.plan, recordings=tuple(replace(r, y=-r.y) for r in recordings))
    fits: list[Fit] = []
    _tried([setup, *scaled_points(setup, turned, stated)[:1]], turned, held, fits)
    reversed_fit = min(fits, key=lambda f: f.cost, default=fitted)
    if reversed_fit.cost < _WELL * fitted.cost:
        source = max(recordings, key=lambda r: float(np.ptp(r.y))).source
        raise InputRefused(
            f"{source}: the output falls where the input rises: reverse a sign (scale: -1 under columns in "
            f"recordings.yaml, at the input or the output). With the sign reversed the network leaves "
            f"{reversed_fit.chi2**0.5:.3g} times the noise, as recorded {fitted.chi2**0.5:.3g} times"
        )


def _can_rest(fitted: Fit) -> None:
    """Refuse recordings of a plant whose stiffness is negative: it falls away from where it rests.

    With windows ``φ`` that vanish at their ends, ``∫ φ u = M ∫ φ̈ y − B ∫ φ̇ y + K ∫ φ y + c ∫ φ`` needs no derivative.
    """
    network, recordings = fitted.setup.network, fitted.plan.recordings
    moved = next((m for m in motions(network) if m.displacement == network.output), None)
    if moved is None or len(network.ports) > 1 or any(r.sensor.derivative for r in recordings):
        return
    rows = []
    for r in recordings:
        size = max(r.t.size // _WINDOWS, 8)
        s, half = np.linspace(-1.0, 1.0, size), 0.5 * size * r.dt
        near = 1.0 - s**2
        window, slope, bend = near**3, -6.0 * s * near**2 / half, (24.0 * s**2 * near - 6.0 * near**2) / half**2
        y, u = (sliding_window_view(x, size)[:: size // 2] for x in (r.y, r.u))
        rows.append(np.column_stack([y @ bend, -(y @ slope), y @ window, np.ones(len(y)), u @ window]))
    both = np.concatenate(rows)
    sizes = np.linalg.norm(both, axis=0) + 1e-300
    terms, driven = both[:, :4] / sizes[:4], both[:, 4] / sizes[4]
    coefficients = np.linalg.lstsq(terms, driven, rcond=1e-10)[0]
    unexplained = float(np.sum((driven - terms @ coefficients) ** 2))
    spread = (unexplained / len(both) * np.linalg.pinv(terms.T @ terms)[2, 2]) ** 0.5
    if unexplained > _FOLLOWED or coefficients[0] <= 0.0 or coefficients[2] > -_SURE * spread:
        return
    (inertia, _, stiffness, _), units = coefficients * sizes[4] / sizes[:4], recordings[0].units
    of_input = "" if drive_ratio(network, moved.momentum) is None else " over the ratio of the input"
    raise InputRefused(
        f"{recordings[0].source}: the plant is unstable: its motion follows a negative stiffness of about "
        f"{stiffness:.3g} {units.input}/{units.output}{of_input}, beside an inertia of {inertia:.3g} (SI), which no "
        "passive network has. Take what the controller that holds it is told (its set point) as the input: both "
        "together are identified then"
    )


def _starts(setup: Setup, held: Mapping[str, str], count: int, seed: int) -> list[Setup]:
    rng = np.random.default_rng(seed)
    starts = [setup]
    for _ in range(count - 1):
        values = {}
        for name in (n for n in setup.free if n not in held):
            p, z = setup.parameters[name], float(rng.standard_normal())
            moved = p.value * np.exp(z) if p.positive else p.value + z * p.typical
            values[name] = float(np.clip(moved, p.lower, p.upper))
        starts.append(setup.with_values(values))
    return starts


Progress = Callable[[str], None]


def quiet(message: str) -> None:
    """Say nothing."""


def identify_base(
    campaign: Campaign, options: Options, progress: Progress = quiet, share: float = 0.0
) -> tuple[Fit, NumericalError]:
    """Fit the campaign's base model; the sub-steps are chosen on the way and checked at the end.

    Args:
        share: of the residual's norm beyond the noise, which the numerical error may have where that is more than
            ``options.error_bound_sigma``: the steps of a model that is far from the recordings need not be finer.
    """
    prepared = prepare.prepare(campaign, options.workers)
    if prepare.is_shared(campaign.recordings):
        # Starting values are sought with a zero for each recording.
        plan = replace(prepared.plan, recordings=prepare.own_zeros(prepared.plan.recordings))
        begun = _begun(replace(prepared, plan=plan), campaign, options, progress)
        first = prepare.with_shared_zero(begun, prepared.plan)
    else:
        first = _begun(prepared, campaign, options, progress)
    fit_and_error = with_bounded_error(first, _bound(first, options, share))
    # It may have come much nearer to the recordings than where it began.
    bound = _bound(fit_and_error[0], options, share)
    return fit_and_error if fit_and_error[1].sigma <= bound else with_bounded_error(fit_and_error[0], bound)


def _bound(fitted: Fit, options: Options, share: float) -> float:
    """Return the largest numerical error [standard deviations]."""
    return max(options.error_bound_sigma, share * fitted.beyond_noise**0.5)


def _begun(prepared: prepare.Prepared, campaign: Campaign, options: Options, progress: Progress) -> Fit:
    """Return a first fit of the base model, from no starting values or those of a network's file."""
    plan, model, hysterons = prepared.plan, prepared.model, prepared.hysterons
    if prepared.described is not None:
        progress(f"identify the network of {prepared.described.name}")
        scaled = prepare.is_ready(campaign)
        return identify_network(prepared.described, plan, campaign.known, options.starts, options.seed, scaled)
    if model == "bouc_wen":
        return identify_bouc_wen(plan, campaign, options, progress)
    begun: Fit | None = None
    if hysterons is None:
        hysterons, begun = prepare.hysteresis_needed(plan, campaign.known, options.starts, options.seed, progress)
    progress(f"identify {model} with {hysterons}" + (" hysterons" if isinstance(hysterons, int) else ""))
    # Unknown initial states make many local optima: there all starts are tried again.
    setup = None if begun is None or any(map(starts_unknown, plan.recordings)) else begun.setup
    return identify_actuator(plan, campaign.known, hysterons, options.starts, options.seed, setup)


def identify_bouc_wen(plan: Plan, campaign: Campaign, options: Options, progress: Progress = quiet) -> Fit:
    """Return the Bouc–Wen with its parameters scaled to the drive, from several starts."""
    progress("identify bouc_wen")
    anchored = {n: a.value for n, a in campaign.known.items()}
    held = held_by_statement(campaign.known)
    drive = max(float(abs(r.u).max()) for r in plan.recordings)
    tried = []
    for point in mechanical_points(plan, anchored):
        for weight, rate in ((0.15, 1.5), (0.3, 4.0), (0.1, 10.0)):
            # Table 2 has A = 0.0087 per volt; the state saturates at A/(β + γ).
            beta, gamma = 0.3 * rate / drive, 0.7 * rate / drive
            start = {"beta": beta, "gamma": gamma, "w": weight * drive / (0.008743 / (beta + gamma))}
            setup = bouc_wen(point.values() | start)
            tried.append(fit_identified(setup, plan, {n: w for n, w in held.items() if n in setup.parameters}, 10))
    finished = [fit_identified(f.setup, plan, f.held, 40, f) for f in sorted(tried, key=lambda f: f.cost)[:2]]
    return min(finished, key=lambda f: f.cost)
