"""The base model of a campaign, fitted with sub-steps that keep the numerical error below the noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from phnn.identification.described import identify_network
from phnn.identification.fit import Fit
from phnn.identification.options import Options
from phnn.identification.order import hysteresis_needed
from phnn.identification.plan import Plan
from phnn.identification.prepare import Prepared, prepare
from phnn.identification.refinement import NumericalError, with_bounded_error
from phnn.identification.staged import fit_identified, held_by_statement, identify_actuator
from phnn.identification.starting_points import mechanical_points
from phnn.identification.zero import is_shared, with_own_zeros, with_shared_zero
from phnn.models.bouc_wen import bouc_wen
from phnn.recordings.recording import Campaign

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
    prepared = prepare(campaign, options.workers)
    if is_shared(campaign.recordings):
        own = replace(prepared, plan=with_own_zeros(prepared.plan))
        first = with_shared_zero(_begun(own, campaign, options, progress), prepared.plan)
    else:
        first = _begun(prepared, campaign, options, progress)
    found = with_bounded_error(first, _bound(first, options, share))
    # It may have come much nearer to the recordings than where it began.
    bound = _bound(found[0], options, share)
    return found if found[1].sigma <= bound else with_bounded_error(found[0], bound)


def _bound(fitted: Fit, options: Options, share: float) -> float:
    """Largest numerical error [standard deviations]."""
    return max(options.error_bound_sigma, share * fitted.beyond_noise**0.5)


def _begun(prepared: Prepared, campaign: Campaign, options: Options, progress: Progress) -> Fit:
    """A first fit of the base model, from no starting values or those of a network's file."""
    plan, model, hysterons = prepared.plan, prepared.model, prepared.hysterons
    if prepared.described is not None:
        progress(f"identify the network of {prepared.described.name}")
        return identify_network(prepared.described, plan, campaign.known, options.starts, options.seed)
    if model == "bouc_wen":
        return identify_bouc_wen(plan, campaign, options, progress)
    if hysterons is None:
        hysterons = hysteresis_needed(plan, campaign.known, options.starts, options.seed, progress)
    progress(f"identify {model} with {hysterons}" + (" hysterons" if isinstance(hysterons, int) else ""))
    return identify_actuator(plan, campaign.known, hysterons, options.starts, options.seed)


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
