"""Lines of a residual, its noise without a parametric form, and the noise of a force."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from junctions import recording
from scipy.signal import cont2discrete, dlsim, lfilter

import phnn
from phnn.criteria import Criteria
from phnn.diagnose import screen
from phnn.diagnose.diagnosis import available
from phnn.diagnose.linearised import LinearisedFit, prepare
from phnn.diagnose.lines import Spectra, force_noise, own_score, spectra_of, strongest_line
from phnn.diagnose.locations import play_operator, rate_limited, resonator
from phnn.diagnose.search import material
from phnn.effects import effect
from phnn.identification.covariance import NoiseSpectrum, most_excess, noise_spectra
from phnn.models.actuator import hrc
from phnn.network.roles import output_gain
from phnn.recordings.recording import Campaign, Start, unrecorded
from phnn.setup import DRIFT_TERMS, Own
from phnn.signals.noise import AS_WHITE
from studies.generator import draw_case, make_case
from tests import campaigns

signals = st.integers(0, 10**6).map(lambda seed: np.cumsum(np.random.default_rng(seed).standard_normal(200)))


@settings(max_examples=20, deadline=None)
@given(signals, st.floats(0.5, 40.0), st.floats(0.003, 0.7))
def test_resonator_is_an_oscillator_driven_by_a_held_signal(x: np.ndarray, frequency: float, ratio: float) -> None:
    # q'' + 2 ζ ω q' + ω² q = x has the two states of the resonator as linear combinations of q and q'.
    h, omega = 1e-3, 2.0 * np.pi * frequency
    free = np.array([[0.0, 1.0], [-(omega**2), -2.0 * ratio * omega]])
    exact = cont2discrete((free, np.array([[0.0], [1.0]]), np.eye(2), np.zeros((2, 1))), h)
    _, states, _ = dlsim((*exact[:4], h), np.append(x, 0.0))
    found = resonator(x, np.full(x.size, h), frequency, ratio)
    states = states[1:]
    weights, *_ = np.linalg.lstsq(found, states / np.abs(states).max(axis=0), rcond=None)
    np.testing.assert_allclose(found @ weights, states / np.abs(states).max(axis=0), atol=1e-8)


@settings(max_examples=30, deadline=None)
@given(signals, st.floats(0.01, 20.0))
def test_play_follows_within_its_radius_and_knows_no_rate(x: np.ndarray, radius: float) -> None:
    y = play_operator(x, radius)
    assert np.abs(x - y).max() <= radius * (1 + 1e-12) + 1e-12
    np.testing.assert_array_equal(play_operator(np.repeat(x, 3), radius)[2::3], y)
    np.testing.assert_allclose(play_operator(-x, radius), -y, atol=0)
    # It moves only with its input, and only while the input pushes it.
    moves, pushes = np.diff(y), np.diff(x)
    assert (moves * pushes >= 0.0).all()


@settings(max_examples=30, deadline=None)
@given(signals, st.floats(0.1, 50.0), st.floats(-2.0, 2.0))
def test_rate_limit_follows_what_is_slow_and_never_exceeds_its_rate(x: np.ndarray, limit: float, before: float) -> None:
    h = np.full(x.size, 0.1)
    y = rate_limited(x, h, limit, before)
    assert np.abs(np.diff(y, prepend=before)).max() <= 0.1 * limit * (1 + 1e-12)
    fast = max(np.abs(np.diff(x, prepend=before)).max() / 0.1, limit)
    np.testing.assert_allclose(rate_limited(x, h, 1.001 * fast, before), x, atol=1e-12)


DT, SIZE = 1e-3, 600
# Sizes of the noise, by recording.
NOISE = (1.0, 3.0, 3.0, 3.0)


def shown(seed: int, line: float = 0.0) -> Spectra:
    """Spectra of four recordings of white noise, each with a line of its own phase."""
    rng, t = np.random.default_rng(seed), DT * np.arange(SIZE)
    made = recording(t, np.zeros(SIZE), Start("rest"))
    residuals = [size * rng.standard_normal(SIZE) for size in NOISE]
    for phase, residual in enumerate(residuals):
        residual += line * np.sin(2.0 * np.pi * 127.0 * t + phase)
    return spectra_of(residuals, [made] * len(NOISE), [np.zeros_like] * len(NOISE))


def test_white_noise_seldom_has_a_line() -> None:
    judged = np.array([strongest_line(shown(seed))[2] for seed in range(300)])
    assert np.mean(judged > 3.0) < 0.02
    assert judged.max() < Criteria().score


def test_a_line_that_recordings_share_is_found_at_its_frequency() -> None:
    for seed in range(5):
        frequency, stated, judged = strongest_line(shown(seed, line=6.0))
        assert frequency == pytest.approx(127.0, abs=1.0)
        assert 5.0 < judged <= stated


@pytest.mark.parametrize(("driven", "seen"), [(60.0, False), (20.0, False), (50.0, True)])
def test_harmonics_of_what_drives_a_recording_are_no_line(driven: float, seen: bool) -> None:
    """A model misses a harmonic in every way that it is wrong; other scores judge that."""
    rng, t = np.random.default_rng(1), DT * np.arange(SIZE)
    made = recording(t, np.sin(2.0 * np.pi * driven * t), Start("rest"))
    residual = rng.standard_normal(SIZE) + 2.0 * np.sin(2.0 * np.pi * 60.0 * t)
    power, level = spectra_of([residual], [made], [np.zeros_like]).around([60.0])
    assert (power.size == 1 and power[0] > 50.0 * level[0]) if seen else power.size == 0


def coloured(seed: int, exponent: float, scale: float) -> LinearisedFit:
    """A linearised fit whose residual has a power of its own at low frequencies."""
    linearised, rng = campaigns.linearised(), np.random.default_rng(seed)
    parts = []
    for rows in linearised.slices:
        size = rows.stop - rows.start
        waves = np.fft.rfft(rng.standard_normal(size))
        f = np.maximum(np.fft.rfftfreq(size), 1.0 / size)
        parts.append(np.fft.irfft(waves * np.sqrt(1.0 + scale * (f * size) ** -exponent), size))
    return replace(linearised, fit=replace(linearised.fit, residual=np.concatenate(parts)))


@pytest.mark.parametrize("own", [Own(drift_terms=DRIFT_TERMS), Own(lines=(50.0, 100.0, 150.0))])
def test_noise_that_is_stronger_at_low_frequencies_is_neither_drift_nor_mains(own: Own) -> None:
    judged, stated = [], []
    for seed in range(6):
        drawn = coloured(seed, 1.0, 300.0)
        deviate, found = own_score(drawn, own, drawn.spectra)
        judged.append(found)
        stated.append(deviate)
    assert min(stated) > 3.0
    assert max(judged) < 3.0


def noise_spectra_of(linearised: LinearisedFit) -> list[NoiseSpectrum]:
    """Spectra of the noise in the residual, by recording."""
    residuals = [linearised.residual[rows] for rows in linearised.slices]
    return noise_spectra(residuals, linearised.plan.recordings)


def periodic(linearised: LinearisedFit) -> LinearisedFit:
    """The linearised with recordings of ten periods each, all at one rate."""
    recordings = tuple(
        replace(r, period=r.t.size / 10.0 * 1e-4, t=1e-4 * np.arange(r.t.size)) for r in linearised.plan.recordings
    )
    return replace(linearised, fit=replace(linearised.fit, plan=replace(linearised.plan, recordings=recordings)))


def test_a_recording_alone_does_not_take_its_misfit_for_noise() -> None:
    linearised = campaigns.linearised()
    recordings = tuple(replace(r, period=None) for r in linearised.plan.recordings)
    linearised = replace(linearised, fit=replace(linearised.fit, plan=replace(linearised.plan, recordings=recordings)))
    n = linearised.fit.residual.size
    loud = campaigns.with_residual(
        linearised, 30.0 * np.sin(0.01 * np.arange(n)) + np.random.default_rng(0).standard_normal(n)
    )
    assert all(s.density.max() <= 4.0 for s in noise_spectra_of(loud))


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
        scores = scores_of(campaigns.with_residual(linearised, noise), columns)
        assert np.std(scores) < 1.15
        assert np.abs(scores).max() < 4.5


def test_a_true_effect_does_not_hide_in_its_own_spread() -> None:
    rng = np.random.default_rng(6)
    linearised = periodic(campaigns.linearised())
    n = linearised.fit.residual.size
    for direction in (rng.standard_normal((n, 1)), np.sin(0.2 * np.arange(n))[:, None]):
        shown = campaigns.with_residual(linearised, 0.3 * direction[:, 0] + rng.standard_normal(n))
        assert scores_of(shown, direction)[0] > 0.7 * 0.3 * np.linalg.norm(direction)


@pytest.mark.parametrize(
    ("source", "most"), [("400 samples at rest", 2.0), (f"the spectrum above 250 Hz, {AS_WHITE}", 9.0)]
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


@pytest.mark.slow
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
    base = phnn.identify(campaign, options=phnn.Options(starts=1, workers=1)).fit
    linearised, criteria = prepare(base), Criteria()
    candidates = screen.Screen(linearised, available(campaign, base.setup), criteria)(linearised)
    return [c.effect.name for c in candidates if material(c, base, criteria)]


HEATED_DT = 1e-4


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
    pole = np.exp(2.0 * np.pi * 300.0 * HEATED_DT * (-damping + 1j * np.sqrt(1.0 - damping**2)))
    ringing = lfilter([1.0], np.poly([pole, pole.conj()]).real, rng.standard_normal(size + 2000))[2000:]
    return np.sqrt(share) * ringing / ringing.std() + np.sqrt(1.0 - share) * rng.standard_normal(size)


@pytest.mark.parametrize("share", [0.0, 0.6])
def test_the_spectrum_has_the_power_of_both_parts(share: float) -> None:
    """Over forty draws: a single one scatters by a twenty-fifth about its own power."""
    network, f = hrc(0).with_values(linear(300.0, 0.1)), np.linspace(1e-3, 0.5, 2000)
    whole, above = [], []
    for seed in range(40):
        noise = drawn(share, 8000, np.random.default_rng(seed))
        found = force_noise(noise, HEATED_DT, partial(output_gain, network))
        whole.append(np.mean(found.at(f)) / np.mean(noise**2))
        above.append(found.at(np.array([0.45]))[0] / (1.0 - share))
    assert np.mean(whole) == pytest.approx(1.0, abs=0.03)
    # Far above the resonance only the sensor's noise is left.
    assert np.mean(above) == pytest.approx(1.0, abs=0.03)
    assert max(np.std(whole), np.std(above)) < 0.07


def test_a_resonance_in_a_short_recording_is_no_line() -> None:
    """The largest ratio of power to the level around it: with the plant's response it is that of white noise."""
    network = hrc(0).with_values(linear(300.0, 0.05))
    t = HEATED_DT * np.arange(400)
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
