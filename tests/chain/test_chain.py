"""The blocks before and behind the network."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import solve_ivp

from phnn.chain.amplifiers import (
    SENSORS,
    bouc_wen,
    delay,
    lowpass,
    saturation,
    second_order_lowpass,
    slew_limit,
    slipping,
    soft_saturation,
)
from phnn.chain.sensors import clock, drifting_gain, lag, midpoints, play, rate
from phnn.laws.namespace import TINY
from phnn.models.actuator import TABLE_2
from phnn.signals.reconstruct import mean_input

H = np.full(400, 1e-3)
NODES = np.concatenate([[0.0], np.cumsum(H)])
FINE_T = np.column_stack([NODES[:-1], NODES[:-1] + 0.5e-3, NODES[1:]])


def command(t: Any) -> Any:
    """Reversals at several amplitudes, from 3 V."""
    return 3.0 + 40.0 * np.sin(2 * np.pi * 7.0 * t) * (0.3 + t) + 15.0 * np.sin(2 * np.pi * 19.0 * t)


def slope(t: float) -> float:
    return float(np.imag(command(complex(t, TINY))) / TINY)


@pytest.mark.parametrize("tau", [1e-6, 2e-3, 0.05, 30.0])
@pytest.mark.parametrize("zeta", [0.2, 0.999999, 1.0, 1.000001, 4.0, 600.0])
def test_second_order_lowpass_solves_its_equation(tau: float, zeta: float) -> None:
    got = second_order_lowpass(command(FINE_T), H, 3.0, tau, zeta)

    def change(t: float, v: Any) -> list[float]:
        return [v[1] / tau, (command(t) - v[0] - 2.0 * zeta * v[1]) / tau]

    exact = solve_ivp(change, (0.0, 0.4), [3.0, 0.0], "LSODA", FINE_T[:, 1], rtol=1e-9, atol=1e-9).y[0]
    assert np.abs(got[:, 1] - exact).max() < 1e-2
    np.testing.assert_allclose(got[1:, 0], got[:-1, 2], rtol=1e-14)


@pytest.mark.parametrize("zeta", [0.3, 1.0 - 1e-9, 1.0 + 1e-9, 2.0])
def test_derivatives_of_a_second_order_lowpass_around_critical_damping(zeta: float) -> None:
    fine, step = command(FINE_T), 1e-5
    got = np.imag(second_order_lowpass(fine, H, 3.0, 2e-3, complex(zeta, TINY))) / TINY
    ends = [second_order_lowpass(fine, H, 3.0, 2e-3, zeta + s) for s in (step, -step)]
    wanted = (ends[0] - ends[1]) / (2.0 * step)
    np.testing.assert_allclose(got, wanted, atol=1e-6 * np.abs(wanted).max())


@pytest.mark.parametrize("tau", [1e-6, 2e-3, 0.05, 30.0])
def test_lowpass_is_exact_for_a_ramp_and_after_a_jump(tau: float) -> None:
    t = FINE_T
    ramp = lowpass(3.0 + 5.0 * t, H, 3.0, tau)
    np.testing.assert_allclose(ramp, 3.0 + 5.0 * (t - tau * (1.0 - np.exp(-t / tau))), atol=1e-12)
    jump = lowpass(np.ones_like(t), H, 0.0, tau)
    np.testing.assert_allclose(jump, 1.0 - np.exp(-t / tau), atol=1e-12)


@pytest.mark.parametrize(
    ("beta", "gamma"), [(TABLE_2["beta"], TABLE_2["gamma"]), (0.05, 0.02), (0.02, 0.02), (0.03, -0.02), (1e-7, 0.0)]
)
def test_bouc_wen_solves_equation_19(beta: float, gamma: float) -> None:
    a, weight = TABLE_2["A"], TABLE_2["K_h"] / TABLE_2["K_v"]
    fine = command(FINE_T)
    got = (fine - bouc_wen(fine, H, 3.0, a, beta, gamma, weight)) / weight

    def rate(t: float, h: np.ndarray) -> list[float]:
        v = slope(t)
        return [a * v - beta * abs(v) * h[0] - gamma * abs(h[0]) * v]

    exact = solve_ivp(rate, (0.0, 0.4), [0.0], "DOP853", FINE_T[:, 1], rtol=1e-9, atol=1e-12, max_step=2e-3).y[0]
    # A reversal inside a sub-step is the only approximation.
    assert np.abs(got[:, 1] - exact).max() < 1e-3 * np.abs(exact).max()


def test_bouc_wen_does_not_depend_on_the_rate() -> None:
    args = (TABLE_2["A"], TABLE_2["beta"], TABLE_2["gamma"], 40.0)
    fine = command(FINE_T)
    np.testing.assert_array_equal(bouc_wen(fine, H, 3.0, *args), bouc_wen(fine, 100.0 * H, 3.0, *args))
    # A monotone stretch in one step or in many is the same.
    rise = np.linspace(0.0, 60.0, 801)
    many = np.column_stack([rise[:-2:2], rise[1:-1:2], rise[2::2]])
    once = np.array([[0.0, 30.0, 60.0]])
    assert bouc_wen(once, H[:1], 0.0, *args)[0, 2] == pytest.approx(bouc_wen(many, H, 0.0, *args)[-1, 2], rel=1e-12)


def test_a_soft_limit_is_reached_as_rapp_says_and_a_very_sharp_one_clips() -> None:
    fine = command(FINE_T)
    got = soft_saturation(fine, H, 3.0, 12.5, 3.0)
    np.testing.assert_allclose(got, fine / (1.0 + np.abs(fine / 12.5) ** 3) ** (1.0 / 3.0), rtol=1e-13)
    clipped = saturation(fine, H, 3.0, 12.5)
    np.testing.assert_array_equal(clipped, np.clip(fine, -12.5, 12.5))
    np.testing.assert_allclose(soft_saturation(fine, H, 3.0, 12.5, 1e5), clipped, rtol=1e-5)
    np.testing.assert_array_equal(soft_saturation(np.zeros((2, 3)), H[:2], 0.0, 12.5, 3.0), 0.0)


@pytest.mark.parametrize("tau", [0.0, 3e-4, 1e-3, 0.0123, 0.1, 1.0])
def test_a_delayed_signal_is_what_it_was(tau: float) -> None:
    got = delay(command(FINE_T), H, 3.0, tau)
    wanted = np.where(tau > FINE_T, 3.0, command(FINE_T - tau))
    # Between its points the signal is a parabola a step.
    np.testing.assert_allclose(got, wanted, atol=2e-3)
    assert np.abs(command(FINE_T) - got).max() >= 10.0 * tau


def test_a_delayed_jump_stays_sharp() -> None:
    fine = np.where(FINE_T < 0.1, 0.0, 1.0)
    fine[99, 2], fine[100, 0] = 0.0, 1.0
    # Onto a node: one value before, another after it.
    onto = delay(fine, H, 0.0, 0.05)
    np.testing.assert_array_equal(onto, np.where(np.arange(400)[:, None] < 150, 0.0, 1.0) * np.ones(3))
    # Into a step: only that step has both values, and its mean is the share of it that lies behind the jump.
    into = delay(fine, H, 0.0, 0.05 + 0.3e-3)
    assert ((into == 0.0) | (into == 1.0))[np.arange(400) != 150].all()
    assert (into[150, 0], into[150, 2]) == (0.0, 1.0)
    assert mean_input(into)[150] == pytest.approx(0.7)


@settings(max_examples=50, deadline=None)
@given(
    levels=st.lists(st.floats(-50.0, 50.0), min_size=400, max_size=400), before=st.floats(-50.0, 50.0),
    tau=st.floats(0.0, 0.3),
)  # fmt: skip
def test_a_delay_loses_no_area_whatever_jumps(levels: list[float], before: float, tau: float) -> None:
    steps = np.array(levels)[:, None] * np.ones(3)
    kept = np.concatenate([[0.0], np.cumsum(H * steps[:, 0])])
    wanted = before * tau + np.interp(0.4 - tau, NODES, kept)
    assert mean_input(delay(steps, H, before, tau)) @ H == pytest.approx(wanted, abs=1e-9)


def test_a_delay_knows_steps_of_any_size() -> None:
    h = np.where(np.arange(400) % 3 == 0, 1e-4, 1.45e-3)
    starts = np.cumsum(h) - h
    t = starts[:, None] + h[:, None] * np.array([0.0, 0.5, 1.0])
    got = delay(command(t), h, 3.0, 5e-3)
    np.testing.assert_allclose(got, np.where(t < 5e-3, 3.0, command(t - 5e-3)), atol=1e-2)


def test_a_slew_limit_follows_what_it_can() -> None:
    fine = command(FINE_T)
    fast = np.abs(np.diff(fine, axis=1)).max() / 0.5e-3
    np.testing.assert_allclose(slew_limit(fine, H, 3.0, 1.01 * fast), fine, atol=1e-9)
    limited = slew_limit(fine, H, 3.0, 0.3 * fast)
    assert np.abs(np.diff(limited, axis=1)).max() <= 0.3 * fast * 0.5e-3 * (1.0 + 1e-9)
    np.testing.assert_array_equal(limited[1:, 0], limited[:-1, 2])
    # What obeys the limit passes through it.
    np.testing.assert_allclose(slew_limit(limited, H, 3.0, 0.3 * fast), limited, atol=1e-9)


def test_a_slew_limit_makes_a_jump_a_ramp_and_a_large_sine_a_triangle() -> None:
    jump = slew_limit(np.full((400, 3), 2.0), H, 0.0, 10.0)
    np.testing.assert_allclose(jump, np.minimum(10.0 * FINE_T, 2.0), atol=1e-12)
    rate, frequency = 1000.0, 20.0
    sine = slew_limit(100.0 * np.sin(2.0 * np.pi * frequency * FINE_T), H, 0.0, rate)
    last = sine[FINE_T[:, 1] > 0.35]
    # It always rises or falls at the limit; half a period each way.
    np.testing.assert_allclose(np.abs(np.diff(last[:, ::2], axis=1)).max(), rate * 1e-3)
    assert np.ptp(last) == pytest.approx(rate * 0.5 / frequency, rel=0.02)


def test_a_slipping_state_is_that_of_its_equation() -> None:
    weight, travel, exponent, back, lean = 5.0, 8.0, 1.4, 0.3, 0.2

    def rate(t: float, s: np.ndarray) -> np.ndarray:
        speed = 2.0 * np.pi * 20.0 * np.cos(2.0 * np.pi * 3.0 * t)
        strain = abs(s / (1.0 + lean * np.sign(speed))) ** exponent
        beta, gamma = 0.5 * (1.0 + back), 0.5 * (1.0 - back)
        return np.asarray((speed - beta * abs(speed) * strain * np.sign(s) - gamma * speed * strain) / travel)

    t = FINE_T
    u = 20.0 / 3.0 * np.sin(2.0 * np.pi * 3.0 * t)
    true = solve_ivp(rate, (0.0, t[-1, 2]), [0.0], method="Radau", t_eval=t[:, 0], rtol=1e-9, atol=1e-11, max_step=1e-3)
    got = (u - slipping(u, H, 0.0, weight, travel, exponent, back, lean)) / weight
    np.testing.assert_allclose(got[:, 0], true.y[0], atol=2e-4)


T = np.arange(601) * 1e-3
signals = arrays(np.float64, st.integers(5, 60), elements=st.floats(-10.0, 10.0))


def sine(frequency: float, amplitude: float = 1.0) -> np.ndarray:
    return amplitude * np.sin(2.0 * np.pi * frequency * T)


def test_the_rate_of_a_parabola_is_exact_at_uneven_times() -> None:
    t = np.array([0.0, 0.3, 0.4, 0.9, 1.0])
    np.testing.assert_allclose(rate(1.0 + 2.0 * t - 3.0 * t**2, t), 2.0 - 6.0 * t, atol=1e-12)


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
    y = clock(sine(11.0), T, 0.02, 1.0)
    np.testing.assert_allclose(y, np.sin(2.0 * np.pi * 11.0 * 0.98 * T), atol=1e-6)
    y = drifting_gain(sine(11.0), T, 0.3, -0.1, 0.2, 0.5)
    s = np.minimum(T / 0.5, 1.0)
    np.testing.assert_allclose(
        y, sine(11.0) * (1.0 + 0.3 * s - 0.1 * s**2 + 0.2 * np.log1p(300.0 * s) / np.log(301.0)), atol=1e-15
    )


def test_a_slow_clock_holds_what_it_knows_beyond_the_last_sample() -> None:
    found = clock(sine(11.0), T, -0.5, 1.0)
    assert np.abs(found).max() < 1.5
    late = 2.0 * T[-1] - T[-2] < 1.5 * T
    assert np.unique(found[late]).size == 1
    stepped = clock(sine(11.0), T, complex(-0.5, 1e-20), 1.0)
    assert np.array_equal(np.real(stepped), found)
    assert not np.imag(stepped[late]).any()


VALUES_SENSORS = {"drift": (0.3,), "lag": (4e-3,), "polynomial": (0.3, -0.2), "rectification": (), "play": (0.15,),
          "knee": (0.3, 0.4), "rate": (), "zero": (0.3,), "cubic": (0.1, -0.08, 0.7),
          "wave": (0.4, -0.3, 0.5), "clock": (0.02, 0.6), "drifting_gain": (0.1, -0.05, 0.03, 0.6)}  # fmt: skip


@pytest.mark.parametrize("kind", SENSORS)
def test_complex_steps_along_columns_are_directional_derivatives(kind: str) -> None:
    block, values = SENSORS[kind].law, VALUES_SENSORS[kind]
    q, t = (sine(11.0) + 0.4 * sine(29.0) + 0.1)[:, None], T[:, None]
    along = np.column_stack([np.cos(31.0 * T), np.sin(97.0 * T), np.ones(T.size)])
    got = np.imag(block(q + 1j * TINY * along, t, *values)) / TINY
    step = 1e-6
    wanted = (block(q + step * along, t, *values) - block(q - step * along, t, *values)) / (2.0 * step)
    # A kink may lie between the ends of a difference.
    wrong = np.abs(got - wanted) > 1e-6 * np.abs(wanted).max()
    assert wrong.mean() < 0.01
    np.testing.assert_array_equal(np.real(block(q + 0j, t, *values)), block(q, t, *values))


@settings(max_examples=20, deadline=None)
@given(signals, st.sampled_from([name for name, kind in SENSORS.items() if kind.linear]))
def test_changes_pass_a_linear_block_like_the_signal_itself(q: np.ndarray, kind: str) -> None:
    law, t = SENSORS[kind].law, T[: q.size]
    values = [2e-3] * (len(inspect.signature(law).parameters) - 2)
    change = np.cos(np.arange(q.size))
    by_step = np.imag(law(q + 1j * TINY * change, t, *values)) / TINY
    np.testing.assert_allclose(law(change, t, *values), by_step, atol=1e-12 * max(np.abs(by_step).max(), 1.0))
