"""Lines and slow drifts of a residual: its spectra, and the scores of terms that every recording has of its own.

No other recording tells the size of such a term: a subspace is scored in place of a direction. With an orthonormal
basis ``Q`` of the nuisances of all recordings, base and nuisances projected out, ``‖Qᵀr‖²`` over the mean noise power
along ``Q`` is χ² with as many degrees of freedom as columns, where nothing is missing. The standard normal deviate of
the same tail probability makes it comparable to the score of a direction.

A force that nobody records and a white sensor make the noise

    S(f) = s (1 + κ |G(f)|²).

Two numbers and the model's own response ``G`` about rest describe it, so that a line hardly raises the noise that it is
compared with, and a short recording does not show its resonance as one. ``s`` and ``κ`` are those of greatest
likelihood (Whittle 1953). Lines stand out of the neighbouring frequencies. A short recording resolves so few of them
that an unrecorded force looks like a line where it makes the plant resonate: the shape of `force_noise` is divided out
before neighbours are averaged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.ndimage import maximum_filter1d, median_filter, uniform_filter1d
from scipy.optimize import minimize_scalar
from scipy.signal import periodogram
from scipy.special import ndtri_exp
from scipy.stats import chi2
from scipy.stats import f as f_distribution

from phnn.identification.covariance import NoiseSpectrum, most_excess, noise_spectra
from phnn.identification.problem import drift_columns, line_columns, own_columns, without_nuisances
from phnn.recordings.recording import Recording, dominant_frequency
from phnn.setup import DRIFT_TERMS, Own
from phnn.signals.first_order import density_of

if TYPE_CHECKING:
    from phnn.diagnose.linearised import LinearisedFit

Array = NDArray[np.float64]
# (F,) amplitude of the output over that of a force, in any unit, at frequencies (F,) [Hz].
Response = Callable[[Array], Array]

# Bounds of log₁₀ κ, for a largest |G| of one: below, the force's part is lost in the sensor's.
_LEAST, _MOST = -2.0, 7.0
# Ordinates whose running median shows the noise beside a line, and multiples of it at which a line is cut off.
_NEIGHBOURS, _CUT = 31, 8.0
# Zero padding of the spectra that are searched; how many periods a recording must have to show a line; the spacing of
# the frequencies in units of what the longest recording resolves, and the highest one in cycles a sample.
_PADDING, _PERIODS, _FINER, _HIGHEST = 8, 2.0, 0.25, 0.45
# What a recording resolves: the level around a line is that of so many cells on both sides, but for those in the middle
# that the line itself fills.
_AROUND, _FILLED = 12, 3
_CELLS = _AROUND - _FILLED
# Degrees of freedom of the power at one frequency: a sine and a cosine.
_FREEDOM = 2.0
# Directions weaker than this share of the strongest are rounding; a direction of which the base leaves no more than
# this share of its square is explained by it.
_RANK, _FREE = 1e-9, 1e-10
# Multiples of a line's frequency that come with it.
_HARMONICS = (1, 2, 3)
# Logarithm of the tail probability below which a line stands out of its surroundings; probability below which an
# estimate of a variance contradicts the one that is stated.
_LINE, _CONTRADICTED = float(np.log(0.01)), 0.05
# The same for a wave along the position; how many of them are tried, bins of the position, and padding of the spectrum.
_WAVE, _WAVES, _BINS, _PADDED = float(np.log(1e-4)), 2, 4096, 4


def force_noise(residual: Array, dt: float, response: Response, most: float = np.inf) -> NoiseSpectrum:
    """Return the spectrum ``S`` of a residual.

    Args:
        residual: (N,) weighted by the stated deviation of the noise; dt: sampling interval [s].
        response: of the plant.
        most: bound of the white part ``s``: a larger one is rather what the model misses.
    """
    cycles, power = periodogram(residual, detrend="constant")
    # At rest for ever an integrating plant has no gain.
    cycles, power = cycles[1:], 0.5 * power[1:]
    passed = response(cycles / dt) ** 2
    largest = passed.max()
    passed = passed / largest if 0.0 < largest < np.inf else np.zeros_like(passed)
    power = np.minimum(power, _CUT * median_filter(power, min(_NEIGHBOURS, power.size), mode="mirror"))

    def cost(exponent: float) -> float:
        shape = 1.0 + 10.0**exponent * passed
        return float(np.mean(np.log(shape)) + np.log(max(np.mean(power / shape), 1e-300)))

    shape = 1.0 + 10.0 ** minimize_scalar(cost, bounds=(_LEAST, _MOST), method="bounded").x * passed
    # An exact model leaves nothing, by which others divide.
    level = max(float(np.mean(power / shape)), 1e-300)
    density = min(level, most) + level * (shape - 1.0)
    band, freedom = np.zeros(cycles.size + 1, dtype=int), np.array([2.0 * cycles.size])
    return NoiseSpectrum(np.append(0.0, cycles), np.append(density[:1], density), band, freedom)


class Spectrum(NamedTuple):
    """Power of one recording at those of the common frequencies at which it can show a line.

    Attributes:
        rows: (B,) which of them.
        power: (B,) in units of half its mean under noise as stated.
        level: (B,) the same around each frequency, as the residual shows it.
        off_harmonics: (B,) whether the recording tells a line from harmonics of what drives it.
    """

    rows: slice
    power: Array
    level: Array
    off_harmonics: NDArray[np.bool_]


@dataclass(frozen=True)
class Spectra:
    """Attributes:
    f: (F,) common frequencies [Hz], as fine as the longest recording asks; each: by recording.
    """

    f: Array
    each: tuple[Spectrum, ...]

    def added(self, values: Callable[[Spectrum], Array], some: Iterable[Spectrum] | None = None) -> Array:
        """Return the sum (F,) over the recordings, or some of them."""
        total = np.zeros_like(self.f)
        for spectrum in self.each if some is None else some:
            total[spectrum.rows] += values(spectrum)
        return total

    @property
    def together(self) -> tuple[Array, Array]:
        """Return (F,) power and degrees of freedom of all recordings together."""
        return self.added(lambda s: s.power), self.added(lambda s: np.full_like(s.power, _FREEDOM))

    def undriven(self, without: int = -1) -> tuple[Array, Array]:
        """Return power and degrees of freedom (F,) of every recording beside harmonics of what drives it.

        Args:
            without: number of a recording that is left out, unless it is the only one.
        """
        some = [s for i, s in enumerate(self.each) if i != without] or self.each
        return self.added(lambda s: s.power * s.off_harmonics, some), self.added(
            lambda s: np.where(s.off_harmonics, _FREEDOM, 0.0), some
        )

    def around(self, lines: Sequence[float]) -> tuple[Array, Array]:
        """Return power (L,) at some frequencies [Hz] and the level around it, of every recording that can show the line
        beside harmonics of what drives it."""
        at = np.searchsorted(self.f, [f for f in lines if self.f.size and self.f[0] <= f <= self.f[-1]])
        shown = [(s, i - s.rows.start) for s in self.each for i in at if s.rows.start <= i < s.rows.stop]
        values = [(s.power[i], s.level[i]) for s, i in shown if s.off_harmonics[i]]
        power, level = np.array(values).reshape(-1, 2).T
        return power, level

    @property
    def peaks(self) -> tuple[float, ...]:
        """Frequencies [Hz] that hold most power together, of all and off the harmonics of what drives a recording."""
        return tuple(float(self.f[i]) for i in sorted({_strongest(*self.together), _strongest(*self.undriven())}))


def spectra_of(residuals: Sequence[Array], recordings: Sequence[Recording], responses: Sequence[Response]) -> Spectra:
    """Return the spectra of residuals, weighted by the noise.

    Args:
        residuals: by recording; responses: of the plant to a force, by recording.
    """
    pairs = list(zip(residuals, recordings, strict=True))
    longest = max(r.size * recording.dt for r, recording in pairs)
    f = np.arange(_PERIODS / longest, max(_HIGHEST / recording.dt for _, recording in pairs), _FINER / longest)
    return Spectra(f, tuple(_spectrum(*pair, f, response) for pair, response in zip(pairs, responses, strict=True)))


def _spectrum(residual: Array, recording: Recording, f: Array, response: Response) -> Spectrum:
    n, dt = residual.size, recording.dt
    frequencies = np.asarray(np.fft.rfftfreq(_PADDING * n, dt), dtype=np.float64)
    power = 2.0 / n * np.abs(np.fft.rfft(residual, _PADDING * n)) ** 2
    rows = slice(*(int(i) for i in np.searchsorted(f, [_PERIODS / (n * dt) * (1.0 - 1e-12), _HIGHEST / dt])))
    stated = density_of(recording.noise_correlation, dt * f[rows])
    shape = force_noise(residual, dt, response).at(dt * frequencies)
    # The mean of the cells around each frequency, those in the middle left out.
    sizes = ((_AROUND, _AROUND * _PADDING + 1), (-_FILLED, _FILLED * _PADDING + 1))
    level = sum(cells / _CELLS * uniform_filter1d(power / shape, size, mode="reflect") for cells, size in sizes)
    shown, around = (np.interp(f[rows], frequencies, x) / stated for x in (power, shape * level))
    driven = dominant_frequency(recording)
    off_harmonics = np.ones(shown.shape, dtype=bool)
    if driven * n * dt > _PERIODS:
        off_harmonics = np.abs(f[rows] - driven * np.round(f[rows] / driven)) * n * dt > 1.0
    return Spectrum(rows, shown, around, off_harmonics)


def _strongest(power: Array, freedom: Array) -> int:
    """Return where χ² is least probable, by its normal deviate (Wilson & Hilferty 1931), which never underflows."""
    known = np.maximum(freedom, 1.0)
    spread = 2.0 / (9.0 * known)
    deviate = (np.cbrt(np.maximum(power, 0.0) / known) - (1.0 - spread)) / np.sqrt(spread)
    return int(np.argmax(np.where(freedom > 0.5, deviate, -np.inf)))


def strongest_line(spectra: Spectra) -> tuple[float, float, float]:
    """Return the frequency [Hz] at which recordings' residuals hold most power together, and its normal deviates.

    The periodograms of all recordings, each over the spectrum of its stated noise, are added up; so are the levels
    around each frequency. The power is χ² under noise as stated, and its ratio to the level is F under noise of any
    spectrum that is smooth over a dozen of the cells that a recording resolves, a resonance of the plant for instance.
    The tail probability of the largest value is multiplied by the number of frequencies.
    """
    (power, freedom), level, tries = spectra.together, spectra.added(lambda s: s.level), spectra.f.size * _FINER
    tails = np.where(freedom > 0.5, _over_level(_ratio(power, level), np.maximum(freedom, 1.0)), 0.0) + np.log(tries)
    least = float(tails.min(initial=0.0))
    # What stands out of its surroundings is the line, not what is strong because a resonance is.
    best = int(np.argmin(tails)) if least < _LINE else _strongest(power, freedom)
    stated = _deviate(float(power[best]), int(freedom[best]), tries)
    return float(spectra.f[best]), stated, min(_normal(least), stated)


def wavelengths(linearised: LinearisedFit) -> list[float]:
    """Return the periods, the clearest first, with which a residual repeats along the measured position.

    The residual is summed up in bins of the position, apart for each recording and direction of motion, and divided by
    the root of their number of samples: where nothing is missing these sums are white. The powers of their spectra are
    added up, and a period is one whose power stands out of the periods beside it, longer and shorter ones alike.
    """
    recordings, senses = linearised.plan.recordings, linearised.fit.setup.network.senses
    along = [
        ((r.u if senses else r.y)[r.mask("identification")], linearised.residual[rows])
        for r, rows in zip(recordings, linearised.slices, strict=True)
        if rows.stop - rows.start > 1 and not r.sensor.derivative
    ]
    if not along:
        return []
    least, most = min(x.min() for x, _ in along), max(x.max() for x, _ in along)
    power = np.zeros(_PADDED * _BINS // 2 + 1)
    for x, residual in along:
        bins = np.minimum((_BINS * (x - least) / max(most - least, 1e-300)).astype(int), _BINS - 1)
        forwards = np.gradient(x) > 0.0
        for stroke in (forwards, ~forwards):
            count = np.bincount(bins[stroke], minlength=_BINS)
            sums = np.bincount(bins[stroke], residual[stroke], _BINS) / np.sqrt(np.maximum(count, 1))
            power += np.abs(np.fft.rfft(sums, _PADDED * _BINS)) ** 2 / max(np.count_nonzero(count), 1)
    # The larger mean of the cells on either side: the spectrum of a smooth law falls steadily.
    at = np.arange(2 * _PADDED, power.size // 2)
    added = np.append(0.0, np.cumsum(power))
    above = (added[at + _AROUND * _PADDED] - added[at + _FILLED * _PADDED]) / (_CELLS * _PADDED)
    first, last = np.maximum(at - _AROUND * _PADDED, 0), np.maximum(at - _FILLED * _PADDED, 0)
    below = (added[last] - added[first]) / np.maximum(last - first, 1)
    ratio = power[at] / np.maximum(np.maximum(above, below), 1e-300)
    tails = _over_level(ratio, 2.0 * _FREEDOM * len(along)) + np.log(at.size / _PADDED)
    peaks = (power[at] >= maximum_filter1d(power, 2 * _PADDED + 1)[at]) & (tails < _WAVE)
    clearest = sorted(np.flatnonzero(peaks), key=lambda i: -ratio[i])[:_WAVES]
    return [_PADDED * (most - least) / float(at[i]) for i in clearest]


def own_score(linearised: LinearisedFit, nuisances: Own, spectra: Spectra) -> tuple[float, float]:
    """Return normal deviates of the residual's power along the recordings' nuisances, out of the noise as stated and as
    the residual has it; zero where no recording can show them.

    The floor of a recording is an estimate, its colour even more so. Where nothing is missing the residual is noise, so
    it shows what the noise is. Lines are held against a force that nobody records too, and against what lies beside
    them.
    """
    setup, recordings, slices = linearised.fit.setup, linearised.plan.recordings, linearised.slices
    columns = [
        without_nuisances(own_columns(r, nuisances), r.mask("identification"), r, setup.own, hidden)
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
    count, residuals = q.shape[1], [linearised.residual[rows] for rows in slices]
    noise, stated = noise_spectra(residuals, recordings), float(np.mean(stated_variances(recordings, slices, q)))
    cov = np.sum([s.covariance(q[rows]) for s, rows in zip(noise, slices, strict=True)], axis=0)
    saved, excess = float(np.sum((q.T @ linearised.residual) ** 2) / stated), max(np.trace(cov) / count / stated, 1.0)
    deviate = _deviate(saved, count)
    if nuisances.drift_terms > setup.own.drift_terms:
        judged, known = _deviate(saved / excess, count), degrees_of_freedom(noise, slices, q)
        if chi2.sf(known * excess, known) <= _CONTRADICTED:
            # It is compared with the few lowest ordinates, and the variances along it differ (Satterthwaite 1946).
            along = float(np.trace(cov) ** 2 / np.sum(cov**2))
            judged = min(judged, _normal(float(f_distribution.logsf(saved / excess / count, along, known))))
        return deviate, judged
    # A line raises the spectrum that it is compared with; a slow drift does not, it is slower than that spectrum.
    excess, total = min(excess, most_excess(recordings) ** 2), np.zeros(count)
    for r, recording, rows in zip(residuals, recordings, slices, strict=True):
        forced = force_noise(r, recording.dt, linearised.response(recording), most_excess([recording]) ** 2)
        # Such a spectrum is one band.
        total += forced.by_band(q[rows])[0]
    judged = _deviate(saved / max(excess, float(np.mean(total)) / stated), count)
    power, level = spectra.around([f for f in nuisances.lines if f not in setup.own.lines])
    if power.size:
        judged = min(judged, _normal(float(_over_level(np.mean(_ratio(power, level)), _FREEDOM * power.size))))
    return deviate, judged


def line_share(linearised: LinearisedFit) -> float:
    """Return the sum of squares that lines take away, in units of the noise, at frequencies that other recordings tell.

    What drives a recording repeats at its own frequency and tells of no line: it is asked beside harmonics of it.
    """
    spectra, saved = linearised.spectra, 0.0
    for i, (recording, rows) in enumerate(zip(linearised.plan.recordings, linearised.slices, strict=True)):
        power, freedom = spectra.undriven(without=i)
        lines = [k * spectra.f[_strongest(power, freedom)] for k in _HARMONICS]
        columns = line_columns(recording, lines)[recording.mask("identification")]
        if columns.shape[1] and freedom.max() > 0.5:
            components = np.linalg.qr(columns)[0].T @ linearised.residual[rows]
            saved += float(components @ components) - components.size
    return max(saved, 0.0)


def drift_share(linearised: LinearisedFit) -> float:
    """Return the sum of squares that a slow drift of each recording removes, in units of the noise.

    The drift is fitted to every other stretch of a recording and predicts the stretches between.
    """
    saved = 0.0
    for recording, rows in zip(linearised.plan.recordings, linearised.slices, strict=True):
        columns = drift_columns(recording, DRIFT_TERMS)[recording.mask("identification")]
        columns, error = np.column_stack([np.ones(columns.shape[0]), columns]), linearised.residual[rows]
        odd = (np.arange(error.size) * 4 * columns.shape[1] // error.size) % 2 == 1
        for fitted in (odd, ~odd):
            weights = np.linalg.lstsq(columns[fitted], error[fitted], rcond=_RANK)[0]
            saved += float(error[~fitted] @ error[~fitted] - np.sum((error[~fitted] - columns[~fitted] @ weights) ** 2))
    return max(saved, 0.0)


def stated_variances(recordings: Sequence[Recording], slices: Sequence[slice], columns: Array) -> Array:
    """Return the variances (C,) along columns (N, C) of the noise that recordings state.

    Args:
        slices: rows of every recording.
    """
    total = np.zeros(columns.shape[1])
    for recording, rows in zip(recordings, slices, strict=True):
        rho, block = recording.noise_correlation, columns[rows]
        total += np.einsum("ij,ij->j", block, block)
        for lag in range(1, min(rho.size, block.shape[0])):
            if rho[lag] != 0.0:
                total += 2.0 * rho[lag] * np.einsum("ij,ij->j", block[lag:], block[:-lag])
    return total


def degrees_of_freedom(spectra: Sequence[NoiseSpectrum], slices: Sequence[slice], columns: Array) -> float:
    """Return the degrees of freedom of the sum of the variances along columns (N, C) by the spectra of recordings.

        ν = 2 (Σ_b V_b)² / Σ_b 2 V_b²/ν_b,    V_b the part of band b of a spectrum, ν_b its degrees of freedom

    (Satterthwaite 1946). A slow change of the output is judged by the few lowest ordinates of a spectrum. The error of
    the slope by which a spectrum goes on below them is not counted.
    """
    total = doubt = 0.0
    # Recordings may share a spectrum: the errors of its bands are common to them.
    for spectrum in {id(s): s for s in spectra}.values():
        its_slices = [rows for s, rows in zip(spectra, slices, strict=True) if s is spectrum]
        variances = np.sum([spectrum.by_band(columns[rows]).sum(axis=1) for rows in its_slices], axis=0)
        total, doubt = total + float(variances.sum()), doubt + float(np.sum(variances**2 / spectrum.freedom))
    return total**2 / max(doubt, 1e-300)


def _ratio(power: Array, level: Array) -> Array:
    """Return powers over the levels around them."""
    return np.asarray(power / np.maximum(level, 1e-300))


def _over_level(ratio: Array | np.floating, freedom: Array | float) -> Array:
    """Return logarithms of the tail probabilities of ratios of powers, of some degrees of freedom, to their levels."""
    return np.asarray(f_distribution.logsf(ratio, freedom, _CELLS * freedom))


def _normal(tail: float) -> float:
    """Return the normal deviate, at least 0, of a logarithm of a tail probability."""
    return max(float(-ndtri_exp(min(tail, -1e-12))), 0.0)


def _deviate(saved: float, freedom: int, tries: float = 1.0) -> float:
    """Return the normal deviate of a tail probability of χ² times a number of tries."""
    # Far out the tail underflows; what a score means, a sum of squares saved, bounds the deviate in any case.
    return min(_normal(float(chi2.logsf(saved, max(freedom, 1)) + np.log(tries))), float(np.sqrt(saved)))
