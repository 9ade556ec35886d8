"""Inputs that jump between samples: groups of instants, exact derivatives, and their estimation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from junctions import recording as made

from phnn.configuration import config_folder
from phnn.derivatives import output_derivatives
from phnn.effects import effect
from phnn.identification.evaluate import evaluate
from phnn.identification.fit import fit
from phnn.identification.plan import Plan
from phnn.models import from_paper
from phnn.models.network_file import load_network
from phnn.prediction import output_spread
from phnn.recordings.excitation import driving_of, instants_known, unknown_instants
from phnn.recordings.recording import Part, Recording, Start
from phnn.setup import Setup
from phnn.trajectory import simulate

DT = 1e-4


def recording(u: np.ndarray, dt: float = DT, name: str = "steps", interpolation: str = "cubic") -> Recording:
    t, rest = dt * np.arange(u.size), Start("rest", 0.0)
    return made(t, u, rest, "identification", name=name, y=0.0 * u, interpolation=interpolation, noise=5e-8)


def steps_at(t: np.ndarray, *instants: float) -> np.ndarray:
    return 60.0 * (t >= instants[0]) - 25.0 * (t >= instants[1])


@given(
    instants=st.tuples(st.floats(0.05, 0.95), st.floats(0.05, 0.95)), chain=st.sampled_from(["", "amplifier_lowpass"])
)
@settings(deadline=None, max_examples=8)
def test_derivatives_by_instants_are_exact(instants: tuple[float, float], chain: str) -> None:
    setup = Setup(from_paper())
    if chain:
        law = effect(chain)
        setup = law.add_to(setup, dict.fromkeys(law.parameters, 0.0003))
    u = steps_at(DT * np.arange(1200), 0.02005, 0.06005)
    at = np.array(instants)
    here = replace(recording(u), instants=at)
    exact = output_derivatives(simulate(setup, here, 2), ["k"], instants=True)
    assert exact.shape == (1200, 3)
    for g in (0, 1):
        step = np.eye(2)[g] * 1e-6
        up, down = (simulate(setup, replace(here, instants=at + s), 2).y for s in (step, -step))
        change = (up - down) / 2e-6
        # The instant moves the output by tens of micrometres a sample.
        assert np.abs(change).max() > 5e-6
        np.testing.assert_allclose(exact[:, 1 + g], change, atol=2e-6 * np.abs(change).max())


def test_a_jump_between_samples_is_simulated_as_on_a_grid_that_contains_it() -> None:
    setup = Setup(from_paper())
    fine = 2e-6 * np.arange(100_000)
    held = recording(steps_at(fine, 0.020_036 - 1e-9, 0.080_082 - 1e-9), 2e-6, interpolation="zero_order")
    truth = simulate(setup, held, 1).y[::50]
    coarse = recording(steps_at(DT * np.arange(2000), 0.020_036, 0.080_082))
    found = simulate(setup, replace(coarse, instants=np.array([0.36, 0.82])), 4).y
    assert np.abs(found - truth).max() < 3e-9
    # What the samples alone say is wrong by micrometres.
    assert np.abs(simulate(setup, coarse, 4).y - truth).max() > 5e-6


def test_instants_are_estimated_with_the_parameters_and_for_a_held_out_recording() -> None:
    setup, rng = Setup(from_paper()), np.random.default_rng(5)
    u = steps_at(DT * np.arange(3000), 0.020_05, 0.150_05)
    drawn = np.array([0.27, 0.61])

    def measured(name: str) -> Recording:
        known = replace(recording(u, name=name), instants=drawn)
        return replace(known, y=simulate(setup, known, 4).y + 5e-8 * rng.standard_normal(u.size), instants=None)

    seen, other = measured("seen"), measured("other")
    begun = setup.with_values({"k": 1.02 * setup.parameters["k"].value, "b": 0.9 * setup.parameters["b"].value})
    found = fit(begun, Plan((seen,), {"seen": 4}), ["k", "b"])
    assert found.chi2 == pytest.approx(1.0, abs=0.1)
    estimated = found.plan.recordings[0].instants
    assert estimated is not None
    np.testing.assert_allclose(estimated, drawn, atol=5e-3)
    assert instants_known(found.plan.recordings[0])
    # A fit goes on from them, and they cost a column each.
    again = fit(found.setup, found.plan, ["k", "b"])
    assert again.evaluations < found.evaluations
    assert again.jacobian.shape[1] == 4
    held_out = replace(other, parts=(Part("other", 0, 3000, "confirmation"),))
    scores = evaluate(found.setup, Plan((held_out,), {"other": 4}), {})
    assert scores.over_noise("confirmation") == pytest.approx(1.0, abs=0.1)


def test_only_a_smooth_input_has_jumps_of_unknown_instants() -> None:
    u = steps_at(DT * np.arange(600), 0.01, 0.02)
    assert unknown_instants(recording(u)).size == 2
    for interpolation in ("linear", "zero_order", "band_limited"):
        assert unknown_instants(replace(recording(u), interpolation=interpolation)).size == 0


def test_jumps_of_one_phase_share_an_instant_and_so_do_very_many() -> None:
    wave = np.tile(np.repeat([0.0, 10.0], 50), 8)
    periodic = replace(recording(wave), period=100 * DT)
    assert driving_of(periodic, 1).group.tolist() == [1, 0] * 7 + [1]
    # In a steady cycle the wrap-around is a jump, too.
    cyclic = replace(periodic, start=Start("periodic"))
    assert set(driving_of(cyclic, 1).group.tolist()) == {0, 1}
    assert unknown_instants(recording(wave)).size == 15
    many = np.repeat(np.random.default_rng(0).uniform(0.0, 50.0, 60), 20)
    assert unknown_instants(recording(many)).size == 1


def test_a_start_with_a_jump_has_an_unknown_instant_before_the_first_sample() -> None:
    setup = Setup(from_paper())
    begun = recording(np.full(1500, 60.0))
    assert unknown_instants(begun).tolist() == [1.0]
    held = simulate(setup, begun, 4).y
    assert held[0] == 0.0
    # A quarter of an interval before the first sample the same motion began, by a jump between two recorded samples.
    inside = recording(np.concatenate([[0.0, 0.0], np.full(1499, 60.0)]))
    for instant in (1.0, 0.75):
        found = simulate(setup, replace(begun, instants=np.array([instant])), 4).y
        known = simulate(setup, replace(inside, instants=np.array([instant])), 4).y
        np.testing.assert_allclose(found[:-1], known[2:], atol=1e-10)
    assert simulate(setup, replace(begun, instants=np.array([0.75])), 4).y[0] > 1e-8


def test_the_spread_of_a_prediction_is_that_of_jumps_anywhere_in_their_intervals() -> None:
    setup = Setup(from_paper())
    u = steps_at(DT * np.arange(900), 0.02, 0.05)
    unmeasured = replace(recording(u), y=np.full(u.size, np.nan))
    spread = output_spread(setup, unmeasured, 2)
    assert spread is not None
    draws = np.random.default_rng(0).uniform(0.0, 1.0, (200, 2))
    assumed = simulate(setup, unmeasured, 2).y
    errors = np.array([simulate(setup, replace(unmeasured, instants=d), 2).y for d in draws]) - assumed
    drawn = np.sqrt(np.mean(errors**2, axis=0))
    where = drawn > 0.3 * drawn.max()
    np.testing.assert_allclose(spread[where], drawn[where], rtol=0.35)
    assert spread[:100].max() == 0.0
    measured = replace(unmeasured, y=simulate(setup, replace(unmeasured, instants=np.array([0.4, 0.7])), 2).y)
    estimated = output_spread(setup, measured, 2)
    assert estimated is not None
    assert estimated.max() < 1e-2 * spread.max()
    assert output_spread(setup, recording(np.sin(0.01 * np.arange(600.0))), 1) is None


def test_a_jump_outside_the_fitted_samples_does_not_stop_the_fit() -> None:
    setup, rng = Setup(from_paper()), np.random.default_rng(1)
    u = steps_at(DT * np.arange(2000), 0.020_05, 0.150_05)
    known = replace(recording(u), instants=np.array([0.3, 0.6]))
    parts = (Part("a", 0, 1200, "identification"), Part("b", 1300, 2000, "confirmation"))
    y = simulate(setup, known, 2).y + 5e-8 * rng.standard_normal(u.size)
    seen = replace(known, y=y, instants=None, parts=parts)
    begun = setup.with_values({"k": 1.1 * setup.parameters["k"].value, "b": 1.1 * setup.parameters["b"].value})
    found = fit(begun, Plan((seen,), {"steps": 2}), ["k", "b"])
    assert found.chi2 == pytest.approx(1.0, abs=0.15)
    assert found.evaluations < 25
    # The held-out part places its own jump.
    assert not instants_known(found.plan.recordings[0])
    assert evaluate(found.setup, found.plan, {}).over_noise("confirmation") == pytest.approx(1.0, abs=0.15)


def test_jumps_are_placed_where_nothing_rests() -> None:
    # A mass without a spring has no rest under a force; a square wave drives it from an unknown start.
    setup = Setup(load_network(config_folder() / "network" / "mass_damper.yaml"))
    u = 40.0 * np.sign(np.sin(0.02 * np.arange(600.0) + 0.3))
    spread = output_spread(setup, replace(recording(u), start=Start("unknown")), 1)
    assert spread is not None
    assert np.isfinite(spread).all()
