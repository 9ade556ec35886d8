"""The base model of a campaign, fitted with sub-steps that keep the numerical error below the noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from phnn.errors import InputRefused, SolverFailed, StructureViolated
from phnn.identification.described import identify_network
from phnn.identification.fit import Fit
from phnn.identification.numerics import NumericalError, numerical_error, substeps_for
from phnn.identification.options import Options
from phnn.identification.order import MOST_HYSTERONS, hysterons_needed
from phnn.identification.plan import Plan
from phnn.identification.problem import Problem
from phnn.identification.staged import (
    check_known,
    fit_identified,
    held_by_statement,
    identify_actuator,
    mechanical_points,
    stated_only,
)
from phnn.identification.stalled import resumed
from phnn.identification.variables import Variables
from phnn.identification.zero import is_shared, with_own_zeros, with_shared_zero, with_unknown_gain
from phnn.intake.names import printable
from phnn.integrate.program import compile_network
from phnn.models.actuator import hrc
from phnn.models.bouc_wen import bouc_wen
from phnn.models.network_file import load_network
from phnn.recall import recalled
from phnn.recordings.recording import Campaign, Recording
from phnn.setup import Setup
from phnn.simulate import check_names

Progress = Callable[[str], None]


def quiet(message: str) -> None:
    """Say nothing."""


def identification_plan(campaign: Campaign, workers: int) -> Plan:
    """The recordings with identification samples.

    Raises:
        InputRefused: there are none.
    """
    chosen = tuple(r for r in campaign.recordings if r.mask("identification").any())
    if not chosen:
        raise InputRefused("no recording is for identification: set `use: identification` for some in recordings.yaml")
    return Plan(chosen, {}, workers, {n: a.std for n, a in campaign.known.items()})


@dataclass(frozen=True)
class Prepared:
    """What a fit begins with, once nothing in the manifest can be refused any more.

    Attributes:
        plan: the recordings with identification samples.
        model: by name; ``network`` where a file describes it.
        hysterons: of an actuator; None where nobody says how many.
        described: the network of that file.
    """

    plan: Plan
    model: str
    hysterons: int | None
    described: Setup | None = None


def prepare(campaign: Campaign, workers: int = 1) -> Prepared:
    """Everything of an identification that can be refused before it begins.

    Raises:
        InputRefused: no recording to identify from, a network that cannot be built or simulated, ports or outputs that
            it does not have, anchors of parameters that the model does not have or that cannot have the value, several
            inputs for a model of one.
    """
    plan = identification_plan(campaign, workers)
    is_shared(campaign.recordings)
    if "network" in campaign.setup:
        return Prepared(plan, "network", 0, _described(campaign))
    gain_known(campaign.recordings)
    single(campaign.recordings, "this model has one input and one output")
    displacement_shown(campaign.recordings)
    model = str(campaign.setup.get("model", "piezo_actuator"))
    stated = campaign.setup.get("hysterons") if model in ("piezo_actuator", "hrc") else 0
    hysterons = None if stated is None else int(stated)
    most = MOST_HYSTERONS if hysterons is None else hysterons
    parameters = bouc_wen().parameters if model == "bouc_wen" else hrc(most).parameters
    check_known(campaign.known, parameters)
    held_by_statement(campaign.known)
    mechanical_points(plan, {n: a.value for n, a in campaign.known.items()})
    return Prepared(plan, model, hysterons)


def _described(campaign: Campaign) -> Setup:
    """The network of the manifest, a file or a setup, with its anchors."""
    given = campaign.setup["network"]
    path = Path(given.name if isinstance(given, Setup) else str(given))
    setup = given if isinstance(given, Setup) else Setup(load_network(path), name=printable(path.stem))
    check_names(setup.network, campaign.recordings)
    check_known(campaign.known, setup.parameters)
    try:
        setup = setup.with_values({n: a.value for n, a in campaign.known.items()})
        compile_network(setup.network)
    except StructureViolated as error:
        raise InputRefused(f"{printable(path.name)}: {error}") from error
    if not setup.network.ports:
        raise InputRefused(f"{printable(path.name)}: no source for the recorded input: add an element of type Se or Sf")
    return with_unknown_gain(setup, campaign.recordings)


def identify_base(campaign: Campaign, options: Options, progress: Progress = quiet) -> tuple[Fit, NumericalError]:
    """Fit the campaign's base model; the sub-steps are chosen on the way and checked at the end."""
    prepared = prepare(campaign, options.workers)
    if not is_shared(campaign.recordings):
        return settled(_begun(prepared, campaign, options, progress), options.error_bound_sigma)
    own = replace(prepared, plan=with_own_zeros(prepared.plan))
    first = with_shared_zero(_begun(own, campaign, options, progress), prepared.plan)
    return settled(first, options.error_bound_sigma)


