"""Lines: what stands out in one recording alone, and the null of the largest of several scores."""

from __future__ import annotations

import numpy as np
import pytest
from junctions import recording
from scipy.stats import norm

from phnn.diagnosis.lines import LineCandidate, LineScores, line_of_one, strongest_line
from phnn.diagnosis.spectra import Spectra, spectra_of
from phnn.effects import effect
from phnn.recordings.recording import Start

DT, SIZE = 1e-3, 600
# Sizes of the noise: the first recording is the quietest.
NOISE = (1.0, 6.0, 6.0, 6.0)


def shown(seed: int, line: float = 0.0) -> Spectra:
    """Spectra of four recordings of white noise; the first may have a line as well."""
    rng, t = np.random.default_rng(seed), DT * np.arange(SIZE)
    made = recording(t, np.zeros(SIZE), Start("rest"))
    residuals = [size * rng.standard_normal(SIZE) for size in NOISE]
    residuals[0] += line * np.sin(2.0 * np.pi * 127.0 * t)
    return spectra_of(residuals, [made] * len(NOISE), [np.zeros_like] * len(NOISE))


def test_white_noise_has_a_line_as_seldom_as_the_level_says() -> None:
    found = [line_of_one(shown(seed))[1] for seed in range(150)]
    # Beyond 0.01 it has a score at all; neighbouring frequencies depend on each other, so that it is rarer.
    assert sum(score > 0.0 for score in found) <= 4


def test_a_line_in_one_recording_is_found_that_the_others_hide() -> None:
    for seed in range(10):
        spectra = shown(seed, line=0.9)
        stated, judged = line_of_one(spectra)
        assert 3.0 < judged <= stated
        assert strongest_line(spectra)[2] < judged - 1.0


@pytest.mark.parametrize(("driven", "seen"), [(60.0, False), (20.0, False), (50.0, True)])
def test_harmonics_of_what_drives_a_recording_are_no_line(driven: float, seen: bool) -> None:
    """A model misses a harmonic in every way that it is wrong; other scores judge that."""
    rng, t = np.random.default_rng(1), DT * np.arange(SIZE)
    made = recording(t, np.sin(2.0 * np.pi * driven * t), Start("rest"))
    residual = rng.standard_normal(SIZE) + 2.0 * np.sin(2.0 * np.pi * 60.0 * t)
    deviates = line_of_one(spectra_of([residual], [made], [np.zeros_like]))
    assert (min(deviates) > 5.0) if seen else deviates == (0.0, 0.0)


@pytest.mark.parametrize("deviate", [0.5, 2.0, 6.0])
def test_the_tail_is_that_of_the_largest_of_as_many_normal_variables(deviate: float) -> None:
    drift = LineCandidate(effect("sensor_drift"), {}, 1.0, 0.8)
    scores = LineScores((drift, drift, drift), (4.0, 3.0))
    assert scores.tail(deviate) == pytest.approx(-np.expm1(4 * norm.logcdf(deviate)), rel=1e-12)
    assert (scores.statistic, scores.judged) == (4.0, 3.0)
