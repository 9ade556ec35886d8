"""Moves of the search, and the screen against least squares that share no code with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from sys import modules
from types import SimpleNamespace
from typing import Any

import campaigns
import numpy as np
import pytest
from scipy.signal import lfilter

from phnn.criteria import Criteria
from phnn.diagnose.diagnosis import Diagnosis
from phnn.diagnose.linearised import LinearisedFit, direction, prepare, tie
from phnn.diagnose.lines import wavelengths
from phnn.diagnose.number import Misfit, Visited
from phnn.diagnose.refit import Wanted, converged, rebuilt
from phnn.diagnose.refit import short as short_fit
from phnn.diagnose.screen import Screen
from phnn.diagnose.search import (
    Search,
    _drop_each,
    _exchange,
    _take_for_noise,
    _with_new_hysterons,
    begin,
    explore,
    finished,
    material,
)
from phnn.diagnose.verdict import NAMED, NONE, PROVISIONAL, UNKNOWN, Claim, conclude
from phnn.effects import effect
from phnn.effects.learned import learned_elements
from phnn.effects.places import attached
from phnn.identification.base import numerical_error
from phnn.identification.fit import Fit, fit
from phnn.identification.plan import Options, Plan
from phnn.identification.staged import fit_identified
from phnn.recordings import Campaign
from phnn.signals.noise import AS_WHITE

VALUES = {
    "amplifier_lowpass": {"tau_a": 1.5e-5},
    "sensor_lag": {"tau_y": 1.5e-5},
    "creep": {"k_s": 4e3, "tau_s": 5e-3},
    "quadratic_drag": {"c_2": 10.0},
    "coulomb_friction": {"F_c": 0.5, "v_s": 1e-4},
    "extra_hysteron": {"C_x": 3e-7, "rho_x": 0.3, "d_x": 5.0},
}
ALL = tuple(campaigns.STEPS)


@cache
def lacking(*names: str, recordings: Sequence[str] = ALL, substeps: int | None = None) -> Fit:
    """The base model fitted to recordings of one that has these effects too."""
    base = campaigns.base()
    true = base.setup
    for name in names:
        true = effect(name).add_to(true, VALUES[name])
    some = [r for r in base.plan.recordings if r.name in recordings]
    made = tuple(campaigns.recorded(true, r.name, r.t, r.u, r.noise, k) for k, r in enumerate(some))
    steps = {n: substeps or campaigns.STEPS[n] for n in recordings}
    return fit_identified(base.setup, Plan(made, steps, 1), {"m": "held at the stated value"})


def together(base: Fit, *names: str, others: Sequence[str] = ()) -> tuple[Search, Visited]:
    """A search that knows a base model and a model with some effects, carried to its end.

    Args:
        others: names of further effects that it knows of.
    """
    campaign = Campaign(base.plan.recordings, {}, {}, "command", (), True, "made up")
    elements = [effect(n) for n in names]
    search = begin(campaign, base, [*elements, *(effect(n) for n in others)], [], Criteria())
    values = base.setup.values() | {n: v for name in names for n, v in VALUES[name].items()}
    begun = rebuilt(base, base.plan.coarse(), 12, Wanted(tuple(elements), [values]))
    assert begun is not None
    own = [n for e in elements for n in e.parameters]
    whole = converged(begun, base.plan, base.held, own)
    assert whole is not None
    return search, search.visit(search.model(elements, whole, done=True))


@pytest.mark.parametrize(("line", "left"), [(0.0, 1.1), (1.0, None)])
def test_what_is_left_is_noise_where_nothing_shows_its_colour(line: float, left: float | None) -> None:
    base = campaigns.base()
    true, made = effect("quadratic_drag").add_to(base.setup, VALUES["quadratic_drag"]), []
    for k, r in enumerate(base.plan.recordings):
        clean = campaigns.recorded(true, r.name, r.t, r.u, 1e-3 * r.noise)
        noise = lfilter([1.6], [1.0, -0.6], np.random.default_rng(k).standard_normal(r.t.size))
        y = clean.y + r.noise * (noise + line * np.sin(np.arange(r.t.size)))
        made.append(replace(clean, y=y, noise=r.noise, noise_source=f"its highest frequencies, {AS_WHITE}"))
    search, whole = together(
        fit_identified(base.setup, Plan(tuple(made), campaigns.STEPS, 1), {"m": "held"}), "quadratic_drag"
    )
    before = search.base.left
    assert whole.left > 3.0
    _take_for_noise(search, whole)
    after = search.visited[whole.key].left
    assert after == pytest.approx(left or whole.left, rel=1e-6)
    assert search.base.left == pytest.approx(before * after / whole.left, rel=0.1)


def test_a_line_of_few_periods_is_tried_where_it_holds_most_of_what_is_left() -> None:
    linearised = prepare(lacking(recordings=("sine_010Hz_75V",)))
    cycles = np.arange(linearised.residual.size) / linearised.residual.size
    wave = 10.0 * np.sin(16.6 * np.pi * cycles) * (1.0 + 0.2 * np.sin(4.2 * np.pi * cycles))
    shown = campaigns.with_residual(linearised, linearised.residual + wave)
    (line,) = Screen(linearised, [effect("base_motion")], Criteria())(shown)
    assert line.score < Criteria().score and material(line, shown.fit, Criteria())


def test_an_effect_that_the_others_do_not_need_is_dropped() -> None:
    base = lacking("quadratic_drag")
    search, whole = together(base, "creep", "quadratic_drag")
    _drop_each(search, whole, whole.elements)
    best = search.best
    assert [e.name for e in best.elements] == ["quadratic_drag"]
    assert "k_s" not in best.fit.setup.parameters
    assert best.fit.cost < whole.fit.cost + tie(whole.fit)


def test_effects_that_are_needed_are_kept_each_with_the_model_without_it() -> None:
    base = lacking("quadratic_drag", "creep")
    search, whole = together(base, "quadratic_drag", "creep")
    _drop_each(search, whole, whole.elements)
    assert search.best is whole
    assert whole.fit.chi2 == pytest.approx(1.0, abs=0.05)
    found = conclude(search.weighed, whole, True, (2, 0), search.criteria)
    assert found.word == NAMED
    for claim, other in zip(found.claims, ("k_s", "c_2"), strict=True):
        alone = claim.without
        assert alone is not None and alone.fit.cost > 2.0 * whole.fit.cost
        assert other in alone.fit.setup.parameters
        assert not set(VALUES[claim.effect.name]) & set(alone.fit.setup.parameters)


@pytest.mark.parametrize(
    ("true", "claimed"),
    [("sensor_lag", "amplifier_lowpass"), pytest.param("extra_hysteron", "creep", marks=pytest.mark.slow)],
)
def test_the_true_neighbour_takes_the_place(true: str, claimed: str) -> None:
    search, model = together(lacking("quadratic_drag", true), "quadratic_drag", claimed, others=[true])
    _exchange(search, model, model.elements[1])
    best = search.best
    assert [e.name for e in best.elements] == ["quadratic_drag", true]
    assert best.fit.chi2 == pytest.approx(1.0, abs=0.05)
    assert set(VALUES[true]) <= set(best.fit.setup.parameters)
    assert not set(VALUES[claimed]) & set(best.fit.setup.parameters)
    # Compared with the same steps.
    assert best.fit.plan.substeps == model.fit.plan.substeps


def test_hysterons_begin_anew_beside_an_effect_where_no_derivative_leads_back() -> None:
    base, friction = lacking("coulomb_friction"), effect("coulomb_friction")
    search, _ = together(base, "coulomb_friction")
    # Both dead zones so wide that neither hysteron slips.
    wrong = base.setup.values() | VALUES["coulomb_friction"] | {"d_1": 300.0, "d_2": 300.0}
    stuck = rebuilt(base, base.plan.coarse(), 12, Wanted((friction,), [wrong]))
    assert stuck is not None and stuck.chi2 > 100.0
    found = _with_new_hysterons(search, search.model((friction,), stuck))
    assert found.left < 0.1 * stuck.chi2


def test_a_model_that_only_predicts_from_where_another_begins_is_not_written(monkeypatch: pytest.MonkeyPatch) -> None:
    search, whole = together(lacking("quadratic_drag"), "quadratic_drag")
    well, badly = {"later": Misfit(100.0, 100)}, {"later": Misfit(1e12, 100)}
    search.visited = {k: replace(m, held_out=well) for k, m in search.visited.items()}
    search.base, search.begun = search.visited[search.base.key], {"later": (whole.fit.setup, np.zeros(1))}
    monkeypatch.setattr(modules[finished.__module__], "held_out", lambda *given: well)
    assert finished(search).key == whole.key
    monkeypatch.setattr(modules[finished.__module__], "held_out", lambda *given: badly)
    assert finished(search).key == search.base.key


@pytest.mark.slow
def test_the_written_model_has_all_sub_steps_where_the_search_has_ended_early() -> None:
    base = lacking("quadratic_drag", "creep", substeps=4)
    search, _ = together(base, "creep", others=["quadratic_drag"])
    values = base.setup.values() | VALUES["creep"] | VALUES["quadratic_drag"]
    elements = [effect("creep"), effect("quadratic_drag")]
    coarse = rebuilt(base, base.plan.coarse(), 12, Wanted(tuple(elements), [values]))
    assert coarse is not None
    best = search.visit(search.model(elements, coarse))
    assert search.written is best and not best.converged
    written = finished(search)
    assert written.key == best.key
    assert dict(written.fit.plan.substeps) == dict(search.plan.substeps) != dict(coarse.plan.substeps)


@pytest.mark.slow
def test_laws_are_tried_where_a_learned_element_leads_far_from_the_noise() -> None:
    """Of friction a first derivative at rest promises nothing."""
    base = lacking("coulomb_friction")
    campaign = Campaign(base.plan.recordings, {}, {}, "command", (), True, "made up")
    law, learned = effect("coulomb_friction"), learned_elements()["learned_damper"]
    # Every law is below the score that is asked of a candidate.
    search = begin(campaign, base, [law], [learned], Criteria(near_best_far=1e9))
    assert search.base.left > search.criteria.far**2
    explore(search)
    assert ("coulomb_friction",) in {m.families for m in search.visited.values()}


@pytest.mark.slow
def test_of_a_special_case_and_the_general_one_a_search_finds_the_simpler() -> None:
    base = lacking("quadratic_drag", "creep")
    search = together(base, "quadratic_drag", others=["creep", "extra_hysteron"])[0]
    search.visited = {frozenset(): search.base}
    explore(search)
    assert search.best.families == ("creep", "quadratic_drag")
    assert search.best.fit.chi2 == pytest.approx(1.0, abs=0.05)


def test_a_true_effect_keeps_its_place() -> None:
    search, model = together(
        lacking("quadratic_drag", "creep"), "quadratic_drag", "creep", others=["extra_hysteron", "delay"]
    )
    _exchange(search, model, model.elements[1])
    assert search.best is model
    assert len(search.visited) > 2


def test_models_that_end_close_together_are_compared_without_numerical_error() -> None:
    base = lacking("sensor_lag", recordings=("sine_100Hz_75V", "step_75V"), substeps=1)
    bound = Options.error_bound_sigma
    assert numerical_error(base).sigma > 2.0 * bound
    search, _ = together(base, "sensor_lag", others=["amplifier_lowpass"])
    explore(search)
    assert [e.name for e in search.best.elements] == ["sensor_lag"]
    assert numerical_error(search.best.fit).sigma <= bound
    near = [m for m in search.weighed.models if m.converged and search.weighed.behind(m) < 8.0]
    assert {tuple(m.fit.plan.substeps.items()) for m in near} == {tuple(search.plan.substeps.items())}


def test_a_base_model_at_a_local_optimum_is_told_from_one_that_lacks_physics() -> None:
    """Swapped and narrowed dead zones stop a descent far above the noise; an element that vanishes led out of it."""
    good = campaigns.base()
    wrong = good.setup.with_values({n: 0.05 * good.setup.values()[n] for n in ("d_1", "d_2")})
    stopped = fit(wrong, good.plan, good.variables.names, good.held, max_evaluations=2)
    assert stopped.chi2 > 2.0
    creep = effect("creep")
    search = begin(campaigns.campaign(), stopped, [creep], [], Criteria())
    vanishing = replace(good, setup=creep.add_to(good.setup, {"k_s": 1e-4, "tau_s": 1e-5}))
    model = search.visit(search.model((creep,), vanishing, done=True))
    _drop_each(search, model, model.elements)
    assert search.best.elements == ()
    assert search.best.fit.chi2 == pytest.approx(good.chi2, rel=1e-2)
    assert set(search.best.fit.setup.parameters) == set(good.setup.parameters)


def test_a_search_without_candidates_ends_with_the_base_model() -> None:
    base = lacking("creep")
    campaign = Campaign(base.plan.recordings, {}, {}, "command", (), True, "made up")
    search = begin(campaign, base, [], [], Criteria())
    explore(search)
    assert search.best is search.base
    assert list(search.visited) == [frozenset()]


def claims(status: str, *shares: tuple[str, float]) -> tuple[Claim, ...]:
    """Elements of a model with the shares of the excess that they take."""
    return tuple(Claim(effect(n), status, 0.5, (), None, share) for n, share in shares)


@pytest.mark.parametrize(
    ("word", "told", "places", "detail"),
    [
        (UNKNOWN, claims(PROVISIONAL, ("coulomb_friction", 0.1), ("sensor_lag", 0.8)), ("sensor",), "lag or play"),
        (NAMED, claims(NAMED, ("coulomb_friction", 0.2), ("creep", 0.8)), ("mechanical",), "dissipative"),
        (NAMED, claims(NAMED, ("creep", 0.8), ("sensor_lag", 0.2)), ("mechanical", "sensor"), "memory"),
        (UNKNOWN, (), ("coupling", "thermal"), "force against voltage"),
        (NONE, (), (), ""),
    ],
)
def test_elements_say_where_the_mismatch_is_and_functions_where_there_are_none(
    word: str, told: tuple[Claim, ...], places: tuple[str, ...], detail: str
) -> None:
    location = SimpleNamespace(name="coupling", tied=("thermal",), detail="force against voltage")
    stands: Any = SimpleNamespace(verdict=word, claims=told, location=None if word == NONE else location)
    stands.places = Diagnosis.places.func(stands)
    assert stands.places == places
    assert Diagnosis.detail.fget(stands) == detail  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def base() -> LinearisedFit:
    return campaigns.linearised("creep")


def fall_by_refit(linearised: LinearisedFit, columns: np.ndarray) -> float:
    """By how much χ² falls when columns join the model's own sensitivities in one least-squares problem."""
    fit = linearised.fit
    before = np.linalg.lstsq(fit.jacobian, fit.residual, rcond=None)[0]
    design = np.column_stack([fit.jacobian, columns])
    after = np.linalg.lstsq(design, fit.residual, rcond=None)[0]
    left = [fit.residual - fit.jacobian @ before, fit.residual - design @ after]
    return float(left[0] @ left[0] - left[1] @ left[1])


