"""Covariance of least-squares estimates under noise of any colour and size, and under what the model misses.

An estimate errs by ``C Jᵀ n`` with ``C = (JᵀJ)⁻¹``, the Jacobian ``J`` and the noise ``n``. In the orthonormal basis
``Q = J T`` with ``T Tᵀ = C`` its covariance is ``T M Tᵀ`` with the covariance ``M = Qᵀ E[n nᵀ] Q``, to which every
recording adds three parts:

1. stationary noise with the spectrum ``S`` that repetitions show: ``Σ_f S(f) Q̂*(f) Q̂(f)``. Blocks of scores would
need no spectrum, but twenty of them cover too seldom where the noise is coloured: a block cuts the correlation at its
ends, and what a fit has taken out of the residual of a block is missing in its score; 2. noise of uneven size, such as
jitter of the sampling instants: ``Σ_i (u_i − ū) q_i q_iᵀ`` with ``u_i = r_i²/(1 − h_i)²``, the sample ``r_i`` of the
residual and its leverage ``h_i = |q_i|²``: the estimator of White (1980) in place of the mean variance, with the
correction HC3 of MacKinnon & White (1985); 3. lines of the residual that noise does not explain. They repeat with the
drive, so that the model misses them, and the fit has moved the estimates to take up what it could of their cause. Each
line counts as a disturbance of unknown phase with the power ``|r̂(f)|²/(1 − h(f))²``: HC3 again, which corrects for the
share that the fit took up.

The sum is an estimate itself. Its degrees of freedom follow from the variance of parts 2 and 3 (Satterthwaite 1946);
intervals take the quantile of Student's t from them. The averaged spectrum of part 1 counts as known.

Anchors bring uncertainty into a fit. It holds an anchor ``a`` at its stated value and minimises ``½|r(z, a)|²`` over
``z`` alone. At the optimum ``Jᵀr = 0`` with ``J = ∂r/∂z``, so that by the implicit function theorem (Gauss–Newton,
without second derivatives)

    dz/da = −(JᵀJ)⁻¹ Jᵀ ∂r/∂a

and an anchor of variance ``s²`` adds ``(dz/da) s² (dz/da)ᵀ`` to the covariance of ``z``. No table of exponents is
needed: where voltage and displacement leave one factor open, this gives ``d ln k / d ln m = 1`` by itself, and ratios
such as ``k/m`` keep their standard error.

The spectrum of the noise is estimated from the residual, without a parametric form. Whatever a model misses repeats
with the drive; noise does not. So the difference of the residual between two halves of a periodic recording shows the
noise alone, unrecorded forces that pass through the plant among it. Recordings at one sampling rate share a spectrum;
one that has no period and no such neighbours gives the running median of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len
from scipy.ndimage import median_filter
from scipy.signal import periodogram
from scipy.sparse import csr_array

from phnn.derivatives import output_derivatives
from phnn.identification.problem import Problem, beyond_limit, without_nuisances
from phnn.recordings.recording import Recording
from phnn.trajectory import Trajectory

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
        """Return the density at frequencies in cycles a sample."""
        return np.interp(cycles, self.cycles, self.density)

    def covariance(self, columns: Array) -> Array:
        """Return (C, C) covariance of ``columnsᵀ noise`` for columns (N, C): ``Σ_f S(f) D*(f) D(f) / N``, zero-padded
        so that the end of the columns does not meet their beginning."""
        root = self._shaped(columns)[0]
        return np.asarray(root.real.T @ root.real + root.imag.T @ root.imag)

    def by_band(self, columns: Array) -> Array:
        """Return (K, C) variances in `covariance` by the band whose density gives them."""
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
        """Return (F, C) transforms of columns (N, C), in units of the noise, and their frequencies (F,)."""
        size = next_fast_len(columns.shape[0] + _CORRELATED, real=True)
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
    spectra: list[NoiseSpectrum] = []
    averaged: dict[tuple[int, ...], NoiseSpectrum] = {}
    for residual, recording in zip(residuals, recordings, strict=True):
        alike = tuple(
            j for j, (d, other) in enumerate(zip(differences, recordings, strict=True))
            if d is not None and abs(other.dt / recording.dt - 1.0) < 1e-6
        )  # fmt: skip
        if alike and alike not in averaged:
            averaged[alike] = _averaged([d for j in alike if (d := differences[j]) is not None])
        spectra.append(averaged[alike] if alike else _running_median(residual, most_excess([recording], most, unseen)))
    return spectra


def difference(residual: Array, recording: Recording) -> Array | None:
    """Return what does not repeat: the difference over √2 of two halves of the residual, whole periods apart.

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
    """Return the mean periodogram of all sequences in bands that widen from the lowest frequency on.

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
    """Return the exponent of the frequency in the lowest decade of a spectrum, between −2 (a random walk) and 0."""
    low = at <= 10.0 * at[0]
    if low.sum() < 3:
        return 0.0
    exponent = np.polyfit(np.log(at[low]), np.log(density[low]), 1, w=np.sqrt(sizes[low]))[0]
    return float(np.clip(exponent, -2.0, 0.0))


def _running_median(residual: Array, most: float) -> NoiseSpectrum:
    """Return the running median of a periodogram, at most a ratio ``most`` [rms] over the stated noise: what repeats
    stands in single lines, which a median passes over."""
    cycles, power = periodogram(residual, detrend="constant")
    level = median_filter(0.5 * power[1:], min(_NEIGHBOURS, power.size - 1), mode="nearest") / _MEDIAN
    density = np.clip(np.concatenate([level[:1], level]), _LEAST, most**2)
    band = np.arange(cycles.size) // _NEIGHBOURS
    # The median of exponential variables has 1/ln²2 times the variance of their mean.
    freedom = np.full(int(band[-1]) + 1, 2.0 * _MEDIAN**2 * _NEIGHBOURS)
    return NoiseSpectrum(cycles, np.asarray(density), band, freedom)


def most_excess(recordings: Sequence[Recording], most: float = MOST_EXCESS, unseen: float = MOST_UNSEEN) -> float:
    """Return the largest ratio [rms] of noise to stated noise: ``unseen`` where no recording shows the colour of its
    noise, ``most`` otherwise."""
    return unseen if all(r.colour_unseen for r in recordings) else most


def held_anchors(problem: Problem) -> dict[str, float]:
    """Standard deviations [SI] of the anchors that a problem's setup has and does not estimate; exact ones left out."""
    names = problem.template.parameters
    estimated = problem.variables.names
    return {n: s for n, s in problem.plan.anchors.items() if s > 0.0 and n in names and n not in estimated}


