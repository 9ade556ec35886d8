"""Nuisances of recordings, the zero of an output, and samples at the limits of a sensor."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import campaigns
import numpy as np
import pytest
from effect_homes import EFFECTS, FORMULAS, LEARNED, SCALES, home
from junctions import differences, recording

from phnn.configuration import config_folder
from phnn.derivatives import output_derivatives
from phnn.effects import Effect, effect, in_all_forms
from phnn.errors import InputRefused
from phnn.identification.base import identify_base
from phnn.identification.evaluate import evaluate
from phnn.identification.fit import Fit, fit
from phnn.identification.plan import Options, Plan
from phnn.identification.problem import (
    Problem,
    beyond_limit,
    drift_columns,
    line_columns,
    own_columns,
    own_size,
    variables_of,
    without_nuisances,
)
from phnn.models.actuator import from_paper
from phnn.models.network_file import load_network
from phnn.models.store import load, save
from phnn.recordings import read
from phnn.recordings.recording import Anchor, Campaign, Part, Recording, Sensor, Start
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


NETWORK = config_folder() / "network" / "mass_spring_damper.yaml"
MODEL, ZERO, ZERO_NOISE = Setup(load_network(NETWORK)), 0.05, 1e-3


def answer(seed: int, count: int, zero: float, noise: float) -> Recording:
    """A noisy response to so many random forces, each of ten samples."""
    rng = np.random.default_rng(seed)
    force = np.repeat(rng.uniform(-1.0, 1.0, count), 10)
    t = 0.05 * np.arange(force.size)
    blank = recording(t, force, Start("rest", force[0]), interpolation="zero_order")
    y = simulate(MODEL, blank).y + zero + noise * rng.standard_normal(t.size)
    return replace(blank, name="a", y=y, noise=noise, parts=(Part("a", 0, t.size, "identification"),))


def zero_recorded(name: str, use: str, offset: str = "shared") -> Recording:
    run = answer(sum(map(ord, name)), 40, ZERO, ZERO_NOISE)
    return replace(run, name=name, offset=offset, parts=(Part(name, 0, run.t.size, use),))


def campaign(*recordings: Recording) -> Campaign:
    return Campaign(recordings, {"network": str(NETWORK)}, {}, "terminals", (), True, "made")


def test_a_shared_zero_is_estimated_once_and_predicts_what_is_held_out() -> None:
    held = zero_recorded("c", "confirmation")
    fitted, _ = identify_base(
        campaign(zero_recorded("a", "identification"), zero_recorded("b", "identification"), held),
        Options(workers=1, starts=1),
    )
    value, spread = fitted.setup.parameters["y_0"].value, fitted.std()["y_0"]
    assert abs(value - ZERO) < 4.0 * spread
    assert 0.5 < spread / (ZERO_NOISE / np.sqrt(800)) < 3.0
    plan = Plan((held,), workers=1)
    (score,) = evaluate(fitted.setup, plan, {}).parts
    assert score.residual_over_noise < 1.1
    moved = replace(held, y=held.y + 10.0 * ZERO_NOISE)
    (score,) = evaluate(fitted.setup, Plan((moved,), workers=1), {}).parts
    assert score.residual_over_noise == pytest.approx(10.0, rel=0.1)


def test_zeros_of_their_own_stay_out_of_the_model() -> None:
    fitted, _ = identify_base(campaign(zero_recorded("a", "identification", "own")), Options(workers=1, starts=1))
    assert set(fitted.setup.parameters) == set(MODEL.parameters)


def test_recordings_share_a_zero_all_or_none() -> None:
    mixed = campaign(zero_recorded("a", "identification"), zero_recorded("b", "identification", "own"))
    with pytest.raises(InputRefused, match="b has a zero of its own, a shares one"):
        identify_base(mixed, Options(workers=1))


def test_an_unknown_gain_of_the_input_is_estimated() -> None:
    run = zero_recorded("a", "identification", "own")
    halved = replace(run, u=0.5 * run.u, start=Start("rest", 0.5 * run.start.input_before), gain="unknown")
    known = replace(campaign(halved), known={"m": Anchor(MODEL.parameters["m"].value)})
    fitted, _ = identify_base(known, Options(workers=1, starts=1))
    assert fitted.setup.parameters["gamma_u"].value == pytest.approx(2.0, rel=0.01)
    assert fitted.setup.parameters["k"].value == pytest.approx(MODEL.parameters["k"].value, rel=0.01)
    with pytest.raises(InputRefused, match="takes up any factor"):
        identify_base(replace(known, setup={"model": "piezo_actuator"}, known={}), Options(workers=1))


def test_the_manifest_says_that_a_gain_is_unknown(tmp_path: Path) -> None:
    t = 1e-3 * np.arange(200)
    rows = np.column_stack([t, np.sin(40.0 * t), np.cos(40.0 * t)])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header="time_s,input_V,output_V", comments="")
    manifest = tmp_path / "recordings.yaml"
    manifest.write_text(f"setup: {{network: {NETWORK.name}}}\ncolumns: {{input: {{gain: unknown}}}}\n")
    (tmp_path / NETWORK.name).write_text(NETWORK.read_text())
    assert read(tmp_path).recordings[0].gain == "unknown"
    for wrong, words in (("input: {gain: maybe}", "gain: 'maybe' is not known"), ("output: {gain: unknown}", "'gain'")):
        manifest.write_text(f"columns: {{{wrong}}}\n")
        with pytest.raises(InputRefused, match=words):
            read(tmp_path)


def test_a_model_with_zero_and_gain_is_kept_by_a_file(tmp_path: Path) -> None:
    run = replace(zero_recorded("a", "identification"), gain="unknown")
    fitted, _ = identify_base(
        replace(campaign(run), known={"m": Anchor(MODEL.parameters["m"].value)}), Options(workers=1, starts=1)
    )
    save(fitted.setup, tmp_path, 1)
    again, _ = load(tmp_path)
    np.testing.assert_array_equal(simulate(again, run).y, simulate(fitted.setup, run).y)


_ALL = in_all_forms([*EFFECTS, *LEARNED, *FORMULAS])


@pytest.mark.parametrize("effect_", _ALL, ids=["-".join((e.name, *e.parameters)) for e in _ALL])
@pytest.mark.parametrize("time", [1e-7, 1e7])
def test_an_effect_can_be_placed_in_a_system_of_any_size_and_speed(effect_: Effect, time: float) -> None:
    base = home(effect_).setup
    for length in (1e-6, 1e6):
        for drive in (1e-6, 1e7):
            sizes = {"slowest": 1.0 / time, "fastest": 1.0 / time, "duration": time, "voltage": drive}
            sizes |= {"displacement": length, "velocity": length / time, "stiffness": drive / length, "noise": length}
            scales = replace(SCALES, **{n: getattr(SCALES, n) * size for n, size in sizes.items()})
            for values in effect_.grid(scales):
                effect_.add_to(base, values)
                effect_.add_to(base, effect_.scaled(values, 1e3))


def test_a_lag_of_a_minute_is_found_in_samples_every_four_seconds() -> None:
    name, parameter = "amplifier_lowpass", "tau_a"
    tanks = Setup(load_network(config_folder() / "network" / "tanks.yaml"))
    rng = np.random.default_rng(3)
    t = 4.0 * np.arange(400)
    u = 1e-4 * (1.0 + np.repeat(rng.uniform(-0.5, 0.5, 40), 10))
    blank = recording(t, u, Start("rest", 1e-4), interpolation="linear")
    true = effect(name).add_to(tanks, {parameter: 54.0})
    y = simulate(true, blank).y
    noise = 1e-4 * float(np.ptp(y))
    run = replace(
        blank, y=y + noise * rng.standard_normal(t.size), noise=noise, parts=(Part("a", 0, t.size, "identification"),)
    )
    found = fit(effect(name).add_to(tanks, {parameter: 0.05}), Plan((run,)), [parameter])
    assert found.chi2 < 1.3
    assert found.setup.parameters[parameter].value == pytest.approx(54.0, rel=0.02)


NAMES = ("k", "m", "b")


@cache
def censored(seed: int = 0, noise: float = 1e-3) -> Recording:
    """A noisy response to a random force, without limits."""
    return answer(seed, 80, 0.004, noise)


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
    run = censored()
    wide = replace(run, sensor=Sensor(saturates=(-1e3, 1e3), unit="m"))
    a, b = fitted(run), fitted(wide)
    np.testing.assert_array_equal(a.z, b.z)
    np.testing.assert_array_equal(a.residual, b.residual)


@pytest.mark.parametrize(("own", "factor"), [(Own(), 1.2), (Own((0.31,), 3), 0.7)])
def test_derivatives_are_those_of_the_censored_residual(factor: float, own: Own) -> None:
    run = clipped(censored())
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
    run = clipped(censored())
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
        run = clipped(censored(seed, 0.01), 0.35)
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
    run = clipped(censored())
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
    run = replace(censored(), sensor=sensor)
    found = simulate(MODEL, run, 8)
    derivatives = output_derivatives(found, NAMES)
    for i, name in enumerate(NAMES):
        difference = differences(MODEL, run, name, 8)
        close = np.abs(derivatives[:, i] - difference) <= 1e-4 * np.abs(difference).max()
        assert close.mean() > 0.99  # a corner of a rectifier has no derivative
    assert found.setup.free == MODEL.free


def test_the_rate_is_the_velocity() -> None:
    run = replace(censored(), sensor=Sensor(derivative=True))
    found = simulate(MODEL, run, 16)
    p = found.states[found.nodes, list(MODEL.network.state_names).index("p")] / MODEL.parameters["m"].value
    np.testing.assert_allclose(found.y[1:-1], p[1:-1], atol=2e-3 * np.abs(p).max())
