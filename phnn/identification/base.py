"""The base model of a campaign, fitted with sub-steps that keep the numerical error below the noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from phnn.errors import PhnnError
from phnn.identification.fit import Fit, distinct_optima
from phnn.identification.options import Options
from phnn.identification.plan import Plan
from phnn.identification.prepare import Prepared, hysteresis_needed, prepare
from phnn.identification.problem import starts_unknown
from phnn.identification.refinement import NumericalError, with_bounded_error
from phnn.identification.staged import (
    FURTHER_STARTS,
    check_known,
    fit_identified,
    held_at,
    held_by_statement,
    identify_actuator,
)
from phnn.identification.starting_points import mechanical_points
from phnn.identification.zero import is_shared, with_own_zeros, with_shared_zero
from phnn.models.bouc_wen import bouc_wen
from phnn.recordings.recording import Anchor, Campaign
from phnn.rescue import late
from phnn.setup import Setup

_QUICK, _FULL = 12, 60
_FINALISTS = 3


def identify_network(setup: Setup, plan: Plan, known: Mapping[str, Anchor], starts: int, seed: int) -> Fit:
    """Fit a network to the identification samples of a plan.

    Args:
        setup: the network with starting values; the first start are these.
        plan: recordings and sub-steps.
        known: anchors; a known parameter is held at its value.
        starts: number of starting points; all but the first have every positive parameter multiplied by a factor around
            one, ``exp N(0, 1)``, and every other moved by its typical size.
        seed: of these factors.

    Raises:
        InputRefused: a known parameter does not belong to the network.
        PhnnError: no starting point can be simulated.
    """
    check_known(known, setup.parameters)
    setup = setup.with_values({n: a.value for n, a in known.items()})
    held = held_at(known)
    tried: list[Fit] = []
    for start in _starts(setup, held, starts, seed):
        if tried and late(FURTHER_STARTS):
            break
        try:
            tried.append(fit_identified(start, plan, held, _QUICK))
        except PhnnError as error:
            failure = error
    if not tried:
        raise PhnnError(f"no starting point of {setup.name} can be simulated ({failure}): give other starting values")
    finished: list[Fit] = []
    for first in sorted(tried, key=_cost)[:_FINALISTS]:
        if finished and late(FURTHER_STARTS):
            break
        finished.append(fit_identified(first.setup, plan, held, _FULL, first))
    best, alternatives = distinct_optima(finished)
    return replace(best, alternatives=alternatives)


def _cost(fitted: Fit) -> float:
    return fitted.cost


def _starts(setup: Setup, held: Mapping[str, str], count: int, seed: int) -> list[Setup]:
    rng = np.random.default_rng(seed)
    found = [setup]
    for _ in range(count - 1):
        values = {}
        for name in (n for n in setup.free if n not in held):
            p, z = setup.parameters[name], float(rng.standard_normal())
            moved = p.value * np.exp(z) if p.positive else p.value + z * p.typical
            values[name] = float(np.clip(moved, p.lower, p.upper))
        found.append(setup.with_values(values))
    return found


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
    begun: Fit | None = None
    if hysterons is None:
        hysterons, begun = hysteresis_needed(plan, campaign.known, options.starts, options.seed, progress)
    progress(f"identify {model} with {hysterons}" + (" hysterons" if isinstance(hysterons, int) else ""))
    # Unknown initial states make many local optima: there all starts are tried again.
    setup = None if begun is None or any(map(starts_unknown, plan.recordings)) else begun.setup
    return identify_actuator(plan, campaign.known, hysterons, options.starts, options.seed, setup)


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