@pytest.mark.parametrize("name", ["delay", "quadratic_stiffness", "electrostriction"])
def test_the_predicted_fall_is_that_of_a_joint_least_squares_fit(base: LinearisedFit, name: str) -> None:
    candidate = effect(name)
    (found,) = Screen(base, [candidate], Criteria())(base)
    best = 0.0
    for point in candidate.grid(base.scales):
        column = direction(base, candidate, point)
        slope = float(column @ base.residual)
        if slope > 0.0 or not candidate.one_sided:
            best = max(best, fall_by_refit(base, column))
    assert found.fall == pytest.approx(best, rel=1e-3, abs=1e-3)


def test_the_concealed_effect_promises_most_and_stands_out(base: LinearisedFit) -> None:
    names = ["delay", "creep", "quadratic_drag", "sensor_nonlinearity", "quadratic_stiffness"]
    found = Screen(base, [effect(n) for n in names], Criteria())(base)
    assert found[0].effect.name == "creep"
    assert found[0].score > Criteria().score
    assert [c.fall for c in found] == sorted((c.fall for c in found), reverse=True)


def test_nothing_stands_out_where_nothing_is_missing() -> None:
    base = campaigns.linearised()
    names = ["delay", "creep", "quadratic_drag", "sensor_nonlinearity", "quadratic_stiffness", "mains_pickup"]
    found = Screen(base, [effect(n) for n in names], Criteria())(base)
    material = Criteria().material ** 2 * base.residual.size
    assert not [c.effect.name for c in found if c.score > Criteria().score and c.fall > material]


