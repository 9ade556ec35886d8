"""Zero and lines of a recording: taken out of what a model is asked to explain."""

from __future__ import annotations

from dataclasses import replace

import campaigns
import numpy as np
import pytest
from junctions import recording

from phnn.effects import effect
from phnn.identification.evaluate import evaluate
from phnn.identification.fit import fit
from phnn.identification.nuisances import (
    drift_columns,
    line_columns,
    own_columns,
    own_size,
    without_nuisances,
)
from phnn.identification.plan import Plan
from phnn.identification.problem import Problem, variables_of
from phnn.models.actuator import from_paper
from phnn.recordings.recording import Part, Recording
from phnn.setup import Own, Setup
from phnn.trajectory import simulate

BASE = Setup(from_paper())
NOISE = 2e-8
T = np.arange(1501) * 2e-4


def pickup(t: np.ndarray, phase: float) -> np.ndarray:
    return 4e-7 * np.cos(2.0 * np.pi * 50.0 * t + phase) + 1e-7 * np.sin(2.0 * np.pi * 150.0 * t - phase)


def recorded(name: str, frequency: float, phase: float) -> Recording:
    u = 60.0 * np.sin(2.0 * np.pi * frequency * T)
    found = campaigns.recorded(BASE, name, T, u, NOISE, seed=round(frequency))
    return replace(found, y=found.y + pickup(T, phase))


@pytest.fixture(scope="module")
def recordings() -> tuple[Recording, ...]:
    return recorded("slow", 11.0, 0.3), recorded("fast", 83.0, 2.1)


def test_columns_are_the_lines_that_a_recording_can_hold() -> None:
    some = recording(np.arange(100) * 1e-3, np.zeros(100))
    columns = line_columns(some, (50.0, 9.0, 50.0, 499.0, 500.0, 800.0))
    assert columns.shape == (100, 4)
    np.testing.assert_allclose(columns[:, 0], np.cos(2.0 * np.pi * 50.0 * some.t), atol=1e-12)
    np.testing.assert_allclose(columns[:, 3], np.sin(2.0 * np.pi * 499.0 * some.t), atol=1e-12)
    assert line_columns(some, ()).shape == (100, 0)


def test_nuisances_leave_nothing_of_themselves_and_the_rest_alone() -> None:
    some = recording(T, np.zeros(T.size))
    mask = (T > 0.033) & (T < 0.2)
    lines = (50.0, 100.0, 150.0)
    columns = np.column_stack([pickup(T, 0.7) + 3e-6, T**2])
    left = without_nuisances(columns, mask, some, Own(lines))
    assert left.shape == (mask.sum(), 2)
    np.testing.assert_allclose(left[:, 0], 0.0, atol=1e-19)
    span = np.column_stack([np.ones(T.size), line_columns(some, lines)])[mask]
    np.testing.assert_allclose(span.T @ left[:, 1], 0.0, atol=1e-12)
    best = span @ np.linalg.lstsq(span, T[mask] ** 2, rcond=None)[0]
    np.testing.assert_allclose(left[:, 1], T[mask] ** 2 - best, atol=1e-12)
    np.testing.assert_array_equal(without_nuisances(columns, mask, some), columns[mask] - columns[mask].mean(axis=0))
    assert without_nuisances(columns, np.zeros(T.size, dtype=bool), some, Own(lines)).shape == (0, 2)


def test_a_slow_drift_has_nothing_as_fast_as_the_drive() -> None:
    # Almost eleven periods of the drive: no half-cosine with as many as 22 half-periods.
    some = recorded("slow", 36.6, 0.0)
    assert drift_columns(some, 8).shape == (T.size, 8)
    assert drift_columns(some, 30).shape == (T.size, 21)
    np.testing.assert_allclose(drift_columns(some, 3)[:, 2], np.cos(3.0 * np.pi * T / (T.size * 2e-4)), atol=1e-12)
    assert drift_columns(some, 0).shape == (T.size, 0)
    for own in (Own(), Own((50.0, 1e9, 0.1)), Own((50.0,), 8), Own(drift_terms=30)):
        assert own_size(some, own) == own_columns(some, own).shape[1]
    # Where nothing drives, any course is the sensor's; a step gives no time to tell one.
    assert drift_columns(recording(T, np.zeros(T.size)), 8).shape == (T.size, 8)
    assert drift_columns(recording(T, 50.0 * (T > 0.1)), 8).shape == (T.size, 1)
    mask = np.ones(T.size, dtype=bool)
    walk = np.cumsum(np.random.default_rng(4).standard_normal(T.size))
    left = without_nuisances(walk, mask, some, Own(drift_terms=8))
    # Of a Wiener process all but Σ_{m>8} 1/m² of Σ 1/m² lies in the first eight half-cosines, on average.
    assert np.sum(left**2) < 0.2 * np.sum((walk - walk.mean()) ** 2)


