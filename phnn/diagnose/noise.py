"""Noise of a residual: its spectra, process noise by the response of the model, and variances under it.

A force that nobody records and a white sensor make the spectrum

    S(f) = s (1 + κ |G(f)|²).

Two numbers and the model's own response ``G`` about rest describe it, so that a line hardly raises the noise
that it is compared with, and a short recording does not show its resonance as one. ``s`` and ``κ`` are those of
greatest likelihood (Whittle 1953).

Lines stand out of the neighbouring frequencies. A short recording resolves so few of them that an unrecorded force
looks like a line where it makes the plant resonate: the shape of `force_noise` is divided out before neighbours are
averaged.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.optimize import minimize_scalar
from scipy.signal import periodogram

from phnn.identification.residual_noise import NoiseSpectrum
from phnn.recordings.recording import Recording, dominant_frequency
from phnn.signals.first_order import density_of

Array = NDArray[np.float64]
# (F,) amplitude of the output over that of a force, in any unit, at frequencies (F,) [Hz].
Response = Callable[[Array], Array]

# Bounds of log₁₀ κ, for a largest |G| of one: below, the force's part is lost in the sensor's.
_LEAST, _MOST = -2.0, 7.0
# Ordinates whose running median shows the noise beside a line, and multiples of it at which a line is cut off.
_NEIGHBOURS, _CUT = 31, 8.0
# Zero padding of the spectra that are searched; how many periods a recording must have to show a line; the spacing of
# the frequencies in units of what the longest recording resolves, and the highest one in cycles a sample.
_PADDING, _PERIODS, _HIGHEST = 8, 2.0, 0.45
FINER = 0.25
# What a recording resolves: the level around a line is that of so many cells on both sides, but for those in the middle
# that the line itself fills.
_AROUND, _FILLED = 12, 3
LEVEL_CELLS = _AROUND - _FILLED
# Of the power at one frequency: a sine and a cosine.
FREEDOM = 2.0


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
    around = median_filter(power, min(_NEIGHBOURS, power.size), mode="mirror")
    power = np.minimum(power, _CUT * around)

    def cost(exponent: float) -> float:
        shape = 1.0 + 10.0**exponent * passed
        return float(np.mean(np.log(shape)) + np.log(max(np.mean(power / shape), 1e-300)))

    best = minimize_scalar(cost, bounds=(_LEAST, _MOST), method="bounded").x
    shape = 1.0 + 10.0**best * passed
    # An exact model leaves nothing, by which others divide.
    level = max(float(np.mean(power / shape)), 1e-300)
    density = min(level, most) + level * (shape - 1.0)
    return NoiseSpectrum(
        np.concatenate([[0.0], cycles]),
        np.concatenate([density[:1], density]),
        np.zeros(cycles.size + 1, dtype=int),
        np.array([2.0 * cycles.size]),
    )


@dataclass(frozen=True)
class Spectrum:
    """Power of one recording at those of the common frequencies at which it can show a line.

    Attributes:
        rows: (B,) which of them.
        power: (B,) in units of half its mean under noise as stated.
        level: (B,) the same around each frequency, as the residual shows it.
        beside: (B,) whether the recording tells a line from harmonics of what drives it.
    """

    rows: slice
    power: Array
    level: Array
    beside: NDArray[np.bool_]

    @property
    def undriven(self) -> tuple[Array, Array]:
        """(B,) power and degrees of freedom, zero where it is driven."""
        return self.power * self.beside, np.where(self.beside, FREEDOM, 0.0)


@dataclass(frozen=True)
class Spectra:
    """Attributes:
    f: (F,) common frequencies [Hz], as fine as the longest recording asks; each: by recording.
    """

    f: Array
    each: tuple[Spectrum, ...]

    def added(self, values: Callable[[Spectrum], Array]) -> Array:
        """Return the sum (F,) over the recordings."""
        total = np.zeros_like(self.f)
        for spectrum in self.each:
            total[spectrum.rows] += values(spectrum)
        return total

    @cached_property
    def freedom(self) -> Array:
        """(F,) degrees of freedom of all recordings together."""
        return self.added(lambda s: np.full(s.power.shape, FREEDOM))

    @cached_property
    def undriven(self) -> tuple[Array, Array]:
        """(F,) power and degrees of freedom together, of every recording beside harmonics of what drives it."""
        return self.added(lambda s: s.undriven[0]), self.added(lambda s: s.undriven[1])

    def of_others(self, index: int) -> tuple[Array, Array]:
        """`undriven` without one recording, unless that is the only one."""
        power, freedom = (x.copy() for x in self.undriven)
        if len(self.each) > 1:
            own = self.each[index]
            power[own.rows] -= own.undriven[0]
            freedom[own.rows] -= own.undriven[1]
        return power, freedom

    def around(self, lines: Sequence[float]) -> tuple[Array, Array]:
        """(L,) power at some frequencies [Hz] and the level around it, of every recording that can show the line beside
        harmonics of what drives it."""
        shown = [f for f in lines if self.f.size and self.f[0] <= f <= self.f[-1]]
        at = np.searchsorted(self.f, shown)
        found = [
            (s.power[i - s.rows.start], s.level[i - s.rows.start])
            for s in self.each
            for i in at
            if s.rows.start <= i < s.rows.stop and s.beside[i - s.rows.start]
        ]
        power, level = np.array(found).reshape(-1, 2).T
        return power, level

    @property
    def peaks(self) -> tuple[float, ...]:
        """Frequencies [Hz] that hold most power together, of all and off the harmonics of what drives a recording."""
        found = {strongest(self.added(lambda s: s.power), self.freedom), strongest(*self.undriven)}
        return tuple(float(self.f[i]) for i in sorted(found))


def spectra_of(residuals: Sequence[Array], recordings: Sequence[Recording], responses: Sequence[Response]) -> Spectra:
    """Spectra of one residual, weighted by the noise, a recording.

    Args:
        responses: of the plant to a force, by recording.
    """
    pairs = list(zip(residuals, recordings, strict=True))
    longest = max(r.size * recording.dt for r, recording in pairs)
    f = np.arange(_PERIODS / longest, max(_HIGHEST / recording.dt for _, recording in pairs), FINER / longest)
    return Spectra(f, tuple(_spectrum(*pair, f, response) for pair, response in zip(pairs, responses, strict=True)))


def strongest(power: Array, freedom: Array) -> int:
    """Where χ² is least probable, by its normal deviate (Wilson & Hilferty 1931), which never underflows."""
    known = np.maximum(freedom, 1.0)
    spread = 2.0 / (9.0 * known)
    deviate = (np.cbrt(np.maximum(power, 0.0) / known) - (1.0 - spread)) / np.sqrt(spread)
    return int(np.argmax(np.where(freedom > 0.5, deviate, -np.inf)))


def _spectrum(residual: Array, recording: Recording, f: Array, response: Response) -> Spectrum:
    n, dt = residual.size, recording.dt
    own = np.asarray(np.fft.rfftfreq(_PADDING * n, dt), dtype=np.float64)
    power = 2.0 / n * np.abs(np.fft.rfft(residual, _PADDING * n)) ** 2
    rows = slice(*(int(i) for i in np.searchsorted(f, [_PERIODS / (n * dt) * (1.0 - 1e-12), _HIGHEST / dt])))
    seen = f[rows]
    stated = density_of(recording.noise_correlation, dt * seen)
    shape = force_noise(residual, dt, response).at(dt * own)
    shown, level = (np.interp(seen, own, x) / stated for x in (power, shape * _level(power / shape)))
    return Spectrum(rows, shown, level, _beside(recording, n * dt, seen))


def _level(power: Array) -> Array:
    """Mean power of the cells around each frequency, those in the middle left out."""
    whole, middle = (uniform_filter1d(power, c * _PADDING + 1, mode="reflect") for c in (_AROUND, _FILLED))
    return np.asarray((_AROUND * whole - _FILLED * middle) / LEVEL_CELLS)


def _beside(recording: Recording, duration: float, f: Array) -> NDArray[np.bool_]:
    """Which frequencies a recording can tell from harmonics of what drives it."""
    driven = dominant_frequency(recording)
    if driven * duration <= _PERIODS:
        return np.ones(f.shape, dtype=bool)
    return np.asarray(np.abs(f - driven * np.round(f / driven)) * duration > 1.0)


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


def covariance(spectra: Sequence[NoiseSpectrum], slices: Sequence[slice], columns: Array) -> Array:
    """Return the covariance (C, C) along columns (N, C) of stationary noise with a spectrum by recording."""
    each = [s.covariance(columns[rows]) for s, rows in zip(spectra, slices, strict=True)]
    return np.asarray(np.sum(each, axis=0))


def degrees_of_freedom(spectra: Sequence[NoiseSpectrum], slices: Sequence[slice], columns: Array) -> float:
    """Return the degrees of freedom of the sum of the variances that `covariance` has on its diagonal.

        ν = 2 (Σ_b V_b)² / Σ_b 2 V_b²/ν_b,    V_b the part of band b of a spectrum, ν_b its degrees of freedom

    (Satterthwaite 1946). A slow change of the output is judged by the few lowest ordinates of a spectrum. The error of
    the slope by which a spectrum goes on below them is not counted.
    """
    # Recordings may share a spectrum: the errors of its bands are common to them.
    parts: dict[int, Array] = {}
    for spectrum, rows in zip(spectra, slices, strict=True):
        variances = spectrum.by_band(columns[rows]).sum(axis=1)
        parts[id(spectrum)] = parts.get(id(spectrum), 0.0) + variances
    bands = {id(s): s.freedom for s in spectra}
    total = sum(float(v.sum()) for v in parts.values())
    doubt = sum(float(np.sum(v**2 / bands[i])) for i, v in parts.items())
    return total**2 / max(doubt, 1e-300)
