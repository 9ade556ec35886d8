"""Lines and drifts: what stands out of its surroundings, and what coloured noise must not be taken for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from junctions import recording

from phnn.criteria import Criteria
from phnn.diagnose.linearised import LinearisedFit
from phnn.diagnose.lines import Spectra, own_score, spectra_of, strongest_line
from phnn.recordings.recording import Start
from phnn.setup import DRIFT_TERMS, Own
from tests import campaigns

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


def test_what_lies_beside_a_line_is_that_of_recordings_that_can_show_it() -> None:
    """Of two recordings of other lengths and rates, within what each resolves, and beside what drives it."""
    rng = np.random.default_rng(0)
    long, short = 1e-3 * np.arange(2000), 1e-2 * np.arange(100)
    made = [
        recording(long, np.sin(2.0 * np.pi * 50.0 * long), Start("rest")),
        recording(short, np.zeros(short.size), Start("rest")),
    ]
    residuals = [rng.standard_normal(long.size) + 2.0 * np.sin(2.0 * np.pi * 30.0 * long), rng.standard_normal(100)]
    spectra = spectra_of(residuals, made, [np.zeros_like] * 2)
    counts = {f: spectra.around([f])[0].size for f in (0.1, 30.0, 50.0, 310.0, 600.0)}
    assert counts == {0.1: 0, 30.0: 2, 50.0: 0, 310.0: 1, 600.0: 0}
    power, level = spectra.around([30.0])
    assert power[0] > 100.0 * level[0] and power[1] < 20.0 * level[1]
    assert [x.size for x in spectra.around([])] == [0, 0]


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
