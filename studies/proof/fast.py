"""The fast tier: fit the base model from the published values, and let the score say what it thinks."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from phnn.criteria import CRITERIA
from phnn.diagnosis.diagnosis import available
from phnn.diagnosis.linearised_fit import prepare
from phnn.diagnosis.locate import responses
from phnn.diagnosis.name import score
from phnn.diagnosis.scored import SIGNIFICANT
from phnn.identification.options import Options
from phnn.identification.prepare import identification_plan
from phnn.identification.refinement import with_bounded_error
from phnn.identification.staged import fit_identified, held_by_statement
from phnn.models.actuator import from_paper
from phnn.recordings import read
from phnn.setup import Setup


def score_folder(folder: Path, seed: int) -> dict[str, Any]:
    """What the score stage says of a folder, in the words of ``diagnosis.json`` as far as they go."""
    began = time.monotonic()
    campaign = read(folder)
    options = Options(seed=seed, workers=1)
    network = from_paper().with_values({n: a.value for n, a in campaign.known.items()})
    first = fit_identified(
        Setup(network), identification_plan(campaign, 1), held_by_statement(campaign.known), max_evaluations=30
    )
    base, error = with_bounded_error(first, options.error_bound_sigma)
    linearised = prepare(base, campaign.voltage == "terminals")
    naming = score(linearised, available(campaign, base.setup), responses(linearised), seed, error.error)
    best = naming.candidates[0]
    # Squared scores are sums of squares that a refit would save.
    members = [
        n for n, c in naming.by_name.items() if best.score**2 - c.score**2 < CRITERIA.selection.tie and c.score > 0.0
    ]
    found = naming.p_value < SIGNIFICANT
    return {
        "verdict": "named" if found else "none",
        "test": {"statistic": naming.statistic, "p_value": naming.p_value, "candidate": best.effect.name},
        "missing": [{"effect": members[0], "location": best.effect.location, "equivalent_to": members[1:]}]
        if found
        else [],
        "base_residual_over_noise": base.chi2**0.5,
        "numerical_error_sigma": error.sigma,
        "seconds": time.monotonic() - began,
    }
