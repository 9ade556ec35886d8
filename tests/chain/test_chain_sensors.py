"""The blocks behind the network."""

from __future__ import annotations

import inspect

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from phnn.chain.sensors import LINEAR, SENSORS, drift, lag, midpoints, play, polynomial, rate, rectification
from phnn.laws.namespace import TINY

T = np.arange(601) * 1e-3
signals = arrays(np.float64, st.integers(5, 60), elements=st.floats(-10.0, 10.0))


def sine(frequency: float, amplitude: float = 1.0) -> np.ndarray:
    return amplitude * np.sin(2.0 * np.pi * frequency * T)


def test_drift_adds_a_ramp() -> None:
    np.testing.assert_allclose(drift(np.ones(3), np.array([0.0, 2.0, 4.0]), 0.5), [1.0, 2.0, 3.0])


def test_the_rate_of_a_parabola_is_exact_at_uneven_times() -> None:
    t = np.array([0.0, 0.3, 0.4, 0.9, 1.0])
    np.testing.assert_allclose(rate(1.0 + 2.0 * t - 3.0 * t**2, t), 2.0 - 6.0 * t, atol=1e-12)


def test_a_polynomial_and_a_rectifier_act_sample_by_sample() -> None:
    q = np.array([-2.0, 0.0, 3.0])
    np.testing.assert_allclose(polynomial(q, T[:3], 0.1, -0.2), [-2.0 + 0.4 + 1.6, 0.0, 3.0 + 0.9 - 5.4])
    np.testing.assert_array_equal(rectification(q, T[:3]), [2.0, 0.0, 3.0])


def test_midpoints_of_a_cubic_are_exact_and_of_a_sine_fourth_order() -> None:
    t = np.linspace(0.0, 1.0, 9)
    middle = 0.5 * (t[1:] + t[:-1])
    np.testing.assert_allclose(midpoints(t**3 - t, t), middle**3 - middle, atol=1e-14)
    errors = []
    for n in (21, 41, 81):
        t = np.linspace(0.0, 1.0, n)
        errors.append(np.abs(midpoints(np.sin(9.0 * t), t) - np.sin(9.0 * 0.5 * (t[1:] + t[:-1]))).max())
    assert errors[2] < errors[1] / 14.0 < errors[0] / 14.0**2
    np.testing.assert_array_equal(midpoints(np.array([1.0, 2.0]), np.array([0.0, 1.0])), [1.5])


@pytest.mark.parametrize("tau", [1e-7, 5e-4, 1.9e-3, 2.1e-3, 0.03, 5.0])
def test_the_lag_of_a_sine_has_its_closed_form(tau: float) -> None:
    omega = 2.0 * np.pi * 20.0
    y = lag(sine(20.0), T, tau)
    z = omega * tau
    wanted = (np.sin(omega * T) - z * np.cos(omega * T) + z * np.exp(-T / tau)) / (1.0 + z**2)
    # Fifty samples a period; a straight line between them would be wrong by 1e-3.
    np.testing.assert_allclose(y, wanted, atol=1e-5)


@pytest.mark.parametrize("tau", [1e-4, 1.9e-3, 2.1e-3, 0.1])
def test_the_lag_of_a_parabola_is_exact(tau: float) -> None:
    q = 1.0 + T + 40.0 * T**2
    # Settled at the first sample: 1.
    slope, square = 1.0, 40.0
    gone = 1.0 - np.exp(-T / tau)
    wanted = 1.0 + slope * (T - tau * gone) + square * (T**2 - 2.0 * tau * T + 2.0 * tau**2 * gone)
    np.testing.assert_allclose(lag(q, T, tau), wanted, rtol=1e-11)


@settings(max_examples=50, deadline=None)
@given(signals, st.floats(1e-5, 1.0))
def test_a_lag_is_linear_and_keeps_a_constant(q: np.ndarray, tau: float) -> None:
    t = T[: q.size]
    np.testing.assert_allclose(lag(2.0 * q - 3.0, t, tau), 2.0 * lag(q, t, tau) - 3.0, atol=1e-9)


def test_play_cuts_what_turns_round_between_samples() -> None:
    width = 0.2
    for frequency in (7.3, 19.0, 41.7):
        y = play(sine(frequency), T, width)
        later = y[1.0 / frequency < T]
        period = 2.0 * np.pi * frequency * 1e-3
        # The samples themselves miss a peak by up to an eighth of the square of their phase step.
        np.testing.assert_allclose([later.max(), later.min()], [0.8, -0.8], atol=0.02 * period**3)
    # On the way up from its first plateau it hangs behind by the width.
    rising = (T > 0.0) & (T < 1.0 / (4.0 * 19.0)) & (sine(19.0) > width)
    np.testing.assert_allclose(play(sine(19.0), T, width)[rising], sine(19.0)[rising] - width, atol=1e-12)


