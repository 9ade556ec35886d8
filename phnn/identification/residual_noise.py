"""Estimate the spectrum of the noise from the residual of a model, without a parametric form.

Whatever a model misses repeats with the drive; noise does not. So the difference of the residual between two halves of
a periodic recording shows the noise alone, unrecorded forces that pass through the plant among it. Recordings at one
sampling rate share a spectrum; one that has no period and no such neighbours gives the running median of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.signal import periodogram

from phnn.criteria import NOISE, Noise
from phnn.recordings.recording import Recording

Array = NDArray[np.float64]

# Samples over which noise is taken to be correlated at most: zeros appended before a transform.
_CORRELATED = 512
# Ordinates in the lowest and the highest bands of a spectrum: few enough to follow a resonance of the plant.
_LOWEST, _HIGHEST = 4, 12
# Neighbouring frequencies of a running median, and the median of what scatters as χ²₂ over its mean.
_NEIGHBOURS, _MEDIAN = 31, float(np.log(2.0))
# Recordings beside one that are enough to know its noise by.
_BESIDE = 8


@dataclass(frozen=True, eq=False)
class NoiseSpectrum:
    """Spectrum of a residual's noise.

    Attributes:
        cycles: (B,) frequencies in cycles a sample, ascending from 0 to ½.
        density: (B,) over that of white noise of unit variance.
    """

    cycles: Array
    density: Array

    def at(self, cycles: Array) -> Array:
        """The density at frequencies in cycles a sample."""
        return np.interp(cycles, self.cycles, self.density)

    def covariance(self, columns: Array) -> Array:
        """(C, C) covariance of ``columnsᵀ noise`` for columns (N, C): ``Σ_f S(f) D*(f) D(f) / N``, zero-padded so that
        the end of the columns does not meet their beginning."""
        size = _fast(columns.shape[0] + _CORRELATED)
        waves = np.fft.rfft(columns, size, axis=0)
        weight = self.at(np.arange(waves.shape[0]) / size) / size
        # All frequencies but the first (and the last of an even number) stand for two.
        weight[1 : (size + 1) // 2] *= 2.0
        root = np.sqrt(weight)[:, None] * waves
        return np.asarray(root.real.T @ root.real + root.imag.T @ root.imag)


def noise_spectra(
    residuals: Sequence[Array], recordings: Sequence[Recording], rule: Noise = NOISE
) -> list[NoiseSpectrum]:
    """The spectrum of every recording's noise, in units of its stated variance.

    Args:
        residuals: (N_r,) weighted, of the identification samples of each recording.
        rule: when a spectrum is believed.
    """
    return _spectra(residuals, recordings, rule, lambda _, alike: list(alike.values()))


def noise_of_others(
    residuals: Sequence[Array], recordings: Sequence[Recording], rule: Noise = NOISE
) -> list[NoiseSpectrum]:
    """The spectrum of every recording's noise as others at its sampling rate show it, so that what one recording alone
    does not repeat is no noise of its own; its own where there are no others with periods.

    Args:
        residuals: (N_r,) weighted, of the identification samples of each recording.
        rule: when a spectrum is believed.
    """

    def others(i: int, alike: Mapping[int, Array]) -> list[Array]:
        return [d for j, d in alike.items() if j != i][:_BESIDE] or list(alike.values())

    return _spectra(residuals, recordings, rule, others)


def _spectra(
    residuals: Sequence[Array],
    recordings: Sequence[Recording],
    rule: Noise,
    chosen: Callable[[int, Mapping[int, Array]], list[Array]],
) -> list[NoiseSpectrum]:
    """The spectrum of every recording from some of the differences at its sampling rate, its own where there are none.

    Args:
        chosen: takes the number of a recording and the differences at its rate by the number of theirs.
    """
    differences = [
        difference(r, recording, rule.difference_samples) for r, recording in zip(residuals, recordings, strict=True)
    ]
    found = []
    for i, (residual, recording) in enumerate(zip(residuals, recordings, strict=True)):
        alike = {
            j: d for j, (d, other) in enumerate(zip(differences, recordings, strict=True))
            if d is not None and abs(other.dt / recording.dt - 1.0) < 1e-6
        }  # fmt: skip
        shown = chosen(i, alike)
        most = most_excess([recording], rule)
        found.append(_averaged(shown, rule) if shown else _running_median(residual, rule.least_density, most))
    return found


def difference(residual: Array, recording: Recording, fewest: int = NOISE.difference_samples) -> Array | None:
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
    return difference - difference.mean() if difference.size >= fewest else None


def _averaged(sequences: Sequence[Array], rule: Noise) -> NoiseSpectrum:
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
        edges.append(edges[-1] + int(np.clip(edges[-1] // 3, _LOWEST, _HIGHEST)))
    # What remains at the highest frequencies joins the last whole band.
    edges = [*edges[:-2], cycles.size] if len(edges) > 2 else [0, cycles.size]
    sizes = np.diff(edges)
    at, density = (np.add.reduceat(x, edges[:-1]) / sizes for x in (cycles, power))
    density = np.maximum(density, rule.least_density)
    slope = _slope(at, density, sizes)
    below = at[0] / np.array([300.0, 100.0, 30.0, 10.0, 3.0])
    return NoiseSpectrum(
        np.concatenate([[0.0], below, at, [0.5]]),
        np.concatenate([density[:1] * 300.0**-slope, density[0] * (below / at[0]) ** slope, density, density[-1:]]),
    )


def _slope(at: Array, density: Array, sizes: NDArray[np.int64]) -> float:
    """Exponent of the frequency in the lowest decade of a spectrum, between −2 (a random walk) and 0."""
    low = at <= 10.0 * at[0]
    if low.sum() < 3:
        return 0.0
    found = np.polyfit(np.log(at[low]), np.log(density[low]), 1, w=np.sqrt(sizes[low]))[0]
    return float(np.clip(found, -2.0, 0.0))


def _running_median(residual: Array, least: float, most: float) -> NoiseSpectrum:
    """The running median of a periodogram: what repeats stands in single lines, which a median passes over.

    Args:
        least: lower bound of the density; most: largest ratio [rms] of noise to stated noise: what exceeds it is rather
            what the model misses.
    """
    cycles, power = periodogram(residual, detrend="constant")
    level = median_filter(0.5 * power[1:], min(_NEIGHBOURS, power.size - 1), mode="nearest") / _MEDIAN
    return NoiseSpectrum(cycles, np.clip(np.concatenate([level[:1], level]), least, most**2))


def _fast(size: int) -> int:
    """A length at or above ``size`` that is transformed quickly."""
    from scipy.fft import next_fast_len

    return int(next_fast_len(size, real=True))


def most_excess(recordings: Sequence[Recording], rule: Noise = NOISE) -> float:
    """Largest ratio [rms] of noise to stated noise: more where no recording shows the colour of its noise."""
    return rule.unseen_excess if all(r.colour_unseen for r in recordings) else rule.greatest_excess
