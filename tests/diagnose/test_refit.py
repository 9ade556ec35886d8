"""Refits of strong effects, which the score says little of, and of special cases of what explains best."""

from __future__ import annotations

from functools import cache

import campaigns
import numpy as np
import pytest

from phnn.criteria import Criteria
from phnn.diagnose.linearised import direction, prepare
from phnn.diagnose.refit import converged, further, large_starts, short
from phnn.diagnose.screen import Candidate, Screen
from phnn.diagnose.search import Search, _tried, begin, explore, material
from phnn.effects import Effect, catalogue, effect, in_all_forms
from phnn.identification.fit import Fit
from phnn.identification.plan import Plan
from phnn.identification.staged import fit_identified
from phnn.models.actuator import hrc
from phnn.recordings import Campaign
from phnn.setup import Setup

CRITERIA = Criteria()
HELD = {"m": "held at the stated value"}
T = np.arange(401) * 1e-4


def fitted(true: Setup, noise: float = 1e-7, frequencies: tuple[int, ...] = (50, 100, 200)) -> Fit:
    """A base fit to recordings of an actuator with one effect more."""
    drives = {f: 80.0 * np.sin(2.0 * np.pi * f * T) for f in frequencies}
    made = tuple(campaigns.recorded(true, f"sine {f}", T, u, noise, seed=f) for f, u in drives.items())
    return fit_identified(Setup(hrc(2)), Plan(made, {r.name: 4 for r in made}), HELD, max_evaluations=15)


def searching(base: Fit, *names: str) -> Search:
    """A search that knows a base model, with some effects in all forms."""
    recordings = base.plan.recordings
    campaign = Campaign(recordings, {}, {}, "command", (), True, "made up")
    return begin(campaign, base, in_all_forms(effect(n) for n in names), [], CRITERIA)


def to_the_end(base: Fit, added: Effect, *starts: dict[str, float]) -> Fit:
    """An effect beside a base model, carried to its end from the best of some starts."""
    begun = short(base, base.plan.coarse(), added, starts, CRITERIA.short)
    assert begun is not None
    ended = converged(further(begun, CRITERIA.further, begun.plan), base.plan, base.held, added.parameters)
    assert ended is not None
    return ended


@cache
def strong() -> Fit:
    return fitted(effect("rate_dependent_threshold").add_to(Setup(hrc(2)), {"kappa_v": 6.0}))


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("contact_stop", {"k_c": 4e5, "g_c": 1e-5, "d_c": 1e-5}),
        ("cubic_stiffness", {"k_5": 3e5, "q_0": 2e-5}),
        ("quadratic_drag", {"F_2": 0.5, "n_2": 2.7, "v_2": 5e-3}),
    ],
)
def test_the_form_of_an_effect_that_acts_stands_first(name: str, values: dict[str, float]) -> None:
    acts = next(f for f in in_all_forms([effect(name)]) if set(f.parameters) == set(values))
    base = fitted(acts.add_to(Setup(hrc(2)), values), 1e-8, (50, 200))
    search = searching(base, name)
    ended = [to_the_end(base, c.effect, c.values) for c in search.screen(prepare(base))[:6]]
    assert set(values) <= set(min(ended, key=lambda f: f.cost).setup.values())