def test_a_held_out_zero_from_less_than_a_period_is_not_that_of_the_lines() -> None:
    parts = (Part("r", 0, 20, "nuisance"), Part("r", 20, T.size, "confirmation"))
    true = simulate(BASE, recording(T, 75.0 * np.sin(2 * np.pi * 100.0 * T))).y
    some = replace(recording(T, 75.0 * np.sin(2 * np.pi * 100.0 * T)), y=true + pickup(T, 0.7) + 3e-6, parts=parts)
    noisy = effect("mains_pickup").add_to(BASE, {"f_m": 50.0})
    assert evaluate(noisy, Plan((some,), {}), {}).parts[0].rmse < 1e-9


def test_a_fit_with_lines_does_not_see_the_mains(recordings: tuple[Recording, ...]) -> None:
    plan = Plan(recordings, {r.name: 4 for r in recordings})
    noisy = effect("mains_pickup").add_to(BASE, {"f_m": 50.0})
    names = ("k", "b")
    blind, seeing = fit(BASE, plan, names), fit(noisy, plan, names)
    assert blind.chi2 > 50.0
    assert 0.9 < seeing.chi2 < 1.1
    # True to their standard errors, which a pickup of a hundredth of the output would exceed by far.
    for name in names:
        assert abs(seeing.setup.parameters[name].value - BASE.parameters[name].value) < 4.0 * seeing.std()[name]


def test_jacobian_and_residual_lose_the_same_lines(recordings: tuple[Recording, ...]) -> None:
    plan = Plan(recordings)
    noisy = effect("mains_pickup").add_to(BASE, {"f_m": 50.0})
    found = Problem(noisy, plan, variables_of(noisy, plan, ("k", "C_1")))
    z = found.variables.start(noisy)
    jacobian = found.jacobian(z)
    for i in range(2):
        e = 1e-4 * np.eye(2)[i]
        difference = (found.residual(z + e) - found.residual(z - e)) / 2e-4
        assert np.linalg.norm(jacobian[:, i] - difference) < 2e-2 * np.linalg.norm(difference)
    columns = line_columns(recordings[0], noisy.own.lines)
    size = np.linalg.norm(jacobian[: T.size], axis=0)
    np.testing.assert_allclose(columns.T @ jacobian[: T.size] / size, 0.0, atol=1e-9)
    np.testing.assert_allclose(columns.T @ found.residual(z)[: T.size], 0.0, atol=1e-7)


def test_every_part_is_scored_beside_the_lines_of_its_recording(recordings: tuple[Recording, ...]) -> None:
    parts = (Part("first", 0, 700, "identification"), Part("gap", 700, 760, "nuisance"),
             Part("second", 760, 1501, "confirmation"))  # fmt: skip
    run = replace(recordings[0], parts=parts)
    plan = Plan((run,), {run.name: 4})
    noisy = effect("mains_pickup").add_to(BASE, {"f_m": 50.0})
    with_lines, without = evaluate(noisy, plan, {}), evaluate(BASE, plan, {})
    for part in with_lines.parts:
        assert part.residual_over_noise == pytest.approx(1.0, abs=0.1)
    for part in without.parts:
        assert part.residual_over_noise > 5.0
    # In the outputs too.
    left = run.y - with_lines.outputs[run.name]
    assert np.std(left[760:]) == pytest.approx(NOISE, rel=0.1)
