"""The noise that scores are judged with, against matrices written out and noise of known colour."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

import phnn
from phnn.criteria import Criteria
from phnn.diagnose import screen
from phnn.diagnose.diagnosis import available
from phnn.diagnose.linearised import LinearisedFit, prepare
from phnn.diagnose.lines import degrees_of_freedom, stated_variances
from phnn.diagnose.search import material
from phnn.effects import effect
from phnn.identification.covariance import NoiseSpectrum, most_excess, noise_spectra
from phnn.recordings.recording import Campaign, unrecorded
from phnn.signals.noise import AS_WHITE
from studies.generator import draw_case, make_case
from tests import campaigns


def with_residual(linearised: LinearisedFit, residual: np.ndarray) -> LinearisedFit:
    """The linearised with another residual, of which the base explains nothing."""
    nothing = np.zeros((residual.size, 0))
    return replace(linearised, fit=replace(linearised.fit, residual=residual, jacobian=nothing))


def test_stated_correlation_is_a_symmetric_band_within_a_recording() -> None:
    linearised = campaigns.linearised()
    rho = np.array([1.0, 0.5, 0.2])
    recordings = tuple(replace(r, noise_correlation=rho) for r in linearised.plan.recordings)
    edge = linearised.slices[0].stop
    for lag, expected in [(1, 3.0), (2, 2.4), (3, 2.0)]:
        pairs = np.zeros((linearised.fit.residual.size, 2))
        # Another recording has noise of its own.
        pairs[[10, 10 + lag], 0] = pairs[[edge - 1, edge - 1 + lag], 1] = 1.0
        np.testing.assert_allclose(stated_variances(recordings, linearised.slices, pairs), [expected, 2.0])


def spectra_of(linearised: LinearisedFit) -> list[NoiseSpectrum]:
    """Spectra of the noise in the residual, by recording."""
    residuals = [linearised.residual[rows] for rows in linearised.slices]
    return noise_spectra(residuals, linearised.plan.recordings)


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
    each = [zip(spectra_of(with_residual(linearised, r)), linearised.slices, strict=True) for r in draws[:20]]
    found = np.mean(
        [np.sum([np.diag(s.covariance(columns[rows])) for s, rows in pairs], axis=0) for pairs in each], axis=0
    )
    np.testing.assert_allclose(found, exact, rtol=0.2)


def test_a_recording_alone_does_not_take_its_misfit_for_noise() -> None:
    linearised = campaigns.linearised()
    recordings = tuple(replace(r, period=None) for r in linearised.plan.recordings)
    linearised = replace(linearised, fit=replace(linearised.fit, plan=replace(linearised.plan, recordings=recordings)))
    n = linearised.fit.residual.size
    loud = with_residual(linearised, 30.0 * np.sin(0.01 * np.arange(n)) + np.random.default_rng(0).standard_normal(n))
    assert all(s.density.max() <= 4.0 for s in spectra_of(loud))


def scores_of(linearised: LinearisedFit, columns: np.ndarray) -> np.ndarray:
    """The screen's scores, with their signs, of directions that the base does not explain."""
    blocks = screen._blocks(linearised.slices)
    owner = screen._owners(blocks, linearised.slices)
    found = []
    for column in columns.T:
        along, squares = screen._by_blocks(column, linearised.residual, blocks)
        strength = float(along.sum() / squares.sum())
        candidate = screen._candidate(effect("delay"), {"tau_d": 1.0}, along, squares, strength, owner)
        found.append(np.copysign(candidate.score, strength))
    return np.array(found)


def test_scores_are_normal_under_heavy_tails_and_noise_that_grows_with_the_speed() -> None:
    rng = np.random.default_rng(5)
    linearised = periodic(campaigns.linearised())
    n = linearised.fit.residual.size
    speed = np.abs(np.sin(2.0 * np.pi * np.arange(n) / 50.0))
    # Directions that live where the noise is largest; each draw has directions of its own.
    for noise in (rng.standard_t(3, n) / np.sqrt(3.0), 1.5 * speed * rng.standard_normal(n)):
        columns = speed[:, None] ** 2 * rng.standard_normal((n, 400))
        scores = scores_of(with_residual(linearised, noise), columns)
        assert np.std(scores) < 1.15
        assert np.abs(scores).max() < 4.5


def test_a_true_effect_does_not_hide_in_its_own_spread() -> None:
    rng = np.random.default_rng(6)
    linearised = periodic(campaigns.linearised())
    n = linearised.fit.residual.size
    for direction in (rng.standard_normal((n, 1)), np.sin(0.2 * np.arange(n))[:, None]):
        shown = with_residual(linearised, 0.3 * direction[:, 0] + rng.standard_normal(n))
        assert scores_of(shown, direction)[0] > 0.7 * 0.3 * np.linalg.norm(direction)


def test_what_few_ordinates_tell_has_few_degrees_of_freedom() -> None:
    linearised = periodic(campaigns.linearised())
    sizes = [s.stop - s.start for s in linearised.slices]
    n = sum(sizes)
    shown = with_residual(linearised, np.random.default_rng(8).standard_normal(n))
    noise = spectra_of(shown)
    slow, wide = np.zeros((n, 1)), np.random.default_rng(9).standard_normal((n, 1))
    slow[: sizes[0], 0] = np.cos(2.0 * np.pi * 5.0 * np.arange(sizes[0]) / sizes[0])
    few, many = (degrees_of_freedom(noise, linearised.slices, c) for c in (slow, wide))
    assert few < 60.0 < 200.0 < many


@pytest.mark.parametrize(
    ("source", "most"),
    [("400 samples at rest", 2.0), (f"the spectrum above 250 Hz, {AS_WHITE}", 9.0)],
)
def test_noise_may_exceed_what_is_stated_the_more_the_less_is_known(source: str, most: float) -> None:
    t = np.arange(2000) / 1e3
    recording = replace(unrecorded("sweep", t, t), noise_source=source)
    white = np.random.default_rng(0).normal(size=t.size)
    for size, expected in ((1e3, most**2), (1e-3, 0.1)):
        (spectrum,) = noise_spectra([size * white], [recording])
        np.testing.assert_allclose(spectrum.density, expected)
    assert most_excess([recording]) == most
    # One recording that shows its colour is enough.
    assert most_excess([recording, replace(recording, noise_source="period-to-period differences")]) == 2.0


def test_a_sweep_in_first_order_noise_is_no_physics(tmp_path: Path) -> None:
    """The floor comes from the highest frequencies, where such noise is small."""
    case = draw_case(7919, "none", "one", noise="first_order:0.6")
    make_case(case, tmp_path)
    campaign = phnn.read(tmp_path)
    (recording,) = campaign.recordings
    assert recording.colour_unseen
    assert recording.noise < 0.7 * case.noise.deviation
    assert promising(campaign) == []


def promising(campaign: Campaign) -> list[str]:
    """Names of the candidates that are worth a refit at the base model."""
    base = phnn.identify(None, campaign, phnn.Options(starts=1, workers=1)).fit
    linearised, criteria = prepare(base), Criteria()
    candidates = screen.Screen(linearised, available(campaign, base.setup), criteria)(linearised)
    return [c.effect.name for c in candidates if material(c, base, criteria)]
