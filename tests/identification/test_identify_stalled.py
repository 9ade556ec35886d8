"""A fit that rests too early goes on, and a parameter that ran off to a plateau comes back."""

from __future__ import annotations

import campaigns

from phnn.identification.fit import fit
from phnn.identification.refinement import released, resumed
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


def test_a_parameter_on_a_plateau_comes_back() -> None:
    fitted = campaigns.base()
    # With the first hysteron held, the two cannot change places.
    stated = dict.fromkeys(("m", "rho_1", "C_1", "d_1"), "held at the stated value")
    # Hysteron 2 without a limit to its current: a plateau, far above the best fit.
    away = fitted.setup.with_values({"rho_2": 1e6})
    stuck = fit_identified(away, fitted.plan, stated)
    assert "rho_2" in stuck.held
    assert stuck.cost > 1.5 * fitted.cost
    free = released(stuck)
    assert "rho_2" not in free.held
    assert free.cost < 1.02 * fitted.cost


def test_a_fit_without_plateaus_is_left_alone() -> None:
    fitted = campaigns.base()
    again = fit_identified(fitted.setup, fitted.plan, {"m": "held at the stated value"})
    assert again.held == {"m": "held at the stated value"}
    assert released(again) is again
