"""Lines and drifts: what stands out of its surroundings, and what coloured noise must not be taken for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from junctions import recording
from scipy.signal import cont2discrete, dlsim, lfilter

from phnn.criteria import Criteria
from phnn.diagnose.linearised import LinearisedFit
from phnn.diagnose.lines import Spectra, own_score, spectra_of, strongest_line
from phnn.diagnose.locations import integral_while_within, low_pass, play_operator, rate, rate_limited, resonator
from phnn.recordings.recording import Start
from phnn.setup import DRIFT_TERMS, Own
from tests import campaigns

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


DT, SIZE = 1e-3, 600
# Sizes of the noise, by recording.
NOISE = (1.0, 3.0, 3.0, 3.0)


def shown(seed: int, line: float = 0.0) -> Spectra:
    """Spectra of four recordings of white noise, each with a line of its own phase."""
    rng, t = np.random.default_rng(seed), DT * np.arange(SIZE)
    made = recording(t, np.zeros(SIZE), Start("rest"))
    residuals = [size * rng.standard_normal(SIZE) for size in NOISE]
    for phase, residual in enumerate(residuals):
        residual += line * np.sin(2.0 * np.pi * 127.0 * t + phase)
    return spectra_of(residuals, [made] * len(NOISE), [np.zeros_like] * len(NOISE))


def test_white_noise_seldom_has_a_line() -> None:
    judged = np.array([strongest_line(shown(seed))[2] for seed in range(300)])
    assert np.mean(judged > 3.0) < 0.02
    assert judged.max() < Criteria().score


def test_a_line_that_recordings_share_is_found_at_its_frequency() -> None:
    for seed in range(5):
        frequency, stated, judged = strongest_line(shown(seed, line=6.0))
        assert frequency == pytest.approx(127.0, abs=1.0)
        assert 5.0 < judged <= stated


@pytest.mark.parametrize(("driven", "seen"), [(60.0, False), (20.0, False), (50.0, True)])
def test_harmonics_of_what_drives_a_recording_are_no_line(driven: float, seen: bool) -> None:
    """A model misses a harmonic in every way that it is wrong; other scores judge that."""
    rng, t = np.random.default_rng(1), DT * np.arange(SIZE)
    made = recording(t, np.sin(2.0 * np.pi * driven * t), Start("rest"))
    residual = rng.standard_normal(SIZE) + 2.0 * np.sin(2.0 * np.pi * 60.0 * t)
    power, level = spectra_of([residual], [made], [np.zeros_like]).around([60.0])
    assert (power.size == 1 and power[0] > 50.0 * level[0]) if seen else power.size == 0


def test_what_lies_beside_a_line_is_that_of_recordings_that_can_show_it() -> None:
    """Of two recordings of other lengths and rates, within what each resolves, and beside what drives it."""
    rng = np.random.default_rng(0)
    long, short = 1e-3 * np.arange(2000), 1e-2 * np.arange(100)
    made = [
        recording(long, np.sin(2.0 * np.pi * 50.0 * long), Start("rest")),
        recording(short, np.zeros(short.size), Start("rest")),
    ]
    residuals = [rng.standard_normal(long.size) + 2.0 * np.sin(2.0 * np.pi * 30.0 * long), rng.standard_normal(100)]
    spectra = spectra_of(residuals, made, [np.zeros_like] * 2)
    counts = {f: spectra.around([f])[0].size for f in (0.1, 30.0, 50.0, 310.0, 600.0)}
    assert counts == {0.1: 0, 30.0: 2, 50.0: 0, 310.0: 1, 600.0: 0}
    power, level = spectra.around([30.0])
    assert power[0] > 100.0 * level[0] and power[1] < 20.0 * level[1]
    assert [x.size for x in spectra.around([])] == [0, 0]


def coloured(seed: int, exponent: float, scale: float) -> LinearisedFit:
    """A linearised fit whose residual has a power of its own at low frequencies."""
    linearised, rng = campaigns.linearised(), np.random.default_rng(seed)
    parts = []
    for rows in linearised.slices:
        size = rows.stop - rows.start
        waves = np.fft.rfft(rng.standard_normal(size))
        f = np.maximum(np.fft.rfftfreq(size), 1.0 / size)
        parts.append(np.fft.irfft(waves * np.sqrt(1.0 + scale * (f * size) ** -exponent), size))
    return replace(linearised, fit=replace(linearised.fit, residual=np.concatenate(parts)))


@pytest.mark.parametrize("own", [Own(drift_terms=DRIFT_TERMS), Own(lines=(50.0, 100.0, 150.0))])
def test_noise_that_is_stronger_at_low_frequencies_is_neither_drift_nor_mains(own: Own) -> None:
    judged, stated = [], []
    for seed in range(6):
        drawn = coloured(seed, 1.0, 300.0)
        deviate, found = own_score(drawn, own, drawn.spectra)
        judged.append(found)
        stated.append(deviate)
    assert min(stated) > 3.0
    assert max(judged) < 3.0