def _begun(prepared: Prepared, campaign: Campaign, options: Options, progress: Progress) -> Fit:
    """A first fit of the base model, from no starting values or those of a network's file."""
    plan, model, hysterons = prepared.plan, prepared.model, prepared.hysterons
    if prepared.described is not None:
        progress(f"identify the network of {prepared.described.name}")
        return identify_network(prepared.described, plan, campaign.known, options.starts, options.seed)
    if model == "bouc_wen":
        return identify_bouc_wen(plan, campaign, options, progress)
    if hysterons is None:
        hysterons = hysterons_needed(plan, campaign.known, options.starts, options.seed, progress)
    progress(f"identify {model} with {hysterons} hysterons")
    return identify_actuator(plan, campaign.known, hysterons, options.starts, options.seed)


def single(recordings: Sequence[Recording], why: str) -> None:
    """Refuse recordings of several inputs or outputs.

    Raises:
        InputRefused: names one.
    """
    several = [r.source for r in recordings if r.further or r.measures]
    if several:
        raise InputRefused(
            f"{several[0]}: several inputs or outputs (`ports`, `outputs` in recordings.yaml), but {why}: describe the "
            f"system as a network and use phnn check, identify and predict, or give one input and one output"
        )


def gain_known(recordings: Sequence[Recording]) -> None:
    """Refuse an unknown gain where the model has one of its own, the transducer's.

    Raises:
        InputRefused: names a recording.
    """
    unknown = [r.source for r in recordings if r.gain == "unknown"]
    if unknown:
        raise InputRefused(
            f"{unknown[0]}: gain: unknown: this model's transducer ratio takes up any factor of the input already, "
            f"leave `gain` out; electrical values then hold for the recorded numbers as volts"
        )


def displacement_shown(recordings: Sequence[Recording]) -> None:
    """Refuse sensors of the velocity, from which the stages of an actuator's identification cannot begin.

    Raises:
        InputRefused: names one.
    """
    rates = [r.source for r in recordings if r.sensor.derivative]
    if rates:
        raise InputRefused(
            f"{rates[0]}: its sensor measures a velocity (`sensor: {{derivative: true}}`), but this model is "
            f"identified from displacements: describe the actuator as a network, setup: {{network: FILE.yaml}}"
        )


def identify_bouc_wen(plan: Plan, campaign: Campaign, options: Options, progress: Progress = quiet) -> Fit:
    """Bouc–Wen with its parameters scaled to the drive, from several starts."""
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


@recalled
def settled(first: Fit, bound: float, keep: Sequence[str] = ()) -> tuple[Fit, NumericalError]:
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


@recalled
def refined(fitted: Fit, options: Options) -> tuple[Fit, NumericalError]:
    """The same fit with all sub-steps doubled."""
    doubled = {r.name: 2 * fitted.plan.steps_of(r) for r in fitted.plan.recordings}
    plan = replace(fitted.plan, substeps=doubled)
    held = stated_only(fitted.held)
    again = fit_identified(fitted.setup, plan, held, origin=fitted)
    return replace(again, alternatives=fitted.alternatives), numerical_error(again)
