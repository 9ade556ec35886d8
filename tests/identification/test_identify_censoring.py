"""Samples at a limit of the sensor are censored, not dropped and not taken at their word."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from junctions import recording

from phnn.configuration import config_folder
from phnn.derivatives import output_derivatives
from phnn.identification.evaluate import evaluate
from phnn.identification.fit import Fit, fit
from phnn.identification.nuisances import beyond_limit
from phnn.identification.plan import Plan
from phnn.identification.problem import Problem, variables_of
from phnn.models.network_file import load_network
from phnn.recordings.recording import Part, Recording, Start
from phnn.recordings.sensor import Sensor
from phnn.setup import Own, Setup
from phnn.trajectory import simulate

MODEL = Setup(load_network(config_folder() / "network" / "mass_spring_damper.yaml"))
NAMES = ("k", "m", "b")
ZERO = 0.004


@cache
def recorded(seed: int = 0, noise: float = 1e-3) -> Recording:
    """A noisy response to a random force, without limits."""
    rng = np.random.default_rng(seed)
    t = 0.05 * np.arange(800)
    force = np.repeat(rng.uniform(-1.0, 1.0, 80), 10)
    blank = recording(t, force, Start("rest", force[0]), interpolation="zero_order")
    y = simulate(MODEL, blank).y + ZERO + noise * rng.standard_normal(t.size)
    return replace(blank, y=y, noise=noise, parts=(Part("a", 0, t.size, "identification"),))


def clipped(run: Recording, share: float = 0.5) -> Recording:
    """The same by a sensor whose range ends at a share of the largest output on both sides."""
    limits = (share * float(run.y.min()), share * float(run.y.max()))
    return replace(run, y=np.clip(run.y, *limits), sensor=Sensor(saturates=limits, unit="m"))


def moved(factor: float) -> Setup:
    return MODEL.with_values({n: factor * MODEL.parameters[n].value for n in NAMES})


def fitted(run: Recording) -> Fit:
    return fit(moved(1.3), Plan((run,), workers=1), NAMES)


def errors(found: Fit) -> np.ndarray:
    """Logarithms of the estimates over the true values."""
    return np.array([np.log(found.setup.parameters[n].value / MODEL.parameters[n].value) for n in NAMES])


def test_limits_that_nothing_reaches_change_nothing() -> None:
    run = recorded()
    wide = replace(run, sensor=Sensor(saturates=(-1e3, 1e3), unit="m"))
    a, b = fitted(run), fitted(wide)
    np.testing.assert_array_equal(a.z, b.z)
    np.testing.assert_array_equal(a.residual, b.residual)


@pytest.mark.parametrize("own", [Own(), Own((0.31,), 3)])
@pytest.mark.parametrize("factor", [1.0, 1.2, 0.7])
def test_derivatives_are_those_of_the_censored_residual(factor: float, own: Own) -> None:
    run = clipped(recorded())
    setup = replace(moved(factor), own=own)
    plan = Plan((run,), workers=1)
    problem = Problem(setup, plan, variables_of(setup, plan, NAMES))
    z = problem.variables.start(setup)
    for i in range(z.size):
        e = np.zeros(z.size)
        e[i] = 1e-7
        ends = [Problem(setup, plan, problem.variables).residual(z + s * e) for s in (1.0, -1.0)]
        steady = (ends[0] != 0.0) == (ends[1] != 0.0)
        assert np.sum(~steady) <= 1  # a sample that begins to count has no derivative
        difference = (ends[0] - ends[1]) / 2e-7
        got = problem.jacobian(z)[:, i]
        np.testing.assert_allclose(got[steady], difference[steady], atol=2e-5 * np.abs(got).max())


def test_a_sample_beyond_the_limit_counts_only_where_the_model_stays_short_of_it() -> None:
    run = clipped(recorded())
    upper = run.sensor.at_limit(run.y) == 1
    mask, model = run.mask("identification"), simulate(MODEL, run).y
    hidden = beyond_limit(run, model, mask)
    assert hidden is not None
    residual = run.y - model - np.mean((run.y - model)[~hidden])
    assert np.all(residual[hidden & upper] <= 0.0)
    assert np.all(residual[upper & ~hidden] > 0.0)
    assert hidden[upper].mean() > 0.9
    weak = beyond_limit(run, 0.1 * model, mask)
    assert weak is not None and not weak[upper].any()


def test_clipped_data_identify_better_than_what_is_left_without_them() -> None:
    squares = {"censored": 0.0, "dropped": 0.0, "taken": 0.0}
    for seed in range(6):
        run = clipped(recorded(seed, 0.01), 0.35)
        at = run.sensor.at_limit(run.y) != 0
        kept = np.flatnonzero(np.diff(np.concatenate(([1], at.astype(int), [1]))))
        parts = tuple(
            Part(f"a{a}", int(a), int(b), "identification") for a, b in zip(kept[::2], kept[1::2], strict=True)
        )
        variants = {
            "censored": run,
            "dropped": replace(run, parts=parts, sensor=Sensor()),
            "taken": replace(run, sensor=Sensor()),
        }
        for name, variant in variants.items():
            squares[name] += float(np.sum(errors(fitted(variant)) ** 2))
    assert squares["censored"] < 0.9 * squares["dropped"] < squares["taken"]


def test_scores_are_of_what_the_sensor_shows() -> None:
    run = clipped(recorded())
    (score,) = evaluate(MODEL, Plan((run,), workers=1), {}).parts
    assert 0.8 < score.residual_over_noise < 1.05
    (unknown,) = evaluate(MODEL, Plan((replace(run, sensor=Sensor()),), workers=1), {}).parts
    assert unknown.residual_over_noise > 5.0


@pytest.mark.parametrize(
    "sensor",
    [
        Sensor(rectified=True),
        Sensor(lag=0.3),
        Sensor(derivative=True),
        Sensor(rectified=True, lag=0.3, derivative=True),
    ],
)
def test_a_known_sensor_is_simulated_and_differentiated(sensor: Sensor) -> None:
    run = replace(recorded(), sensor=sensor)
    found = simulate(MODEL, run, 8)
    derivatives = output_derivatives(found, NAMES)
    for i, name in enumerate(NAMES):
        p = MODEL.parameters[name].value
        ends = [simulate(MODEL.with_values({name: p * (1.0 + s)}), run, 8).y for s in (1e-6, -1e-6)]
        difference = (ends[0] - ends[1]) / (2e-6 * p)
        close = np.abs(derivatives[:, i] - difference) <= 1e-4 * np.abs(difference).max()
        assert close.mean() > 0.99  # a corner of a rectifier has no derivative
    assert found.setup.free == MODEL.free


def test_the_rate_is_the_velocity() -> None:
    run = replace(recorded(), sensor=Sensor(derivative=True))
    found = simulate(MODEL, run, 16)
    p = found.states[found.nodes, list(MODEL.network.state_names).index("p")] / MODEL.parameters["m"].value
    np.testing.assert_allclose(found.y[1:-1], p[1:-1], atol=2e-3 * np.abs(p).max())
