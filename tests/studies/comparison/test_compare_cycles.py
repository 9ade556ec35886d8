"""Loop areas and harmonics against closed forms, and what noise does to them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from phnn.recordings.recording import Part, Recording, Start
from phnn.signals.harmonics import harmonic_weights
from studies.comparison.cycles import area_weights, cycle_errors

Array = NDArray[np.float64]


def recorded(t: Array, u: Array, y: Array, period: float | None, noise: float = 1e-8) -> Recording:
    parts = (Part("a", 0, t.size, "identification"),)
    return Recording(
        "a", t, u, y, Start("rest"), "cubic", parts, noise, "given", np.ones(1), period, {}, "a.csv"
    )  # fmt: skip


# 833.3 and 900 samples a period: a fraction of a sample must do no harm.
@pytest.mark.parametrize("samples", [2500, 2700])
def test_area_of_an_ellipse(samples: int) -> None:
    a, b, lag, f = 75.0, 1e-4, 0.3, 50.0
    t = np.arange(samples) * 3.0 / f / samples
    weights = area_weights(t, a * np.sin(2 * np.pi * f * t), 1.0 / f)
    ahead = b * np.sin(2 * np.pi * f * t + lag)
    assert weights @ ahead == pytest.approx(np.pi * a * b * np.sin(lag), rel=2e-5)
    behind = b * np.sin(2 * np.pi * f * t - lag) + 3e-6
    assert weights @ behind == pytest.approx(-np.pi * a * b * np.sin(lag), rel=2e-5)
    assert abs(weights.sum()) < 1e-9 * np.abs(weights).sum()


def test_area_of_a_parallelogram() -> None:
    t = np.arange(601) / 200.0
    u = 10.0 * np.interp(t % 1.0, [0.0, 0.25, 0.75, 1.0], [0.0, 1.0, -1.0, 0.0])
    up = np.gradient(u) > 0.0
    y = u + np.where(up, -1.0, 1.0)
    # The output jumps within one sample at both ends of the loop.
    assert area_weights(t, u, 1.0) @ y == pytest.approx(-40.0, rel=0.02)


@pytest.mark.parametrize("samples", [2500, 2700])
def test_harmonics_of_a_known_sum(samples: int) -> None:
    f = 10.0
    t = np.arange(samples) * 2.0 / f / samples
    amplitudes = np.array([3.0 - 1.0j, 0.0, 0.5j, 0.1, -0.2 + 0.1j, 0.05, 0.3j])
    y = 5.0 + sum((c * np.exp(2j * np.pi * k * f * t)).real for k, c in enumerate(amplitudes, start=1))
    assert np.allclose(harmonic_weights(t, 1.0 / f) @ y, amplitudes[:5], atol=1e-12)


def test_errors_of_a_model_of_another_size_and_phase() -> None:
    f, a, b = 50.0, 75.0, 1e-4
    t = np.arange(2500) * 3.0 / f / 2500
    phase = 2 * np.pi * f * t
    y, u = b * np.sin(phase - 0.2) + 1e-6 * np.sin(3 * phase), a * np.sin(phase)
    r = recorded(t, u, y, 1.0 / f)
    found = cycle_errors(r, r.parts[0], 1.1 * b * np.sin(phase - 0.2) + 2e-6)
    assert found is not None
    assert found.area == pytest.approx(-0.1, rel=1e-4)
    assert found.fundamental == pytest.approx(b, rel=1e-9)
    assert np.allclose(found.harmonics, [0.1 * b, 0.0, 1e-6, 0.0, 0.0], atol=1e-15)


def test_what_noise_does_to_them() -> None:
    random = np.random.default_rng(0)
    f, noise = 50.0, 1e-7
    t = np.arange(600) * 3.0 / f / 600
    clean, u = 1e-4 * np.sin(2 * np.pi * f * t - 0.2), 75.0 * np.sin(2 * np.pi * f * t)
    # Noise whose neighbours are half alike.
    correlation = np.array([1.0, 0.5])
    draws = random.standard_normal((800, 601))
    noises = noise * (draws[:, 1:] + draws[:, :-1]) / np.sqrt(2.0)
    r = replace(recorded(t, u, clean, 1.0 / f, noise), noise_correlation=correlation)
    found = [cycle_errors(r, r.parts[0], clean + n) for n in noises]
    areas = np.array([e.area for e in found if e is not None])
    harmonics = np.array([e.harmonics for e in found if e is not None])
    assert found[0] is not None
    assert np.std(areas) == pytest.approx(found[0].area_noise, rel=0.1)
    assert np.sqrt(np.mean(harmonics**2)) == pytest.approx(found[0].harmonic_noise, rel=0.05)


def test_a_start_from_rest_is_left_out() -> None:
    f = 50.0
    t = np.arange(2500) * 3.0 / f / 2500
    u = 75.0 * np.sin(2 * np.pi * f * t)
    y = 1e-6 * u
    r = recorded(t, u, y, 1.0 / f)
    wrong_at_first = np.where(t < 0.99 / f, 0.0, y)
    found = cycle_errors(r, r.parts[0], wrong_at_first)
    assert found is not None
    assert max(found.harmonics) < 1e-15
    late = cycle_errors(r, Part("a", 50, 2500, "confirmation"), y + 1e-7 * u)
    assert late is not None
    assert late.harmonics[0] == pytest.approx(7.5e-6, rel=1e-9)


@pytest.mark.parametrize("period", [None, 0.05])
def test_nothing_is_said_of_what_does_not_repeat(period: float | None) -> None:
    t = np.arange(100) * 1e-4
    u = 75.0 * np.sin(2 * np.pi * 20.0 * t)
    r = recorded(t, u, 1e-6 * u, period)
    assert cycle_errors(r, r.parts[0], r.y) is None
