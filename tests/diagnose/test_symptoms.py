"""Made-up residuals with known answers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import campaigns
import numpy as np
import pytest

from phnn.diagnose.symptoms import RecordingResidual, Symptoms, Trend, recording_residuals, significant, symptoms
from phnn.report.symptoms import symptom_sentences

NOISE, DT, MODEL = 5e-8, 1e-4, 1e-6
SINES = ((20.0, 5.0), (40.0, 5.0), (75.0, 5.0), (30.0, 40.0), (75.0, 40.0), (50.0, 80.0))


def seen_with(
    extra: Callable[[np.ndarray, float, float], np.ndarray], seed: int = 0, late: float = 0.0, periods: float = 6.0
) -> list[RecordingResidual]:
    """Sines of several amplitudes [V] and frequencies [Hz] with noise and something else [m] in the residual."""
    rng, found = np.random.default_rng(seed), []
    for amplitude, f in SINES:
        t = np.arange(round(periods / f / DT)) * DT
        model = MODEL * amplitude * np.sin(2.0 * np.pi * f * t)
        measured = MODEL * amplitude * np.sin(2.0 * np.pi * f * (t - late))
        rest = extra(t, amplitude, f) + NOISE * rng.standard_normal(t.size)
        residual = (measured - model + rest) / NOISE
        found.append(
            RecordingResidual(DT, residual - residual.mean(), measured + rest, model, f, amplitude, None, NOISE)
        )  # fmt: skip
    return found


def nothing(t: np.ndarray, amplitude: float, f: float) -> np.ndarray:
    return np.zeros_like(t)


def of(found: Symptoms, name: str) -> tuple[float, float, float]:
    return found[name][:3]


def test_a_cubic_effect_gives_odd_harmonics_that_grow_with_the_square_of_the_amplitude_beside_the_drive() -> None:
    # Of A³ sin³ the base takes the first harmonic.
    found = symptoms(seen_with(lambda t, a, f: -4e-12 * a**3 * np.sin(6.0 * np.pi * f * t)))
    value, std, p = of(found, "by_amplitude")
    assert value == pytest.approx(3.0, abs=0.3)
    assert std < 0.3
    assert p < 0.01
    assert abs(of(found, "by_frequency")[0]) < 0.2
    assert of(found, "odd")[0] > 0.95
    assert of(found, "odd")[2] < 1e-6
    assert of(found, "even")[2] > 0.01
    words = " ".join(symptom_sentences(found))
    assert "nearly all are odd" in words


def test_an_even_effect_gives_even_harmonics() -> None:
    found = symptoms(seen_with(lambda t, a, f: 1e-10 * a**2 * np.cos(4.0 * np.pi * f * t)))
    assert of(found, "even")[0] > 0.95
    assert of(found, "odd")[2] > 0.01
    assert of(found, "by_amplitude")[0] == pytest.approx(2.0, abs=0.3)


def test_what_follows_the_speed_grows_with_amplitude_times_frequency() -> None:
    found = symptoms(seen_with(lambda t, a, f: 3e-9 * a * f * np.cos(2.0 * np.pi * f * t)))
    assert of(found, "by_amplitude")[0] == pytest.approx(1.0, abs=0.1)
    assert of(found, "by_frequency")[0] == pytest.approx(1.0, abs=0.1)
    assert "amplitude × frequency" in symptom_sentences(found)[0]


def test_a_delay_is_a_phase_in_proportion_to_frequency() -> None:
    found = symptoms(seen_with(nothing, late=3e-5))
    value, std, p = of(found, "delay")
    assert value == pytest.approx(3e-5, abs=4.0 * std)
    assert std < 1e-6
    assert p < 1e-6
    assert found["delay"].share > 0.95
    assert any("in proportion to frequency, like a delay" in s for s in symptom_sentences(found))


def test_noise_alone_has_no_symptoms() -> None:
    low = []
    for seed in range(50):
        found = symptoms(seen_with(nothing, seed))
        assert "by_amplitude" not in found
        low.append([of(found, n)[2] < 0.01 for n in ("even", "odd", "delay")])
    assert (np.mean(low, axis=0) <= 0.08).all()


def test_correction_for_the_number_of_symptoms() -> None:
    def kept(**p_values: float) -> set[str]:
        return set(significant({n: Trend(1.0, 0.1, p) for n, p in p_values.items()}, 0.01))

    assert kept(by_frequency=0.009) == {"by_frequency"}
    # Of four, the smallest has to lie below a quarter of the level, the next below a third.
    assert kept(by_frequency=0.009, delay=0.004, by_amplitude=0.5, odd=0.7) == set()
    assert kept(by_frequency=0.003, delay=0.002, by_amplitude=0.5, odd=0.7) == {"delay", "by_frequency"}
    # Of the harmonics either kind is told beside the other.
    assert kept(even=0.9, odd=1e-9) == {"even", "odd"}


def test_what_recordings_cannot_show_is_not_said() -> None:
    steps = [replace(s, frequency=0.0) for s in seen_with(nothing)]
    found = symptoms(steps)
    assert found == {} and symptom_sentences(found) == ()


def test_symptoms_of_a_folder() -> None:
    found = symptoms(recording_residuals(campaigns.linearised("cubic_stiffness")))
    assert of(found, "odd")[0] > 0.9
    assert of(found, "odd")[2] < 1e-6
