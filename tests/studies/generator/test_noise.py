"""Coloured noise and its whitening."""

from __future__ import annotations

import numpy as np
import pytest

from studies.generator.noise import Noise

COUNT = 200_000


@pytest.mark.parametrize("colour", [0.0, 0.3, 0.8])
def test_noise_has_its_deviation_and_its_colour(colour: float) -> None:
    n = Noise(50e-9, 10e-9, colour).drawn(COUNT, np.random.default_rng(0))
    assert n.std() == pytest.approx(50e-9, rel=0.02)
    assert np.mean(n[1:] * n[:-1]) / np.mean(n**2) == pytest.approx(colour, abs=0.01)


def test_noise_is_stationary_from_its_first_sample() -> None:
    noise = Noise(1.0, 0.0, 0.8)
    first = [noise.drawn(2, np.random.default_rng(seed)) for seed in range(4000)]
    assert np.std(first, axis=0) == pytest.approx([1.0, 1.0], rel=0.05)


@pytest.mark.parametrize("colour", [0.0, 0.3, 0.8])
@pytest.mark.parametrize("step", [0.0, 20e-9, 60e-9])
def test_whitened_noise_with_rounding_is_white_of_unit_variance(colour: float, step: float) -> None:
    noise = Noise(40e-9, step, colour)
    n = noise.drawn(COUNT, np.random.default_rng(1))
    if step > 0.0:
        n = np.round(n / step) * step
    white = noise.whitened(n)
    assert white.std() == pytest.approx(1.0, rel=0.01)
    for lag in (1, 2, 3):
        assert abs(np.mean(white[lag:] * white[:-lag])) < 4.0 / np.sqrt(COUNT)