def residual_by_anchors(problem: Problem, z: Array, names: tuple[str, ...]) -> Array:
    """Return (N, A) derivatives of the weighted residual by A held parameters [1/SI unit], initial states unchanged."""
    nuisances = problem.template.own

    def one(recording: Recording, trajectory: Trajectory, mask: Array) -> Array:
        hidden = beyond_limit(recording, trajectory.y, mask, nuisances)
        changes = without_nuisances(output_derivatives(trajectory, names), mask, recording, nuisances, hidden)
        return np.asarray(changes / -recording.noise)

    return np.concatenate(problem.plan.each(one, problem.trajectories(z), problem.masks))


# Directions whose information is this share of the best one's are known no better than that.
_RANK = 1e-14
# Probability that white noise shows a line anywhere in a recording.
_BY_CHANCE = 0.05
# A sample or frequency that alone fixes a parameter has a leverage of one; then its residual tells nothing.
_HIGHEST_LEVERAGE = 0.98
# Student's t does not differ from a normal variable any more.
_MOST_FREEDOM = 1e6


@dataclass(frozen=True)
class Scatter:
    """How far estimates scatter.

    Attributes:
        covariance: (K, K) of the estimates.
        freedom: (K,) degrees of freedom with which their variances are known, infinite where nothing was estimated.
    """

    covariance: Array
    freedom: Array


# What one recording adds: to ``M`` (K, K), and to the variance of the variances (K,) of the estimates.
_Share = tuple[Array, Array]


def bread(jacobian: Array) -> Array:
    """Return ``(JᵀJ)⁻¹``; a direction without information keeps a huge variance, where a pseudo-inverse would call it
    exactly known."""
    root = _root(jacobian)
    return np.asarray(root @ root.T)