def test_a_strong_effect_that_the_screen_hardly_sees_is_found_from_large_starts() -> None:
    base = strong()
    assert base.chi2 > 4.0
    threshold, linearised = effect("rate_dependent_threshold"), prepare(base)
    grid = threshold.grid(linearised.scales)
    hidden = Candidate(threshold, grid[len(grid) // 2], 0.0, 0.0, 0.0)
    near = _tried(linearised, base.plan, np.inf, CRITERIA.short, hidden)
    far = _tried(linearised, base.plan, 0.0, CRITERIA.short, hidden)
    assert near is not None and far is not None and far.cost <= near.cost
    found = converged(far, base.plan, base.held, threshold.parameters)
    assert found is not None and found.chi2 < 1.1
    assert found.setup.values()["kappa_v"] == pytest.approx(6.0, rel=0.05)


FRICTION = {
    "falls with the speed": {"F_c": 0.04, "v_s": 1e-3, "r_f": 0.5, "v_d": 1e-2},
    "is bent first": {"k_f": 4e4, "F_c": 0.04, "r_f": 0.8, "v_d": 5e-3},
    "creeps": {"k_f": 4e4, "F_c": 0.04, "slip_f": 5e3, "rho_f": 5e-3},
}


@pytest.mark.parametrize("values", FRICTION.values(), ids=FRICTION)
def test_friction_has_forms(values: dict[str, float]) -> None:
    form = next(e for e in effect("coulomb_friction").forms if set(e.parameters) == set(values))
    base = fitted(form.add_to(Setup(hrc(2)), values), 2e-8)
    search = searching(base, "coulomb_friction", "cubic_stiffness")
    explore(search)
    best = search.best
    assert [e.name for e in best.elements] == ["coulomb_friction"]
    assert best.fit.chi2 < 1.1
    found, sizes = best.fit.setup.values(), [n for n in ("F_c", "r_f", "rho_f") if n in values]
    assert [found[n] for n in sizes] == pytest.approx([values[n] for n in sizes], rel=0.15)


@pytest.mark.parametrize("name", sorted(n for n, e in catalogue().items() if e.strength is not None))
def test_large_step_starts_change_about_as_much_as_there_is_to_explain(name: str) -> None:
    base, chosen = strong(), effect(name)
    if not chosen.can_be_added_to(base.setup):
        pytest.skip("not of an actuator")
    linearised = prepare(base)
    total = float(np.sum(linearised.residual**2))
    starts = large_starts(linearised, chosen)
    assert len(starts) <= 2
    assert len({tuple(v.values()) for v in starts}) == len(starts)
    shares = [float(np.sum(linearised.project(direction(linearised, chosen, v)) ** 2)) / total for v in starts]
    assert all(0.0 < s <= 3.0 for s in shares)


def test_an_extra_hysteron_takes_the_place_of_each_of_the_others() -> None:
    extra = effect("extra_hysteron")
    added = {"C_x": 7e-7, "rho_x": 3e-4, "d_x": 15.0}
    known = extra.add_to(Setup(hrc(3)), added).values()
    assert extra.equivalents is not None
    places = extra.equivalents(known)
    assert [set(p) for p in places] == [{f"C_{i}", f"rho_{i}", f"d_{i}"} for i in (1, 2, 3)]
    assert all(sorted(p.values()) == sorted(added.values()) for p in places)


def test_a_slew_limit_that_only_steps_of_the_command_meet_is_found() -> None:
    # As steep as a step between two samples can be, far above what the excited frequencies would need.
    true = effect("slew_limit").add_to(Setup(hrc(2)), {"S": 1.4e6})
    drives = {"steps": 80.0 * np.sign(np.sin(2.0 * np.pi * 50.0 * T + 0.01)), "sine": 80.0 * np.sin(60.0 * np.pi * T)}
    made = tuple(campaigns.recorded(true, n, T, u, 1e-6, 1, "zero_order") for n, u in drives.items())
    base = fit_identified(Setup(hrc(2)), Plan(made, {r.name: 4 for r in made}), HELD, max_evaluations=15)
    grid = effect("slew_limit").grid(prepare(base).scales)
    near = min(grid, key=lambda v: abs(np.log(v["S"] / 1.4e6)))
    found = to_the_end(base, effect("slew_limit"), near)
    assert found.chi2 < 1.1 < base.chi2
    assert found.setup.values()["S"] == pytest.approx(1.4e6, rel=0.05)


def test_limits_that_nothing_meets_are_no_starts() -> None:
    limit = effect("slew_limit")
    drive = campaigns.recorded(Setup(hrc(2)), "sine", T, 80.0 * np.sin(200.0 * np.pi * T), 1e-8)
    plan = Plan((drive,), {"sine": 4})
    steepest = max(v["S"] for v in limit.grid(prepare(fit_identified(Setup(hrc(2)), plan, HELD)).scales))
    true = limit.add_to(Setup(hrc(2)), {"S": 0.99 * 2.0 * np.pi * 100.0 * 80.0})
    made = campaigns.recorded(true, "sine", T, drive.u, 1e-8, 2)
    base = fit_identified(Setup(hrc(2)), Plan((made,), {"sine": 4}), HELD)
    linearised = prepare(base)
    (candidate,) = Screen(linearised, [limit], CRITERIA)(linearised)
    assert material(candidate, base, CRITERIA)
    # Points of the grid that change nothing come last, if at all.
    assert candidate.values["S"] < steepest / 100.0
    found = to_the_end(base, effect("slew_limit"), candidate.values)
    assert found.chi2 < 1.2 < base.chi2