def test_a_further_copy_stands_in_the_screen_of_a_model_that_has_the_first(base: LinearisedFit) -> None:
    setup = base.fit.setup
    first, second, third = attached(effect("creep"), setup)
    values = {"k_s": 0.05 * setup.values()["k"], "tau_s": 0.3}
    grown = replace(base, fit=replace(base.fit, setup=first.add_to(setup, values)))
    screen = Screen(base, [first, second, third], Criteria())
    assert [c.effect for c in screen(base)] == [first]
    (found,) = screen(grown)
    assert found.effect == second
    assert found.fall == pytest.approx(screen(base)[0].fall)


WAVES = {
    "learned_wave_of_the_sensor": ("lambda_V", {"h_V1": 0.1, "h_V2": -0.05, "lambda_V": 2.5e-5}),
    "learned_wave_of_the_spring": ("lambda_E", {"F_E1": 0.02, "F_E2": 0.01, "lambda_E": 3e-5}),
}


@pytest.mark.parametrize("name", WAVES)
def test_what_repeats_along_the_position_is_found_with_its_period(name: str) -> None:
    length, values = WAVES[name]
    element, base = learned_elements()[name], campaigns.base()
    true = element.add_to(base.setup, values)
    made = [campaigns.recorded(true, r.name, r.t, r.u, r.noise, k) for k, r in enumerate(base.plan.recordings)]
    plan = replace(base.plan, recordings=tuple(made))
    linearised = prepare(fit(base.setup, plan, base.variables.names, base.held))
    assert wavelengths(linearised)[0] == pytest.approx(values[length], rel=0.05)
    (candidate,) = Screen(linearised, [element], Criteria())(linearised)
    assert candidate.values[length] == pytest.approx(values[length], rel=0.05)
    short = short_fit(linearised.fit, plan.coarse(), element, [candidate.values], 20)
    assert short is not None and short.chi2 == pytest.approx(1.0, abs=0.05)
    found = short.setup.values()
    assert all(found[n] == pytest.approx(v, rel=0.05) for n, v in values.items())


def test_nothing_repeats_where_nothing_is_missing() -> None:
    assert wavelengths(prepare(campaigns.base())) == []
