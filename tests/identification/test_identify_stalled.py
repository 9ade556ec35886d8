"""A fit that rests in front of a ripple goes on behind it."""

from __future__ import annotations

import campaigns

from phnn.identification.fit import fit
from phnn.identification.refinement import resumed
from phnn.identification.staged import fit_identified


def test_a_fit_that_rests_too_early_goes_on() -> None:
    best = campaigns.base()
    moved = best.setup.with_values({n: 1.01 * best.setup.values()[n] for n in ("k", "alpha")})
    early = fit(moved, best.plan, best.variables.names, best.held, max_evaluations=1)
    assert early.cost > 1.5 * best.cost
    assert resumed(early).cost < 1.001 * best.cost


def test_a_fit_at_its_optimum_is_left_alone() -> None:
    best = campaigns.base()
    again = fit_identified(best.setup, best.plan, {"m": "held at the stated value"})
    assert resumed(again) is again
