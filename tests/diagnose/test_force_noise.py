"""Noise that passes through the plant: its spectrum, and the lines that short recordings seem to have by it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from junctions import recording
from scipy.signal import lfilter

from phnn.diagnose.lines import force_noise, own_score, spectra_of
from phnn.models.actuator import hrc
from phnn.network import small_signal
from phnn.network.small_signal import output_gain
from phnn.recordings.recording import Start
from phnn.setup import DRIFT_TERMS, Own
from tests import campaigns

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
    expected = np.abs(1.0 / (p["m"] * s**2 + p["b"] * s + p["k"]))
    np.testing.assert_allclose(output_gain(network, f), expected, rtol=1e-9)


def drawn(share: float, size: int, rng: np.random.Generator, damping: float = 0.1) -> np.ndarray:
    """White noise and a white force through a resonance at 300 Hz, of unit variance together."""
    pole = np.exp(2.0 * np.pi * 300.0 * DT * (-damping + 1j * np.sqrt(1.0 - damping**2)))
    ringing = lfilter([1.0], np.poly([pole, pole.conj()]).real, rng.standard_normal(size + 2000))[2000:]
    return np.sqrt(share) * ringing / ringing.std() + np.sqrt(1.0 - share) * rng.standard_normal(size)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.9])
def test_the_spectrum_has_the_power_of_both_parts(share: float) -> None:
    """Over forty draws: a single one scatters by a twenty-fifth about its own power."""
    network, f = hrc(0).with_values(linear(300.0, 0.1)), np.linspace(1e-3, 0.5, 2000)
    whole, above = [], []
    for seed in range(40):
        noise = drawn(share, 8000, np.random.default_rng(seed))
        found = force_noise(noise, DT, partial(output_gain, network))
        whole.append(np.mean(found.at(f)) / np.mean(noise**2))
        above.append(found.at(np.array([0.45]))[0] / (1.0 - share))
    assert np.mean(whole) == pytest.approx(1.0, abs=0.03)
    # Far above the resonance only the sensor's noise is left.
    assert np.mean(above) == pytest.approx(1.0, abs=0.03)
    assert max(np.std(whole), np.std(above)) < 0.07


def test_a_model_that_is_exact_and_one_without_a_slope_at_rest_have_a_spectrum(monkeypatch: pytest.MonkeyPatch) -> None:
    t = DT * np.arange(200)
    made = recording(t, np.zeros(t.size), Start("rest"))
    (found,) = spectra_of([np.zeros(t.size)], [made], [partial(output_gain, hrc(2))]).each
    assert np.isfinite(found.level).all() and not found.power.any()
    steep = np.full((4, 4), np.inf), np.zeros((4, 1))
    monkeypatch.setattr(small_signal, "linearised_at_rest", lambda _: steep)
    assert not output_gain(hrc(2), np.ones(3)).any()


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
            (found,) = spectra_of([residual], [made], [response]).each
            ratios[name].append(float(np.max(found.power / found.level)))
    plant, nothing, white = (float(np.median(ratios[n])) for n in ("plant", "nothing", "white"))
    assert plant < 1.2 * white < nothing


def test_a_drift_is_not_taken_for_the_noise_of_a_force() -> None:
    """A ramp that the difference of the halves of a recording does not have for noise stands out of it."""
    linearised = campaigns.linearised()
    rng, own = np.random.default_rng(3), Own(drift_terms=DRIFT_TERMS)
    noise = rng.standard_normal(linearised.fit.residual.size)
    ramp = np.concatenate([np.linspace(-1.0, 1.0, s.stop - s.start) for s in linearised.slices])
    scores = []
    for size in (0.0, 1.0, 5.0):
        drifting = replace(linearised, fit=replace(linearised.fit, residual=noise + size * ramp))
        scores.append(own_score(drifting, own, drifting.spectra)[1])
    assert scores[0] < 3.0 < scores[1] < scores[2]
