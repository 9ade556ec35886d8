"""The noise that scores are judged with, against matrices written out and noise of known colour."""

from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from phnn.diagnosis.colour import Colour
from phnn.diagnosis.linearised_fit import LinearisedFit
from phnn.identification.residual_noise import doubt
from tests import campaigns


def with_residual(linearised: LinearisedFit, residual: np.ndarray) -> LinearisedFit:
    """The linearised with another residual, of which the base explains nothing."""
    nothing = np.zeros((residual.size, 0))
    return replace(linearised, fit=replace(linearised.fit, residual=residual, jacobian=nothing))


def test_stated_correlation_is_a_symmetric_band_within_a_recording() -> None:
    linearised = campaigns.linearised()
    rho = np.array([1.0, 0.5, 0.2])
    recordings = tuple(replace(r, noise_correlation=rho) for r in linearised.plan.recordings)
    fitted = replace(linearised.fit, plan=replace(linearised.fit.plan, recordings=recordings))
    edge = linearised.slices[0].stop
    colour = Colour(replace(linearised, fit=fitted))
    for lag, expected in [(1, 3.0), (2, 2.4), (3, 2.0)]:
        pairs = np.zeros((linearised.fit.residual.size, 2))
        # Another recording has noise of its own.
        pairs[[10, 10 + lag], 0] = pairs[[edge - 1, edge - 1 + lag], 1] = 1.0
        np.testing.assert_allclose(colour.stated(pairs), [expected, 2.0])


def resonant(n: int, rng: np.random.Generator) -> np.ndarray:
    """White noise of unit variance through a resonance at 0.05 cycles a sample, half of the power, and white noise."""
    pole = 0.97 * np.exp(2j * np.pi * 0.05)
    ringing = lfilter([1.0], np.poly([pole, pole.conj()]).real, rng.standard_normal(n))
    return np.sqrt(0.5) * (ringing / ringing.std() + rng.standard_normal(n))


def periodic(linearised: LinearisedFit) -> LinearisedFit:
    """The linearised with recordings of ten periods each, all at one rate."""
    recordings = tuple(
        replace(r, period=r.t.size / 10.0 * 1e-4, t=1e-4 * np.arange(r.t.size)) for r in linearised.plan.recordings
    )
    return replace(linearised, fit=replace(linearised.fit, plan=replace(linearised.plan, recordings=recordings)))


def test_the_spread_of_scores_under_noise_of_a_resonance() -> None:
    rng = np.random.default_rng(2)
    linearised = periodic(campaigns.linearised())
    n = linearised.fit.residual.size
    columns = np.stack([resonant(n, rng) for _ in range(3)] + [rng.standard_normal(n)], axis=1)
    # The average over many draws knows the covariance that a single residual has to tell.
    draws = np.stack([np.concatenate([resonant(s.stop - s.start, rng) for s in linearised.slices]) for _ in range(600)])
    exact = np.var(draws @ columns, axis=0)
    assert exact[0] > 2.0 * columns[:, 0] @ columns[:, 0]
    found = np.mean([np.diag(Colour(with_residual(linearised, r)).left(columns)) for r in draws[:20]], axis=0)
    np.testing.assert_allclose(found, exact, rtol=0.2)


def test_what_repeats_with_the_drive_is_no_noise() -> None:
    rng = np.random.default_rng(3)
    linearised = periodic(campaigns.linearised())
    noise = rng.standard_normal(linearised.fit.residual.size)
    repeating = np.concatenate(
        [np.sin(2.0 * np.pi * 30.0 * np.arange(s.stop - s.start) / (s.stop - s.start)) for s in linearised.slices]
    )
    alone, both = (Colour(with_residual(linearised, r)).spectra[0] for r in (noise, noise + 20.0 * repeating))
    np.testing.assert_allclose(both.density, alone.density, rtol=1e-6)
    np.testing.assert_allclose(np.mean(alone.at(np.linspace(0.0, 0.5, 500))), 1.0, atol=0.1)


def test_the_spectrum_of_flicker_noise_goes_on_below_the_lowest_frequency() -> None:
    rng = np.random.default_rng(4)
    linearised = periodic(campaigns.linearised())

    def flicker(n: int) -> np.ndarray:
        waves = np.fft.rfft(rng.standard_normal(n))
        waves[1:] /= np.sqrt(np.fft.rfftfreq(n)[1:])
        waves[0] = 0.0
        return np.fft.irfft(waves, n)

    spectra = [
        Colour(
            with_residual(linearised, np.concatenate([flicker(s.stop - s.start) for s in linearised.slices]))
        ).spectra[0]
        for _ in range(10)
    ]
    ratio = np.median([s.at(np.array([2e-4]))[0] / s.at(np.array([2e-3]))[0] for s in spectra])
    assert 4.0 < ratio < 25.0


def test_a_recording_alone_does_not_take_its_misfit_for_noise() -> None:
    linearised = campaigns.linearised()
    recordings = tuple(replace(r, period=None) for r in linearised.plan.recordings)
    linearised = replace(linearised, fit=replace(linearised.fit, plan=replace(linearised.plan, recordings=recordings)))
    n = linearised.fit.residual.size
    loud = with_residual(linearised, 30.0 * np.sin(0.01 * np.arange(n)) + np.random.default_rng(0).standard_normal(n))
    assert all(s.density.max() <= 4.0 for s in Colour(loud).spectra)


def test_deviates_are_normal_under_heavy_tails_and_noise_that_grows_with_the_speed() -> None:
    rng = np.random.default_rng(5)
    linearised = periodic(campaigns.linearised())
    n = linearised.fit.residual.size
    speed = np.abs(np.sin(2.0 * np.pi * np.arange(n) / 50.0))
    # Directions that live where the noise is largest; each draw has directions of its own.
    for noise in (rng.standard_t(3, n) / np.sqrt(3.0), 1.5 * speed * rng.standard_normal(n)):
        colour = Colour(with_residual(linearised, noise))
        columns = speed[:, None] ** 2 * rng.standard_normal((n, 400))
        deviates = colour.deviates(columns, colour.left(columns))
        assert np.std(deviates) < 1.15
        assert np.abs(deviates).max() < 4.5


def test_a_true_effect_does_not_hide_in_its_own_spread() -> None:
    rng = np.random.default_rng(6)
    linearised = periodic(campaigns.linearised())
    n = linearised.fit.residual.size
    direction = np.sin(0.2 * np.arange(n))[:, None]
    colour = Colour(with_residual(linearised, 0.3 * direction[:, 0] + rng.standard_normal(n)))
    white = 0.3 * np.linalg.norm(direction)
    assert colour.deviates(direction, colour.left(direction))[0] > 0.5 * white


def test_doubt_never_sharpens_and_never_blinds() -> None:
    np.testing.assert_allclose(doubt(np.array([0.1, 2.25, 1e6]), np.ones(3)), [1.0, 1.5, 2.0])
