"""Estimate the spectrum of the noise from the residual of a model, without a parametric form.

Whatever a model misses repeats with the drive; noise does not. So the difference of the residual between two halves of
a periodic recording shows the noise alone, unrecorded forces that pass through the plant among it. Recordings at one
sampling rate share a spectrum; one that has no period and no such neighbours gives the running median of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.signal import periodogram
from scipy.sparse import csr_array

from phnn.recordings.recording import Recording

Array = NDArray[np.float64]

# Samples over which noise is taken to be correlated at most: zeros appended before a transform.
_CORRELATED = 512
# Ordinates in the lowest and the highest bands of a spectrum: few enough to follow a resonance of the plant.
_LOWEST, _HIGHEST = 4, 12
# Neighbouring frequencies of a running median, and the median of what scatters as χ²₂ over its mean.
_NEIGHBOURS, _MEDIAN = 31, float(np.log(2.0))
# Lower bound of a density, over that of the stated noise: a band of four ordinates falls below by chance once in a
# thousand times.
_LEAST = 0.1
# Fewest samples of the difference of two halves: 64 ordinates, which fill some seven bands.
_FEWEST = 128
# Largest ratio [rms] of noise to stated noise: a larger one is rather what a model misses.
MOST_EXCESS = 2.0
# The same where the noise is stated from its highest frequencies and nothing shows its colour: first-order noise with
# coefficient 0.8 has 81 times their density at the lowest ones.
MOST_UNSEEN = 9.0


@dataclass(frozen=True, eq=False)
class NoiseSpectrum:
    """Spectrum of a residual's noise.

    Attributes:
        cycles: (B,) frequencies in cycles a sample, ascending from 0 to ½.
        density: (B,) over that of white noise of unit variance.
        band: (B,) number of the band whose ordinates gave the density.
        freedom: (K,) degrees of freedom of each band.
    """

    cycles: Array
    density: Array
    band: NDArray[np.int64]
    freedom: Array

    def at(self, cycles: Array) -> Array:
        """The density at frequencies in cycles a sample."""
        return np.interp(cycles, self.cycles, self.density)

    def covariance(self, columns: Array) -> Array:
        """(C, C) covariance of ``columnsᵀ noise`` for columns (N, C): ``Σ_f S(f) D*(f) D(f) / N``, zero-padded so that
        the end of the columns does not meet their beginning."""
        root = self._shaped(columns)[0]
        return np.asarray(root.real.T @ root.real + root.imag.T @ root.imag)

    def by_band(self, columns: Array) -> Array:
        """(K, C) variances in `covariance` by the band whose density gives them."""
        root, cycles = self._shaped(columns)
        after = np.clip(np.searchsorted(self.cycles, cycles), 1, self.cycles.size - 1)
        first, last = self.cycles[after - 1], self.cycles[after]
        share = np.clip((cycles - first) / (last - first), 0.0, 1.0)
        # Of an interpolated density, each band gives its part.
        share *= self.density[after] / self.at(cycles)
        at = np.arange(cycles.size)
        entries = (np.concatenate([1.0 - share, share]), (self.band[np.r_[after - 1, after]], np.r_[at, at]))
        bands = csr_array(entries, shape=(self.freedom.size, cycles.size))
        return np.asarray(bands @ (root.real**2 + root.imag**2))

    def _shaped(self, columns: Array) -> tuple[NDArray[np.complex128], Array]:
        """(F, C) transforms of columns (N, C), in units of the noise, and their frequencies (F,)."""
        size = _fast(columns.shape[0] + _CORRELATED)
        waves = np.fft.rfft(columns, size, axis=0)
        cycles = np.arange(waves.shape[0]) / size
        weight = self.at(cycles) / size
        # All frequencies but the first (and the last of an even number) stand for two.
        weight[1 : (size + 1) // 2] *= 2.0
        return np.sqrt(weight)[:, None] * waves, cycles


def noise_spectra(
    residuals: Sequence[Array], recordings: Sequence[Recording], most: float = MOST_EXCESS, unseen: float = MOST_UNSEEN
) -> list[NoiseSpectrum]:
    """Return the spectrum of every recording's noise, in units of its stated variance: the mean over all recordings at
    its sampling rate that repeat, its own where none does.

    Args:
        residuals: (N_r,) weighted, of the identification samples of each recording.
        most, unseen: as in `most_excess`.
    """
    differences = [difference(r, recording) for r, recording in zip(residuals, recordings, strict=True)]
    found: list[NoiseSpectrum] = []
    averaged: dict[tuple[int, ...], NoiseSpectrum] = {}
    for residual, recording in zip(residuals, recordings, strict=True):
        alike = tuple(
            j for j, (d, other) in enumerate(zip(differences, recordings, strict=True))
            if d is not None and abs(other.dt / recording.dt - 1.0) < 1e-6
        )  # fmt: skip
        if alike and alike not in averaged:
            averaged[alike] = _averaged([d for j in alike if (d := differences[j]) is not None])
        found.append(averaged[alike] if alike else _running_median(residual, most_excess([recording], most, unseen)))
    return found


def difference(residual: Array, recording: Recording) -> Array | None:
    """What does not repeat: the difference over √2 of two halves of the residual, whole periods apart.

    The first period is left out, for it holds a transient. None where there are fewer than three periods.
    """
    if recording.period is None:
        return None
    period = recording.period / recording.dt
    skip = 0 if recording.start.state == "periodic" else 1
    whole = int((residual.size + 0.02 * period) / period) - skip
    if whole < 2:
        return None
    first, lag = round(skip * period), round(whole // 2 * period)
    later = residual[first + lag :]
    difference = (later - residual[first : first + later.size]) / np.sqrt(2.0)
    return difference - difference.mean() if difference.size >= _FEWEST else None


def _averaged(sequences: Sequence[Array]) -> NoiseSpectrum:
    """Mean periodogram of all sequences in bands that widen from the lowest frequency on.

    Below the lowest frequency seen it goes on with the slope in the lowest decade, if that falls with frequency.
    """
    pairs = [periodogram(s, detrend="constant") for s in sequences]
    # One-sided, at one sample per second: white noise of unit variance has the density 2.
    cycles, power = (np.concatenate([p[i][1:] for p in pairs]) for i in (0, 1))
    order = np.argsort(cycles, kind="stable")
    cycles, power = cycles[order], 0.5 * power[order]
    edges = [0]
    while edges[-1] < cycles.size:
        last = min(edges[-1] + int(np.clip(edges[-1] // 3, _LOWEST, _HIGHEST)), cycles.size) - 1
        # Recordings of equal length have ordinates at the same frequencies: these stay together.
        edges.append(int(np.searchsorted(cycles, cycles[last] * (1.0 + 1e-9), side="right")))
    # What remains at the highest frequencies joins the last whole band.
    edges = [*edges[:-2], cycles.size] if len(edges) > 2 else [0, cycles.size]
    sizes = np.diff(edges)
    at, density = (np.add.reduceat(x, edges[:-1]) / sizes for x in (cycles, power))
    density = np.maximum(density, _LEAST)
    slope = _slope(at, density, sizes)
    below = at[0] / np.array([300.0, 100.0, 30.0, 10.0, 3.0])
    return NoiseSpectrum(
        np.concatenate([[0.0], below, at, [0.5]]),
        np.concatenate([density[:1] * 300.0**-slope, density[0] * (below / at[0]) ** slope, density, density[-1:]]),
        np.concatenate([np.zeros(1 + below.size, dtype=int), np.arange(at.size), [at.size - 1]]),
        # An ordinate is the sum of two squares.
        np.asarray(2.0 * sizes, dtype=np.float64),
    )


def _slope(at: Array, density: Array, sizes: NDArray[np.int64]) -> float:
    """Exponent of the frequency in the lowest decade of a spectrum, between −2 (a random walk) and 0."""
    low = at <= 10.0 * at[0]
    if low.sum() < 3:
        return 0.0
    found = np.polyfit(np.log(at[low]), np.log(density[low]), 1, w=np.sqrt(sizes[low]))[0]
    return float(np.clip(found, -2.0, 0.0))


def _running_median(residual: Array, most: float) -> NoiseSpectrum:
    """The running median of a periodogram: what repeats stands in single lines, which a median passes over.

    Args:
        most: largest ratio [rms] of noise to stated noise.
    """
    cycles, power = periodogram(residual, detrend="constant")
    level = median_filter(0.5 * power[1:], min(_NEIGHBOURS, power.size - 1), mode="nearest") / _MEDIAN
    density = np.clip(np.concatenate([level[:1], level]), _LEAST, most**2)
    band = np.arange(cycles.size) // _NEIGHBOURS
    # The median of exponential variables has 1/ln²2 times the variance of their mean.
    freedom = np.full(int(band[-1]) + 1, 2.0 * _MEDIAN**2 * _NEIGHBOURS)
    return NoiseSpectrum(cycles, np.asarray(density), band, freedom)


def _fast(size: int) -> int:
    """A length at or above ``size`` that is transformed quickly."""
    from scipy.fft import next_fast_len

    return int(next_fast_len(size, real=True))


def most_excess(recordings: Sequence[Recording], most: float = MOST_EXCESS, unseen: float = MOST_UNSEEN) -> float:
    """Return the largest ratio [rms] of noise to stated noise: ``unseen`` where no recording shows the colour of its
    noise, ``most`` otherwise."""
    return unseen if all(r.colour_unseen for r in recordings) else most
