"""The noise floor against simulated truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recordings_example import NOISE, output, sine, write
from scipy.signal import chirp, cont2discrete, firwin, lfilter, lsim

from phnn.recordings import read
from phnn.recordings.excitation import excitation_of
from phnn.signals.noise import NoiseFloor, from_high_band, from_one_spectrum, from_periods, from_rest, noise_floor


def floor_of(t: np.ndarray, u: np.ndarray, y: np.ndarray) -> NoiseFloor:
    e = excitation_of(u, float(t[1]))
    return noise_floor(u, y, float(t[1]), e.period, e.span)


def resonant(u: np.ndarray, dt: float, seed: int = 0, step: float = 0.0) -> np.ndarray:
    """Output through a 400 Hz resonance and creep of 0.3 s, as an actuator's is; then noise and quantisation."""
    w = 2.0 * np.pi * 400.0
    b, a, _ = cont2discrete(([w * w], [1.0, 0.4 * w, w * w]), dt, "bilinear")
    q = lfilter(np.ravel(b), np.ravel(a), output(u, noise=0.0))
    fade = np.exp(-dt / 0.3)
    q = q + 0.02 * lfilter([1.0 - fade], [1.0, -fade], q)
    q = q + NOISE * np.random.default_rng(seed).normal(size=u.size)
    return np.round(q / step) * step if step else q


@pytest.mark.parametrize("frequency", [1.0, 10.0, 50.0, 150.0])
@pytest.mark.parametrize("cycles", [2, 3, 4])
@pytest.mark.parametrize("step", [0.0, 10e-9, 100e-9])
def test_white_noise_on_sines(frequency: float, cycles: int, step: float) -> None:
    t, u = sine(frequency, 75.0, cycles, samples=1000)
    found = floor_of(t, u, resonant(u, t[1], seed=cycles, step=step))
    assert found.value == pytest.approx(np.hypot(NOISE, step / np.sqrt(12.0)), rel=0.10)


@pytest.mark.parametrize("step", [0.0, 20e-9])
def test_step_response(step: float) -> None:
    t = np.arange(6000) / 2000.0
    u = np.where((t >= 0.01) & (t < 2.01), 75.0, 0.0)
    found = floor_of(t, u, resonant(u, t[1], step=step))
    assert found.value == pytest.approx(np.hypot(NOISE, step / np.sqrt(12.0)), rel=0.10)
    assert "at rest" in found.source


def test_chirp() -> None:
    t = np.arange(10_000) / 5000.0
    u = 60.0 * chirp(t, 1.0, 2.0, 100.0, phi=-90)
    found = floor_of(t, u, resonant(u, t[1]))
    assert found.value == pytest.approx(NOISE, rel=0.10)
    assert "spectrum above" in found.source


@pytest.mark.parametrize("samples", [833.37, 1000.0])
def test_periods_of_a_fractional_number_of_samples(samples: float) -> None:
    t = np.arange(8000) / (samples * 5.0)
    u = 75.0 * np.sin(2.0 * np.pi * 5.0 * t)
    found = floor_of(t, u, resonant(u, t[1]))
    assert "period-to-period" in found.source
    assert found.value == pytest.approx(NOISE, rel=0.06)
    assert found.correlation.tolist() == [1.0]


def test_slow_drift_is_no_noise() -> None:
    t, u = sine(5.0, 75.0, cycles=10, samples=800)
    drift = 5e-6 * np.sin(2.0 * np.pi * t / 4.0) + 1e-6 * t + 0.002 * t * output(u, noise=0.0)
    found = from_periods(output(u) + drift, 800.0)
    assert found is not None
    assert found.value == pytest.approx(NOISE, rel=0.06)


def test_coloured_noise_and_its_correlation() -> None:
    t, u = sine(2.0, 75.0, cycles=40, samples=500)
    white = np.random.default_rng(3).normal(size=t.size + 500)
    coloured = lfilter([np.sqrt(1.0 - 0.8**2)], [1.0, -0.8], white)[500:]
    found = floor_of(t, u, output(u, noise=0.0) + NOISE * coloured)
    assert found.value == pytest.approx(NOISE, rel=0.08)
    assert found.correlation[0] == 1.0
    np.testing.assert_allclose(found.correlation[1:6], 0.8 ** np.arange(1, 6), atol=0.08)
    # an autocorrelation: its Toeplitz matrix, padded with zeros, has no negative eigenvalue
    padded = np.zeros(4 * found.correlation.size)
    padded[: found.correlation.size] = found.correlation
    padded[1:] += padded[:0:-1]
    assert np.fft.rfft(padded).real.min() > -1e-6 * padded.size


