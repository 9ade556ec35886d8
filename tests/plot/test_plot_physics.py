"""Plots against closed forms: transfer functions, bands of noise, and the energy balance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plot_example import LINEAR, MODEL, NOISE, VALUES, WRONG, T, campaign, campaign_of, recording, sine

import phnn
from phnn.parameters import as_table, constant
from phnn.plot.balance import balance
from phnn.plot.frequency import response, whiteness
from phnn.setup import Block
from phnn.signals.first_order import correlation, cross_deviation, own_deviation

F = np.array([1.0, 30.0, 400.0, 711.0, 3000.0])
_FAR = 2.5758293035489004  # half width of the band that holds 99 % of a normal variable


def transfer(f: np.ndarray, capacitance: float = np.inf) -> np.ndarray:
    """``α/(k + α²/C − mω² + iωb)``."""
    omega, alpha = 2.0 * np.pi * f, VALUES["alpha"]
    stiffness = VALUES["k"] + alpha**2 / capacitance
    return alpha / (stiffness - VALUES["m"] * omega**2 + 1j * omega * VALUES["b"])


def test_response_of_a_linear_model_is_its_transfer_function() -> None:
    found = response(LINEAR, F, 60.0)
    for gain in (found.gain, found.linear):
        np.testing.assert_allclose(gain, transfer(F), rtol=1e-6)
    assert found.harmonics.max() < 1e-9
    assert found.gain_unit == "m/V"
    assert replace(found, units=("m/s", "N")).gain_unit == "N/(m/s)"
    assert replace(found, units=("1", "N")).gain_unit == "N"


def test_a_small_amplitude_stays_within_the_dead_zone() -> None:
    found = response(MODEL, F, 60.0)
    np.testing.assert_allclose(found.linear, transfer(F, VALUES["C_1"]), rtol=1e-6)
    assert np.abs(found.gain[0] / found.linear[0] - 1.0) > 0.02
    # A loop that is symmetric has odd harmonics alone.
    assert found.harmonics[0, 1] > 1e-3
    assert found.harmonics[:, [0, 2]].max() < 1e-6


def test_harmonics_of_a_square_are_known() -> None:
    """``y = q + c q²`` with ``q = A sin ωt`` has the second harmonic ``c A²/2``."""
    offset, scale = 0.0, 60.0 * float(np.abs(transfer(F[:1]))[0])
    table = as_table((constant("c", 0.1 / scale, "1/m"), constant("d", 0.0, "1/m²")))
    setup = replace(LINEAR.setup, sensor=(Block("polynomial", ("c", "d")),), block_parameters=table)
    found = response(phnn.Model(setup), F[:1], 60.0, offset)
    np.testing.assert_allclose(found.harmonics[0], [0.05, 0.0, 0.0, 0.0], atol=1e-6)


@pytest.mark.slow
def test_frequencies_follow_from_the_recordings() -> None:
    found = response(LINEAR, campaign=campaign())
    np.testing.assert_allclose(found.frequencies[[0, -1]], [10.0, 100.0], rtol=1e-3)
    np.testing.assert_allclose(found.gain, transfer(found.frequencies), rtol=1e-6)


def test_measured_points_lie_on_the_response() -> None:
    clean = [recording(f"{f:g}", sine(f, 60.0), 1.0 / f, LINEAR, noise=0.0) for f in (20.0, 50.0)]
    found = response(LINEAR, [20.0, 50.0], None, campaign=campaign_of(*clean))
    assert found.amplitude == pytest.approx(60.0, rel=1e-3)
    for p in found.measured:
        assert p.gain == pytest.approx(complex(transfer(np.array([p.frequency]))[0]), rel=1e-4)
    noisy = response(MODEL, [20.0], 60.0, campaign=campaign()).measured
    samples = T.size - round(0.05 / 1e-4)
    # Cosine and sine of N samples are each known to σ √(2/N).
    assert noisy[0].std == pytest.approx(NOISE / 60.0 * np.sqrt(2.0 / samples), rel=0.05)


def test_correlation_is_the_sum_of_products() -> None:
    rng = np.random.default_rng(0)
    e, x = rng.standard_normal(50), rng.standard_normal(50)
    a, b = e - e.mean(), x - x.mean()
    expected = [sum(a[t] * b[t - k] for t in range(50) if 0 <= t - k < 50) for k in range(-7, 8)]
    np.testing.assert_allclose(correlation(e, x, 7), np.array(expected) / np.sqrt((a @ a) * (b @ b)), atol=1e-13)
    assert not correlation(np.ones(10), x[:10], 3).any()


def coloured(rng: np.random.Generator, a: float, size: int) -> np.ndarray:
    """First-order noise of unit variance."""
    n = np.sqrt(1.0 - a * a) * rng.standard_normal(size + 200)
    for k in range(1, n.size):
        n[k] += a * n[k - 1]
    return n[200:]


@pytest.mark.parametrize("a", [0.0, 0.7])
def test_noise_stays_within_its_bands_in_99_percent_of_the_lags(a: float) -> None:
    rng, size, lags, draws = np.random.default_rng(4), 3000, 40, 60
    rho = np.asarray(a ** np.arange(25.0) if a else np.ones(1), dtype=np.float64)
    u = coloured(rng, 0.9, size)
    centre = np.pad(rho, (0, lags + 1 - rho.size))
    own, cross = own_deviation(rho, size, lags), cross_deviation(rho, u, lags)
    within = np.zeros(2)
    for _ in range(draws):
        e = coloured(rng, a, size)
        within[0] += np.mean((np.abs(correlation(e, e, lags)[lags:] - centre) <= _FAR * own)[1:])
        within[1] += np.mean(np.abs(correlation(e, u, lags)) <= _FAR * cross)
    # Neighbouring lags follow each other: some 60 × 5 independent ones.
    np.testing.assert_allclose(within / draws, 0.99, atol=0.012)


def test_deviations_of_white_noise_are_those_of_the_number_of_pairs() -> None:
    u = np.random.default_rng(0).standard_normal(400)
    pairs = 400 - np.arange(21)
    np.testing.assert_allclose(own_deviation(np.ones(1), 400, 20)[1:], np.sqrt(pairs[1:]) / 400)
    np.testing.assert_allclose(cross_deviation(np.ones(1), u, 20)[20:], np.sqrt(pairs) / 400)


def test_the_true_model_leaves_noise_and_a_wrong_one_does_not() -> None:
    for one in whiteness(MODEL, campaign()).found:
        assert one.own.outside.sum() <= 5
        assert one.by_input.outside.mean() <= 0.1
        assert np.median(one.density / one.noise) == pytest.approx(1.0, abs=0.2)
    for one in whiteness(WRONG, campaign()).found:
        assert one.own.outside.mean() > 0.5
    broad = whiteness(WRONG, campaign()).found[3]
    assert broad.by_input.outside.mean() > 0.3
    assert broad.density.max() > 10.0 * broad.noise.max()


def test_the_energy_balance_closes_and_dissipation_never_falls() -> None:
    found = balance(MODEL.trajectory(T, sine(20.0, 60.0)))
    assert np.abs(found.error).max() <= 1e-9 * found.turned_over
    assert np.diff(found.total_dissipated).min() >= -1e-15 * found.turned_over
    # Passivity: no more is stored than was supplied.
    assert (found.total_stored - found.total_stored[0] <= found.total_supplied + 1e-12 * found.turned_over).all()
    q, energy = MODEL.trajectory(T, sine(20.0, 60.0)).states[:, 1], found.stored["q"]
    np.testing.assert_allclose(energy, 0.5 * VALUES["k"] * q**2, rtol=1e-12, atol=1e-25)
    into, out = found.powers()
    h = np.diff(found.t)
    assert (into[1:] * h).sum() == pytest.approx(found.total_supplied[-1])
    assert (out[1:] * h).sum() == pytest.approx(found.total_dissipated[-1])
    assert found.t[-1] == pytest.approx(T[-1])
