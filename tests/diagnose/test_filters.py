"""Causal operators against scipy and against what defines them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import cont2discrete, dlsim, lfilter

from phnn.diagnose.locations import (
    integral_while_within,
    low_pass,
    play_operator,
    rate,
    rate_limited,
    resonator,
)

signals = st.integers(0, 10**6).map(lambda seed: np.cumsum(np.random.default_rng(seed).standard_normal(200)))


@pytest.mark.parametrize("tau", [1e-4, 3e-3, 1.0])
@pytest.mark.parametrize("before", [0.0, -2.0])
def test_low_pass_is_scipys(tau: float, before: float) -> None:
    x = np.random.default_rng(0).standard_normal(500)
    h = 1e-3
    a = np.exp(-h / tau)
    expected, _ = lfilter([1.0 - a], [1.0, -a], x, zi=[a * before])
    np.testing.assert_allclose(low_pass(x, np.full(x.size, h), tau, before), expected, atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(signals, st.floats(0.5, 40.0), st.floats(0.003, 0.7))
def test_resonator_is_an_oscillator_driven_by_a_held_signal(x: np.ndarray, frequency: float, ratio: float) -> None:
    # q'' + 2 ζ ω q' + ω² q = x has the two states of the resonator as linear combinations of q and q'.
    h, omega = 1e-3, 2.0 * np.pi * frequency
    free = np.array([[0.0, 1.0], [-(omega**2), -2.0 * ratio * omega]])
    exact = cont2discrete((free, np.array([[0.0], [1.0]]), np.eye(2), np.zeros((2, 1))), h)
    _, states, _ = dlsim((*exact[:4], h), np.append(x, 0.0))
    found = resonator(x, np.full(x.size, h), frequency, ratio)
    states = states[1:]
    weights, *_ = np.linalg.lstsq(found, states / np.abs(states).max(axis=0), rcond=None)
    np.testing.assert_allclose(found @ weights, states / np.abs(states).max(axis=0), atol=1e-8)


def test_a_resonator_turns_by_a_quarter_where_it_resonates() -> None:
    h, frequency, ratio = 1e-4, 50.0, 0.02
    t = h * np.arange(40_000)
    found = resonator(np.sin(2.0 * np.pi * frequency * t), np.full(t.size, h), frequency, ratio)[20_000:]
    # A sine is half of what turns with the pole, where |λ / (iω − λ)| is 1/ζ.
    np.testing.assert_allclose(np.abs(found).max(axis=0), 0.5 / ratio * np.ones(2), rtol=0.1)


@settings(max_examples=30, deadline=None)
@given(signals, st.floats(0.01, 20.0))
def test_play_follows_within_its_radius_and_knows_no_rate(x: np.ndarray, radius: float) -> None:
    y = play_operator(x, radius)
    assert np.abs(x - y).max() <= radius * (1 + 1e-12) + 1e-12
    np.testing.assert_array_equal(play_operator(np.repeat(x, 3), radius)[2::3], y)
    np.testing.assert_allclose(play_operator(-x, radius), -y, atol=0)
    # It moves only with its input, and only while the input pushes it.
    moves, pushes = np.diff(y), np.diff(x)
    assert (moves * pushes >= 0.0).all()


def test_rate_is_exact_for_a_parabola_on_unequal_steps() -> None:
    h = np.random.default_rng(2).uniform(0.5e-3, 2e-3, 60)
    edges = np.concatenate([[0.0], np.cumsum(h)])
    t = 0.5 * (edges[1:] + edges[:-1])
    np.testing.assert_allclose(rate(3.0 * t**2 - t, h)[1:-1], (6.0 * t - 1.0)[1:-1], atol=1e-9)
    assert (rate(np.array([1.0, 2.0]), np.array([0.1, 0.1])) == 0.0).all()


@settings(max_examples=30, deadline=None)
@given(signals, st.floats(0.1, 50.0), st.floats(-2.0, 2.0))
def test_rate_limit_follows_what_is_slow_and_never_exceeds_its_rate(x: np.ndarray, limit: float, before: float) -> None:
    h = np.full(x.size, 0.1)
    y = rate_limited(x, h, limit, before)
    assert np.abs(np.diff(y, prepend=before)).max() <= 0.1 * limit * (1 + 1e-12)
    fast = max(np.abs(np.diff(x, prepend=before)).max() / 0.1, limit)
    np.testing.assert_allclose(rate_limited(x, h, 1.001 * fast, before), x, atol=1e-12)


def test_rate_limit_answers_a_step_with_a_ramp() -> None:
    y = rate_limited(np.ones(10), np.full(10, 0.5), 0.4, 0.0)
    np.testing.assert_allclose(y, [0.2, 0.4, 0.6, 0.8, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])


def test_integral_begins_anew_wherever_the_limit_is_reached() -> None:
    x = np.array([1.0, 1.0, -1.0, 5.0, 1.0, 2.0, -5.0])
    np.testing.assert_allclose(integral_while_within(x, np.full(7, 0.5), 3.0), [0.5, 1.0, 0.5, 0.0, 0.5, 1.5, 0.0])
    np.testing.assert_allclose(integral_while_within(x, np.full(7, 0.5), np.inf), 0.5 * np.cumsum(x))