def _root(jacobian: Array) -> Array:
    """Return (K, K) ``T`` with ``T Tᵀ = (JᵀJ)⁻¹``, of columns of one length: a large unit must not hide the others."""
    sizes = np.linalg.norm(jacobian, axis=0)
    sizes[sizes == 0.0] = 1.0
    columns = jacobian / sizes
    values, vectors = np.linalg.eigh(columns.T @ columns)
    least = max(_RANK * values[-1], np.finfo(float).tiny)
    return np.asarray(vectors / np.sqrt(np.maximum(values, least)) / sizes[:, None])


def scatter(residual: Array, jacobian: Array, recordings: Sequence[Recording], slices: Sequence[slice]) -> Scatter:
    """Return the covariance of estimates, as the module says; never below that of white noise of the stated deviation.

    Args:
        residual: (N,) weighted by the stated deviation of the noise; jacobian: (N, K) its derivatives.
        recordings: of which it consists; slices: their rows, in the same order.
    """
    count = jacobian.shape[1]
    if count == 0:
        return Scatter(np.zeros((0, 0)), np.zeros(0))
    root = _root(jacobian)
    basis = jacobian @ root
    parts = [residual[r] for r in slices]
    # Without repetitions nothing tells noise from what the model misses. All of it counts, but a line is held against
    # what noise can be.
    spectra = noise_spectra(parts, recordings, np.inf, np.inf)
    bounded = noise_spectra(parts, recordings, unseen=MOST_EXCESS)
    middle, doubt = np.zeros((count, count)), np.zeros(count)
    for part, rows, spectrum, least in zip(parts, slices, spectra, bounded, strict=True):
        q, cycles = basis[rows], np.arange(part.size // 2 + 1) / part.size
        middle += spectrum.covariance(q)
        lines = _lines(part, q, root, spectrum.at(cycles), least.at(cycles))
        for more, uncertain in (_uneven(part, q, root), lines):
            middle += more
            doubt += uncertain
    # Where the sum is below one, the noise would be smaller than what is stated: no combination is known that well.
    values, vectors = np.linalg.eigh(middle)
    spread = root @ vectors
    covariance = (spread * np.maximum(values, 1.0)) @ spread.T
    # Without a doubt there are endlessly many.
    with np.errstate(over="ignore"):
        freedom = 2.0 * np.diag(covariance) ** 2 / np.maximum(doubt, np.finfo(float).tiny)
    return Scatter(covariance, np.minimum(freedom, _MOST_FREEDOM))


def _uneven(residual: Array, basis: Array, root: Array) -> _Share:
    """Return what noise adds where its variance is not the same in all samples (part 2)."""
    leverage = np.minimum(np.einsum("ij,ij->i", basis, basis), _HIGHEST_LEVERAGE)
    squares = (residual / (1.0 - leverage)) ** 2
    middle = basis.T @ ((squares - squares.mean())[:, None] * basis)
    # The variance of a squared normal variable is two thirds of its fourth moment.
    return middle, 2.0 / 3.0 * squares**2 @ (basis @ root.T) ** 4


def _lines(residual: Array, basis: Array, root: Array, density: Array, bounded: Array) -> _Share:
    """Return what lines add that exceed the noise (part 3), of a density (F,) at the frequencies of the recording over
    that of white noise of unit variance; ``bounded`` (F,) is the same, at most what noise can be."""
    n = residual.size
    power = np.abs(np.fft.rfft(residual)) ** 2 / n
    waves = np.fft.rfft(basis, axis=0) / np.sqrt(n)
    # All frequencies but the first (and the last of an even number) stand for two.
    both = np.full(power.size, 2.0)
    both[0] = 1.0
    both[(n + 1) // 2 :] = 1.0
    kept = 1.0 - np.minimum(np.einsum("ij,ij->i", waves.conj(), waves).real, _HIGHEST_LEVERAGE)
    # Under noise the power over its density has an exponential distribution.
    seen = power / kept > bounded * np.log(power.size / _BY_CHANCE)
    excess = both[seen] * np.maximum(power[seen] / kept[seen] ** 2 - density[seen], 0.0)
    shown = waves[seen]
    middle = (shown.conj().T @ (excess[:, None] * shown)).real
    # The variance of an exponential variable is half of its second moment.
    return middle, 0.5 * excess**2 @ np.abs(shown @ root.T) ** 4
