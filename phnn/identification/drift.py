"""Identify a model whose output integrates its input, as the position of a carriage without a spring.

The smallest force that such a model lacks moves it away for ever. The sum of squares of the position is then ruled by
that drift, and its minimum lies where the model hardly answers the input. Beside drift terms of each recording
(`phnn.setup.Own`) the same recordings show mass and friction.
"""

from __future__ import annotations

from dataclasses import replace

from phnn.identification.base import Options, Progress, described, identify_described, quiet, settled
from phnn.identification.fit import Fit
from phnn.identification.numerics import NumericalError
from phnn.identification.staged import fit_identified, stated_only
from phnn.identification.stalled import resumed
from phnn.network.linear import integrates
from phnn.recordings.recording import Campaign
from phnn.setup import DRIFT_TERMS, Setup


def drifts(setup: Setup, campaign: Campaign) -> bool:
    """Whether a constant input moves the output of a setup without end."""
    return integrates(setup.network, max(r.t.size * r.dt for r in campaign.recordings))


def beside_drift(campaign: Campaign, options: Options, progress: Progress = quiet) -> tuple[Fit, NumericalError]:
    """Fit the network of a campaign's manifest beside drift terms of each recording.

    Returns:
        The fit, whose setup has the drift terms, and its numerical error.
    """
    progress("the output integrates the input: search beside a slow drift of each recording")
    setup = described(campaign)
    with_drift = replace(setup, own=setup.own._replace(drift_terms=DRIFT_TERMS))
    return settled(identify_described(with_drift, campaign, options), options.error_bound_sigma)


def without_drift(fitted: Fit) -> Fit:
    """Refit a model without its drift terms, from its estimates and initial states."""
    if not fitted.setup.own.drift_terms:
        return fitted
    setup = replace(fitted.setup, own=fitted.setup.own._replace(drift_terms=0))
    again = fit_identified(setup, fitted.plan, stated_only(fitted.held), origin=fitted)
    return replace(resumed(again), alternatives=())
