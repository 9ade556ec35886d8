"""Noise of known kind is told as what it is, and white noise as white."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from phnn.signals import least_squares
from phnn.signals.noise_statement import NoiseStatement, Sample, noise_statement


@pytest.mark.parametrize("dependent", [False, True])
def test_blocks_leave_what_the_whole_matrix_leaves(dependent: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    t = np.linspace(0.0, 1.0, 1013)
    columns = np.column_stack([np.ones(t.size), t, np.sin(40.0 * t), np.cos(40.0 * t)])
    if dependent:
        columns = np.column_stack([columns, columns @ [1.0, 2.0, 3.0, 4.0]])
    y = columns @ rng.standard_normal(columns.shape[1]) + 0.1 * rng.standard_normal(t.size)
    whole = least_squares.residual(y, lambda rows: columns[rows])
    assert np.allclose(columns.T @ whole, 0.0, atol=1e-10)
    monkeypatch.setattr(least_squares, "_WHOLE", 100)
    monkeypatch.setattr(least_squares, "_ROWS", 100)
    assert np.allclose(least_squares.residual(y, lambda rows: columns[rows]), whole, atol=1e-12)


DT, COUNT = 1e-4, 3000
T = DT * np.arange(COUNT)
SPEED = 0.05 * np.cos(2.0 * np.pi * 50.0 * T)
# Steps that hold what they say for any unit of the noise.
SIGMA = 5e-8


def plant(f: np.ndarray) -> np.ndarray:
    """A damped mode at 800 Hz."""
    return np.asarray(1.0 / ((1.0 - (f / 800.0) ** 2) ** 2 + (0.6 * f / 800.0) ** 2))


def stated(noise: np.ndarray, step: float = 0.0, above: float = 0.0) -> NoiseStatement:
    sample = Sample(noise / SIGMA, DT, SPEED / SIGMA, step / SIGMA, plant, SIGMA, above)
    return noise_statement(SIGMA, "stated", "m", sample)


def white(seed: int) -> np.ndarray:
    return np.asarray(SIGMA * np.random.default_rng(seed).standard_normal(COUNT))


def through_the_plant(x: np.ndarray) -> np.ndarray:
    f = np.fft.rfftfreq(COUNT, DT)
    y = np.fft.irfft(np.fft.rfft(x) * np.sqrt(plant(f)), COUNT)
    return np.asarray(y * x.std() / y.std())


def test_white_noise_is_white_and_nothing_else() -> None:
    found = [stated(white(seed)) for seed in range(200)]
    # One per cent of each test is meant: colour, growth and tails.
    assert sum(f.colour != "white" for f in found) <= 6
    assert sum(bool(f.notes) for f in found) <= 12
    assert found[0].rms == SIGMA and found[0].source == "stated"


def test_noise_that_passes_through_the_plant() -> None:
    for share in (0.3, 0.7):
        found = stated(np.sqrt(1.0 - share) * white(0) + np.sqrt(share) * through_the_plant(white(1)))
        assert found.colour == "spectrum"
        assert "the spectrum has the resonance of the plant (7" in found.notes[0]
        told = float(found.notes[0].partition("): ")[2].partition(" %")[0]) / 100.0
        assert told == pytest.approx(share, abs=0.1)


@pytest.mark.parametrize(("phi", "side"), [(0.5, "low"), (-0.5, "high")])
def test_noise_of_first_order(phi: float, side: str) -> None:
    found = stated(lfilter([1.0], [1.0, -phi], white(2)))
    assert found.colour == "spectrum"
    assert f"more power at {side} frequencies" in found.notes[0]
    assert f"{phi:g}" in found.notes[0]


def test_what_lies_below_the_band_is_no_colour() -> None:
    settling = white(3) + 20.0 * SIGMA * np.sin(2.0 * np.pi * 5.0 * T / T[-1])
    assert stated(settling).colour == "spectrum"
    assert stated(settling, above=6.0 / T[-1]).colour == "white"


@pytest.mark.parametrize("jitter", [1e-6, 3e-6])
def test_variance_that_grows_with_the_speed_is_told_as_jitter(jitter: float) -> None:
    late = jitter * np.random.default_rng(4).standard_normal(COUNT)
    (note,) = stated(white(5) + SPEED * late).notes
    assert "grows with the speed" in note
    assert float(note.split()[5]) == pytest.approx(1e6 * jitter, rel=0.15)
    # What is as loud at all speeds is no jitter.
    assert not stated(white(5) + 0.05 * np.median(np.abs(SPEED)) * late).notes


def test_steps_beside_the_noise() -> None:
    for step, told in ((2.0 * SIGMA, True), (0.1 * SIGMA, False)):
        y = np.round((1e-5 * np.sin(300.0 * T) + white(6)) / step) * step
        found = stated(y - 1e-5 * np.sin(300.0 * T), step)
        assert any("quantised: steps of 100 nm" in n for n in found.notes) is told
        assert not any("outliers" in n for n in found.notes)


def test_heavy_tails_are_outliers() -> None:
    heavy = SIGMA * np.random.default_rng(7).standard_t(3, COUNT)
    assert any("outliers" in n for n in stated(heavy).notes)
    spiked = white(8)
    spiked[::500] += 12.0 * SIGMA
    assert any("outliers" in n for n in stated(spiked).notes)


def test_what_cannot_be_seen_is_not_told() -> None:
    for sample in (None, Sample(white(0)[:50], DT), Sample(np.zeros(COUNT), DT)):
        found = noise_statement(SIGMA, "stated", "m", sample)
        assert found.notes == ("assumed, for the noise cannot be seen apart from the motion",)
    assert found.document() == {"rms": SIGMA, "source": "stated", "colour": "white", "notes": list(found.notes)}