@settings(max_examples=100, deadline=None)
@given(signals, st.floats(0.0, 5.0))
def test_play_stays_within_its_width_and_does_not_know_time(q: np.ndarray, width: float) -> None:
    t = T[: q.size]
    y = play(q, t, width)
    assert (np.abs(q - y) <= width + 1e-12).all()
    assert y[0] == q[0]
    np.testing.assert_allclose(y, play(q, 128.0 * t, width), atol=1e-12)
    np.testing.assert_allclose(play(-q, t, width), -y, atol=1e-12)
    if np.ptp(q) == 0.0:
        np.testing.assert_allclose(y, q, atol=1e-12)


def test_wide_play_shows_nothing_and_none_shows_all() -> None:
    assert (play(sine(20.0), T, 2.0) == 0.0).all()
    np.testing.assert_array_equal(play(sine(20.0), T, 0.0), sine(20.0))


def test_a_fast_clock_reads_a_sine_too_early_and_a_drifting_gain_scales_it() -> None:
    y = SENSORS["clock"](sine(11.0), T, 0.02, 1.0)
    np.testing.assert_allclose(y, np.sin(2.0 * np.pi * 11.0 * 0.98 * T), atol=1e-6)
    y = SENSORS["drifting_gain"](sine(11.0), T, 0.3, -0.1, 0.5)
    s = np.minimum(T / 0.5, 1.0)
    np.testing.assert_allclose(y, sine(11.0) * (1.0 + 0.3 * s - 0.1 * s**2), atol=1e-15)


def test_a_slow_clock_holds_what_it_knows_beyond_the_last_sample() -> None:
    found = SENSORS["clock"](sine(11.0), T, -0.5, 1.0)
    assert np.abs(found).max() < 1.5
    late = 2.0 * T[-1] - T[-2] < 1.5 * T
    assert np.unique(found[late]).size == 1
    stepped = SENSORS["clock"](sine(11.0), T, complex(-0.5, 1e-20), 1.0)
    assert np.array_equal(np.real(stepped), found)
    assert not np.imag(stepped[late]).any()


VALUES = {"drift": (0.3,), "lag": (4e-3,), "polynomial": (0.3, -0.2), "rectification": (), "play": (0.15,),
          "knee": (0.3, 0.4), "rate": (), "zero": (0.3,), "cubic": (0.1, -0.08, 0.7),
          "clock": (0.02, 0.6), "drifting_gain": (0.1, -0.05, 0.6)}  # fmt: skip


@pytest.mark.parametrize("kind", SENSORS)
def test_complex_steps_along_columns_are_directional_derivatives(kind: str) -> None:
    block, values = SENSORS[kind], VALUES[kind]
    q, t = (sine(11.0) + 0.4 * sine(29.0) + 0.1)[:, None], T[:, None]
    along = np.column_stack([np.cos(31.0 * T), np.sin(97.0 * T), np.ones(T.size)])
    got = np.imag(block(q + 1j * TINY * along, t, *values)) / TINY
    step = 1e-6
    wanted = (block(q + step * along, t, *values) - block(q - step * along, t, *values)) / (2.0 * step)
    # A kink may lie between the ends of a difference.
    wrong = np.abs(got - wanted) > 1e-6 * np.abs(wanted).max()
    assert wrong.mean() < 0.01
    np.testing.assert_array_equal(np.real(block(q + 0j, t, *values)), block(q, t, *values))


@pytest.mark.parametrize("kind", SENSORS)
def test_complex_steps_by_every_parameter_are_its_derivatives(kind: str) -> None:
    block, values = SENSORS[kind], VALUES[kind]
    q = sine(11.0) + 0.4 * sine(29.0)
    for k, value in enumerate(values):
        got = np.imag(block(q, T, *(complex(v, TINY * (i == k)) for i, v in enumerate(values)))) / TINY
        step = 1e-6 * abs(value)
        ends = [block(q, T, *(v + s * (i == k) for i, v in enumerate(values))) for s in (step, -step)]
        wanted = (ends[0] - ends[1]) / (2.0 * step)
        assert (np.abs(got - wanted) > 1e-6 * np.abs(wanted).max()).mean() < 0.01
        assert np.abs(wanted).max() > 0.0


def test_every_block_is_tested() -> None:
    assert set(VALUES) == set(SENSORS)


@settings(max_examples=20, deadline=None)
@given(signals, st.sampled_from(LINEAR))
def test_changes_pass_a_linear_block_like_the_signal_itself(q: np.ndarray, kind: str) -> None:
    law, t = SENSORS[kind], T[: q.size]
    values = [2e-3] * (len(inspect.signature(law).parameters) - 2)
    change = np.cos(np.arange(q.size))
    by_step = np.imag(law(q + 1j * TINY * change, t, *values)) / TINY
    np.testing.assert_allclose(law(change, t, *values), by_step, atol=1e-12 * max(np.abs(by_step).max(), 1.0))