def test_a_transient_is_not_taken_for_noise() -> None:
    t, u = sine(50.0, 75.0, cycles=6, samples=800)
    fading = 20e-6 * np.exp(-t / 0.012) * np.sin(2.0 * np.pi * 333.0 * t)
    found = floor_of(t, u, output(u) + fading)
    assert found.value == pytest.approx(NOISE, rel=0.10)


def test_the_middle_of_a_slow_step_response_has_a_constant_input() -> None:
    t = np.arange(50_000) * 1e-3
    u = np.where(t > 1.0, 5.0, 0.0)
    y = 1e-5 * u * (1.0 - np.exp((1.0 - t) / 30.0)) + NOISE * np.random.default_rng(1).normal(size=t.size)
    floor = from_one_spectrum(u, y, 1e-3)
    assert floor.value == pytest.approx(NOISE, rel=0.1)


def test_masked_samples_of_uneven_stamps_leave_the_noise_of_the_others(tmp_path: Path) -> None:
    u = np.append(sine(1.0, 20.0, cycles=2)[1], np.zeros(800))
    t = np.cumsum(np.where(np.arange(u.size) < 800, 2.5e-3, 0.1))
    y = output(u) * 1e6
    y[[40, 90, 130]] = -9999.0
    write(tmp_path / "a.csv", t, u, y, "time_s,voltage_V,displacement_um")
    (tmp_path / "recordings.yaml").write_text("columns: {displacement: {missing: [-9999]}}\n")
    recording = read(tmp_path).recordings[0]
    assert "at rest" in recording.noise_source
    assert recording.noise == pytest.approx(NOISE, rel=0.15)


def test_settling_is_no_rest() -> None:
    u = np.full(2000, 10.0)
    u[0] = 0.0
    y = 1e-5 * np.exp(-np.linspace(0.0, 12.0, 2000)) * np.cos(np.linspace(0.0, 60.0, 2000)) + 1e-5
    assert from_rest(u, y) is None


@pytest.mark.parametrize("shaking", [0.0, 5e-7])
def test_ringing_after_a_step_is_no_noise(shaking: float) -> None:
    """The spectrum of a step that rings looks like noise, and has seventy times its power or more."""
    t = np.arange(1000) * 5e-4
    u = np.where((t >= 0.05) & (t < 0.35), 75.0, 0.0)
    resonance, damping = 2.0 * np.pi * 858.0, 0.45
    denominator = [1.0, 2.0 * damping * resonance, resonance**2]
    y = 2e-6 * lsim(([resonance**2], denominator), u, t, interp=False)[1]
    y += shaking * np.sin(2.0 * np.pi * 29.8 * t) + NOISE * np.random.default_rng(4).normal(size=t.size)
    assert floor_of(t, u, y).value == pytest.approx(NOISE, rel=0.15)


def test_an_excitation_that_fills_the_band_is_named() -> None:
    u = np.random.default_rng(0).normal(size=4000)
    found = from_high_band(u, 1e-6 * u + NOISE * np.random.default_rng(1).normal(size=4000), 1e-3)
    assert "upper bound" in found.source


@pytest.mark.parametrize("highest", [0.3, 0.35, 0.4])
def test_above_an_excitation_that_reaches_high(highest: float) -> None:
    rng = np.random.default_rng(0)
    u = lfilter(firwin(201, 2.0 * highest), [1.0], rng.normal(size=20_300))[300:]
    q = lfilter([1.0], [1.0, -1.5, 0.95], u)
    found = from_high_band(u, q + 0.01 * rng.normal(size=u.size), 1e-3)
    assert found.value == pytest.approx(0.01, rel=0.10)
    assert "silent" in found.source


def test_noise_that_an_anti_aliasing_filter_took_away_is_seen_beside_the_excitation() -> None:
    rng = np.random.default_rng(1)
    u = lfilter(firwin(201, 0.6), [1.0], rng.normal(size=20_300))[300:]
    n = lfilter(firwin(201, 0.8), [1.0], rng.normal(size=20_300))[300:]
    found = from_high_band(u, lfilter([1.0], [1.0, -1.5, 0.95], u) + 0.01 * n, 1e-3)
    assert found.value == pytest.approx(0.01, rel=0.10)


def test_noise_free_recordings_have_a_positive_floor() -> None:
    t, u = sine(5.0, 75.0, cycles=6)
    found = floor_of(t, u, 1e-6 * u)
    assert found.value == pytest.approx(1e-6 * np.ptp(1e-6 * u))
    assert "no noise floor was found" in found.source
    assert not found.found


def test_quantisation_is_a_lower_bound() -> None:
    t = np.arange(2000) * 1e-3
    u = np.where(t > 0.1, 50.0, 0.0)
    y = np.round(1e-6 * lfilter([0.1], [1.0, -0.9], u) / 1e-7) * 1e-7
    found = floor_of(t, u, y)
    assert found.value == pytest.approx(1e-7 / np.sqrt(12.0), rel=1e-6)
    assert "quantisation" in found.source
