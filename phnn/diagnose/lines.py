"""Score of lines and slow drifts: a subspace in place of a direction, because no other recording tells their size.

With an orthonormal basis ``Q`` of the nuisances of all recordings, base and nuisances projected out, ``‖Qᵀr‖²`` over
the mean noise power along ``Q`` is χ² with as many degrees of freedom as columns, where nothing is missing. The
standard normal deviate of the same tail probability makes it comparable to the score of a direction.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.special import ndtri_exp
from scipy.stats import chi2
from scipy.stats import f as f_distribution

from phnn.diagnose.linearised import LinearisedFit
from phnn.diagnose.noise import (
    FINER,
    FREEDOM,
    LEVEL_CELLS,
    Spectra,
    covariance,
    degrees_of_freedom,
    force_noise,
    stated_variances,
    strongest,
)
from phnn.identification.nuisances import drift_columns, line_columns, own_columns, without_nuisances
from phnn.identification.residual_noise import most_excess, noise_spectra
from phnn.setup import DRIFT_TERMS, Own

Array = NDArray[np.float64]

_RANK = 1e-9
# A direction of which the base leaves no more than this share is explained by it.
_FREE = 1e-10
# Multiples of a line's frequency that come with it.
_HARMONICS = (1, 2, 3)
# Logarithm of the tail probability below which a line stands out of its surroundings.
_LINE = float(np.log(0.01))
# Probability below which an estimate of a variance contradicts the one that is stated.
_CONTRADICTED = 0.05


def own_score(linearised: LinearisedFit, own: Own, spectra: Spectra) -> tuple[float, float]:
    """Return normal deviates of the residual's power along the recordings' nuisances, out of the noise as stated and as
    the residual has it; zero where no recording can show them.

    The floor of a recording is an estimate, its colour even more so. Where nothing is missing the residual is noise, so
    it shows what the noise is. Lines are held against a force that nobody records too, and against what lies beside
    them.
    """
    setup, recordings, slices = linearised.fit.setup, linearised.plan.recordings, linearised.slices
    columns = [
        without_nuisances(own_columns(r, own), r.mask("identification"), r, setup.own, hidden)
        for r, hidden in zip(recordings, linearised.hidden, strict=True)
    ]
    parts = [np.linalg.svd(c, full_matrices=False)[:2] for c in columns]
    largest = max(size.max(initial=0.0) for _, size in parts)
    alone = block_diag(*(basis[:, size > _RANK * largest] for basis, size in parts))
    # The basis is orthonormal for each recording; the base is projected out of all recordings together.
    explained = linearised.basis.T @ alone
    left_over, vectors = np.linalg.eigh(np.eye(alone.shape[1]) - explained.T @ explained)
    free = left_over > _FREE
    if not free.any():
        return 0.0, 0.0
    q = linearised.project(alone) @ (vectors[:, free] / np.sqrt(left_over[free]))
    residuals = [linearised.residual[rows] for rows in slices]
    noise = noise_spectra(residuals, recordings)
    stated, left = float(np.mean(stated_variances(recordings, slices, q))), covariance(noise, slices, q)
    saved = float(np.sum((q.T @ linearised.residual) ** 2) / stated)
    excess, deviate = max(float(np.mean(np.diag(left))) / stated, 1.0), _deviate(saved, q.shape[1], 1.0)
    if own.drift_terms > setup.own.drift_terms:
        judged, known = _deviate(saved / excess, q.shape[1], 1.0), degrees_of_freedom(noise, slices, q)
        if chi2.sf(known * excess, known) <= _CONTRADICTED:
            # It is compared with the few lowest ordinates, and the variances along it differ (Satterthwaite 1946).
            along = float(np.trace(left) ** 2 / np.sum(left**2))
            judged = min(judged, _normal(float(f_distribution.logsf(saved / excess / q.shape[1], along, known))))
        return deviate, judged
    # A line raises the spectrum that it is compared with; a slow drift does not, it is slower than that spectrum.
    excess = min(excess, most_excess(recordings) ** 2)
    forces = [
        force_noise(r, recording.dt, linearised.response(recording), most_excess([recording]) ** 2)
        for r, recording in zip(residuals, recordings, strict=True)
    ]
    # Such a spectrum is one band.
    forced = np.sum([s.by_band(q[rows])[0] for s, rows in zip(forces, slices, strict=True)], axis=0)
    judged = _deviate(saved / max(excess, float(np.mean(forced)) / stated), q.shape[1], 1.0)
    power, level = spectra.around([f for f in own.lines if f not in setup.own.lines])
    if power.size:
        judged = min(judged, _normal(float(_over_level(np.mean(_ratio(power, level)), FREEDOM * power.size))))
    return deviate, judged


def line_share(linearised: LinearisedFit) -> float:
    """Return the sum of squares that lines take away, in units of the noise, at frequencies that other recordings tell.

    What drives a recording repeats at its own frequency and tells of no line: it is asked beside harmonics of it.
    """
    spectra, saved = linearised.spectra, 0.0
    for i, (recording, rows) in enumerate(zip(linearised.plan.recordings, linearised.slices, strict=True)):
        power, freedom = spectra.of_others(i)
        lines = [k * spectra.f[strongest(power, freedom)] for k in _HARMONICS]
        columns = line_columns(recording, lines)[recording.mask("identification")]
        if columns.shape[1] and freedom.max() > 0.5:
            left = np.linalg.qr(columns)[0].T @ linearised.residual[rows]
            saved += float(left @ left) - left.size
    return max(saved, 0.0)


def drift_share(linearised: LinearisedFit) -> float:
    """Return the sum of squares that a slow drift of each recording removes, in units of the noise.

    The drift is fitted to every other stretch of a recording and predicts the stretches between.
    """
    saved = 0.0
    for recording, rows in zip(linearised.plan.recordings, linearised.slices, strict=True):
        columns = drift_columns(recording, DRIFT_TERMS)[recording.mask("identification")]
        columns, left = np.column_stack([np.ones(columns.shape[0]), columns]), linearised.residual[rows]
        odd = (np.arange(left.size) * 4 * columns.shape[1] // left.size) % 2 == 1
        for fitted in (odd, ~odd):
            weights = np.linalg.lstsq(columns[fitted], left[fitted], rcond=_RANK)[0]
            saved += float(left[~fitted] @ left[~fitted] - np.sum((left[~fitted] - columns[~fitted] @ weights) ** 2))
    return max(saved, 0.0)


def strongest_line(spectra: Spectra) -> tuple[float, float, float]:
    """Return the frequency [Hz] at which recordings' residuals hold most power together, and its normal deviates.

    The periodograms of all recordings, each over the spectrum of its stated noise, are added up; so are the levels
    around each frequency. The power is χ² under noise as stated, and its ratio to the level is F under noise of any
    spectrum that is smooth over a dozen of the cells that a recording resolves, a resonance of the plant for instance.
    The tail probability of the largest value is multiplied by the number of frequencies.
    """
    power, level, freedom = spectra.added(lambda s: s.power), spectra.added(lambda s: s.level), spectra.freedom
    tries = spectra.f.size * FINER
    tails = _out_of_surroundings(power, level, freedom) + np.log(tries)
    best = strongest(power, freedom)
    if tails.min(initial=0.0) < _LINE:
        # What stands out of its surroundings is the line, not what is strong because a resonance is.
        best = int(np.argmin(tails))
    stated = _deviate(float(power[best]), int(freedom[best]), tries)
    return float(spectra.f[best]), stated, min(_normal(float(tails.min(initial=0.0))), stated)


def _out_of_surroundings(power: Array, level: Array, freedom: Array) -> Array:
    """(F,) logarithms of the tail probabilities of powers over the levels around them; zero without freedom."""
    known = np.maximum(freedom, 1.0)
    return np.where(freedom > 0.5, _over_level(_ratio(power, level), known), 0.0)


def _ratio(power: Array, level: Array) -> Array:
    """Powers over the levels around them."""
    return np.asarray(power / np.maximum(level, 1e-300))


def _over_level(ratio: Array | np.floating, freedom: Array | float) -> Array:
    """Logarithms of the tail probabilities of ratios of powers, of some degrees of freedom, to their levels."""
    return np.asarray(f_distribution.logsf(ratio, freedom, LEVEL_CELLS * freedom))


def _normal(tail: float) -> float:
    """The normal deviate, at least 0, of a logarithm of a tail probability."""
    return max(float(-ndtri_exp(min(tail, -1e-12))), 0.0)


def _deviate(saved: float, freedom: int, tries: float) -> float:
    """Normal deviate of a tail probability of χ² times a number of tries."""
    tail = min(chi2.logsf(saved, max(freedom, 1)) + np.log(tries), -1e-12)
    # Far out the tail underflows; what a score means, a sum of squares saved, bounds the deviate in any case.
    return float(np.clip(-ndtri_exp(tail), 0.0, np.sqrt(saved)))
