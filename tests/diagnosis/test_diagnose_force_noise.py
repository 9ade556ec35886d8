"""Noise that passes through the plant: its spectrum, and the lines that short recordings seem to have by it."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from junctions import recording
from scipy.signal import lfilter

from phnn.diagnosis.force_noise import force_noise
from phnn.diagnosis.spectra import spectra_of
from phnn.models.actuator import hrc
from phnn.network import small_signal
from phnn.network.small_signal import linearised_at_rest, output_gain
from phnn.recordings.recording import Start

DT = 1e-4


def linear(frequency: float, damping: float) -> dict[str, float]:
    """Stiffness and damping of a resonance [Hz]."""
    m = hrc(0).parameters["m"].value
    w = 2.0 * np.pi * frequency
    return {"k": m * w**2, "b": 2.0 * damping * m * w}


def test_the_response_about_rest_is_that_of_mass_spring_and_damper() -> None:
    network = hrc(0).with_values(linear(300.0, 0.1))
    p = {n: v.value for n, v in network.parameters.items()}
    f = np.geomspace(1.0, 5e3, 50)
    s = 2j * np.pi * f
    expected = np.abs(p["alpha"] / (p["m"] * s**2 + p["b"] * s + p["k"]))
    np.testing.assert_allclose(output_gain(network, f), expected, rtol=1e-9)


def test_hysterons_stick_about_rest() -> None:
    a, b = linearised_at_rest(hrc(2))
    assert a.shape == (4, 4) and b.shape == (4, 2)
    eigenvalues = np.linalg.eigvals(a)
    assert eigenvalues.real.max() < 1e-6 * np.abs(eigenvalues).max()


def drawn(
    share: float, size: int, rng: np.random.Generator, frequency: float = 300.0, damping: float = 0.1
) -> np.ndarray:
    """White noise and a white force through a resonance, of unit variance together."""
    pole = np.exp(2.0 * np.pi * 300.0 * DT * (-damping + 1j * np.sqrt(1.0 - damping**2)))
    ringing = lfilter([1.0], np.poly([pole, pole.conj()]).real, rng.standard_normal(size + 2000))[2000:]
    return np.sqrt(share) * ringing / ringing.std() + np.sqrt(1.0 - share) * rng.standard_normal(size)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.0, 0.9))
def test_the_spectrum_has_the_power_of_both_parts(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    network = hrc(0).with_values(linear(300.0, 0.1))
    noise = drawn(share, 8000, rng)
    found = force_noise(noise, DT, partial(output_gain, network))
    f = np.linspace(1e-3, 0.5, 2000)
    assert np.mean(found.at(f)) == pytest.approx(np.mean(noise**2), rel=0.12)
    # Far above the resonance only the sensor's noise is left.
    assert found.at(np.array([0.45]))[0] == pytest.approx(1.0 - share, rel=0.15)


def test_a_model_that_is_exact_and_one_without_a_slope_at_rest_have_a_spectrum(monkeypatch: pytest.MonkeyPatch) -> None:
    t = DT * np.arange(200)
    made = recording(t, np.zeros(t.size), Start("rest"))
    (found,) = spectra_of([np.zeros(t.size)], [made], partial(output_gain, hrc(2))).each
    assert np.isfinite(found.level).all() and not found.power.any()
    steep = np.full((4, 4), np.inf), np.zeros((4, 1))
    monkeypatch.setattr(small_signal, "linearised_at_rest", lambda _: steep)
    assert not output_gain(hrc(2), np.ones(3)).any()


def test_a_line_hardly_raises_the_noise_that_it_is_compared_with() -> None:
    rng, network = np.random.default_rng(0), hrc(0).with_values(linear(300.0, 0.1))
    t = DT * np.arange(4000)
    noise = drawn(0.5, t.size, rng)
    alone, both = (
        force_noise(x, DT, partial(output_gain, network))
        for x in (noise, noise + 3.0 * np.sin(2.0 * np.pi * 310.0 * t))
    )
    f = np.linspace(1e-3, 0.5, 500)
    np.testing.assert_allclose(both.at(f), alone.at(f), rtol=0.2)


def test_a_resonance_in_a_short_recording_is_no_line() -> None:
    """The largest ratio of power to the level around it: with the plant's response it is that of white noise."""
    network = hrc(0).with_values(linear(300.0, 0.05))
    t = DT * np.arange(400)
    ratios: dict[str, list[float]] = {"plant": [], "nothing": [], "white": []}
    for seed in range(40):
        rng = np.random.default_rng(seed)
        noise, white = drawn(0.9, t.size, rng, damping=0.05), rng.standard_normal(t.size)
        made = recording(t, np.zeros(t.size), Start("rest"))
        for name, residual, response in (
            ("plant", noise, partial(output_gain, network)),
            ("nothing", noise, np.zeros_like),
            ("white", white, np.zeros_like),
        ):
            (found,) = spectra_of([residual], [made], response).each
            ratios[name].append(float(np.max(found.power / found.level)))
    plant, nothing, white = (float(np.median(ratios[n])) for n in ("plant", "nothing", "white"))
    assert plant < 1.2 * white < nothing
