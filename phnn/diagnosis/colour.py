"""The noise that scores are judged with: as the recordings state it, and as the residual has it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri_exp
from scipy.stats import chi2
from scipy.stats import t as student

from phnn.criteria import Noise
from phnn.diagnosis.force_noise import force_noise
from phnn.diagnosis.linearised_fit import LinearisedFit
from phnn.identification.residual_noise import NoiseSpectrum, most_excess, noise_spectra
from phnn.recordings.recording import Recording

Array = NDArray[np.float64]

# Standard deviation of a normal variable over its median absolute deviation.
_ROBUST = 1.4826
# Probability below which an estimate contradicts the variance that is stated.
_CONTRADICTED = 0.05


@dataclass(frozen=True)
class Colour:
    """The noise under which the scores of a linearised fit are judged.

    The floor of a recording is an estimate, its colour even more so: noise that passes through the plant, drifts, has
    heavy tails or grows with the speed looks like physics to a test that takes it for white. Under the null hypothesis
    the residual is noise, so it shows what the noise is.
    """

    linearised: LinearisedFit

    def stated(self, columns: Array) -> Array:
        """(C,) variances along columns (N, C) of the noise that the recordings state."""

        def one(recording: Recording, rows: slice) -> Array:
            rho, block = recording.noise_correlation, columns[rows]
            total = np.einsum("ij,ij->j", block, block)
            for lag in range(1, min(rho.size, block.shape[0])):
                if rho[lag] != 0.0:
                    total += 2.0 * rho[lag] * np.einsum("ij,ij->j", block[lag:], block[:-lag])
            return np.asarray(total)

        return np.sum(self.linearised.plan.each(one, self.linearised.slices), axis=0)

    @cached_property
    def spectra(self) -> list[NoiseSpectrum]:
        """Of the noise in the residual, by recording."""
        linearised = self.linearised
        return noise_spectra(
            [linearised.residual[r] for r in linearised.slices], linearised.plan.recordings, linearised.noise
        )

    def left(self, columns: Array) -> Array:
        """(C, C) covariance along columns (N, C) of stationary noise with the spectra of the residual."""
        each = [s.covariance(columns[rows]) for s, rows in zip(self.spectra, self.linearised.slices, strict=True)]
        return np.asarray(np.sum(each, axis=0))

    @cached_property
    def force_spectra(self) -> list[NoiseSpectrum]:
        """Of white noise and of a white force in the residual, by recording; see `phnn.diagnosis.force_noise`.

        The white noise is bounded as in `most_excess`.
        """

        def one(recording: Recording, rows: slice) -> NoiseSpectrum:
            residual, most = self.linearised.residual[rows], most_excess([recording], self.linearised.noise)
            return force_noise(residual, recording.dt, self.linearised.response(recording), most**2)

        return self.linearised.plan.each(one, self.linearised.slices)

    def forced(self, columns: Array) -> Array:
        """(C,) variances along columns (N, C) of noise with `force_spectra`."""
        # Such a spectrum is one band.
        pairs = zip(self.force_spectra, self.linearised.slices, strict=True)
        return np.asarray(np.sum([s.by_band(columns[rows])[0] for s, rows in pairs], axis=0))

    def freedom(self, columns: Array) -> Array:
        """(C,) degrees of freedom of the variances that `left` has on its diagonal.

            ν = 2 (Σ_b V_b)² / Σ_b 2 V_b²/ν_b,    V_b the part of band b of a spectrum, ν_b its degrees of freedom

        (Satterthwaite 1946). A slow change of the output is judged by the few lowest ordinates of a spectrum. The error
        of the slope by which a spectrum goes on below them is not counted.
        """
        return _satterthwaite(self._by_spectrum(columns))

    def freedom_of_sum(self, columns: Array) -> float:
        """The same of the sum of these variances."""
        return float(_satterthwaite([(s, v.sum(axis=1, keepdims=True)) for s, v in self._by_spectrum(columns)])[0])

    def _by_spectrum(self, columns: Array) -> list[tuple[NoiseSpectrum, Array]]:
        """Each spectrum once, with the variances (K, C) of `left` by its bands."""
        parts: dict[int, tuple[NoiseSpectrum, Array]] = {}
        for spectrum, rows in zip(self.spectra, self.linearised.slices, strict=True):
            found = spectrum.by_band(columns[rows])
            before = parts.get(id(spectrum))
            parts[id(spectrum)] = (spectrum, found if before is None else before[1] + found)
        return list(parts.values())

    @cached_property
    def clipped(self) -> Array:
        """(N,) residual whose outliers are cut off at four robust standard deviations of their recording."""
        found = self.linearised.residual.copy()
        for rows in self.linearised.slices:
            most = self.linearised.noise.outlier * _ROBUST * float(np.median(np.abs(found[rows])))
            np.clip(found[rows], -most, most, out=found[rows])
        return found

    def by_blocks(self, columns: Array) -> tuple[Array, Array]:
        """(C,) scores ``dᵀr`` in their standard deviations as blocks of neighbouring samples show them, and the
        degrees of freedom of these.

            t = dᵀr / √(Σ_b (d_bᵀ r_b − ŝ d_bᵀ d_b)²),   ŝ = dᵀr / dᵀd

        What the direction itself explains is taken out of the spread, so that a true effect does not hide itself. Noise
        may have any colour that a block forgets, any variance and any tails (White 1980, Liang & Zeger 1986).
        """
        blocks = [b for rows in self.linearised.slices for b in _blocks(rows, self.linearised.noise)]
        along = np.stack([columns[b].T @ self.clipped[b] for b in blocks])
        squares = np.stack([np.einsum("ij,ij->j", columns[b], columns[b]) for b in blocks])
        total, size = along.sum(axis=0), np.maximum(squares.sum(axis=0), 1e-300)
        spread = np.sqrt(np.sum((along - total / size * squares) ** 2, axis=0))
        freedom = np.maximum(size**2 / np.maximum(np.sum(squares**2, axis=0), 1e-300) - 1.0, 0.0)
        # As of B values of which the mean was taken: the spread is that of B − 1.
        return total / np.maximum(spread, 1e-300) * np.sqrt(freedom / (freedom + 1.0)), freedom

    def deviates(self, columns: Array, covariance: Array, stated: Array | None = None) -> Array:
        """(C,) normal deviates of the scores along columns (N, C), the smaller one of two: under stationary noise of
        the residual's spectrum, and as blocks show it where there are enough of them.

        Args:
            covariance: `left` of the columns; stated: their `stated` variances, where they are known already.
        """
        stated = self.stated(columns) if stated is None else stated
        left = np.diag(covariance)
        spread = np.sqrt(np.maximum(left, stated))
        stationary = columns.T @ self.clipped / np.maximum(spread, 1e-300)
        size, more = np.abs(stationary), left > stated
        known_by = self.freedom(columns[:, more])
        contradicted = contradicts(left[more] / np.maximum(stated[more], 1e-300), known_by)
        size[more] = np.where(contradicted, _as_normal(size[more], known_by), size[more])
        t, freedom = (np.abs(x) for x in self.by_blocks(columns))
        blocked = _as_normal(t, freedom)
        rule = self.linearised.noise
        believed = np.where(freedom >= rule.block_freedom, np.clip(blocked, size / rule.uneven, size), size)
        return np.asarray(np.sign(stationary) * believed)


def contradicts(ratio: Array | float, freedom: Array | float) -> NDArray[np.bool_]:
    """Whether estimates of a variance, of some degrees of freedom, contradict the variance that is stated.

    Args:
        ratio: estimated variance over stated variance.
    """
    return np.asarray(chi2.sf(freedom * ratio, freedom) <= _CONTRADICTED)


def _satterthwaite(parts: Sequence[tuple[NoiseSpectrum, Array]]) -> Array:
    """(C,) degrees of freedom of sums of variances (K, C) by the bands of their spectra."""
    total = np.sum([v.sum(axis=0) for _, v in parts], axis=0)
    doubt = np.sum([(1.0 / s.freedom) @ v**2 for s, v in parts], axis=0)
    return np.asarray(total**2 / np.maximum(doubt, 1e-300))


def _as_normal(t: Array, freedom: Array) -> Array:
    """The normal deviates of the same tail probability as Student's ``t`` (C,), not negative, of as many degrees."""
    freedom = np.maximum(freedom, 1.0)
    tail = student.logsf(t, freedom)
    # Far out the tail underflows; its leading term does not.
    far = np.sqrt(freedom * np.log1p(t**2 / freedom))
    return np.where(np.isfinite(tail), -ndtri_exp(np.where(np.isfinite(tail), tail, -1.0)), far)


def _blocks(rows: slice, rule: Noise) -> list[slice]:
    """Some twenty blocks of neighbouring samples, none of them very short."""
    size = rows.stop - rows.start
    edges = (
        np.linspace(rows.start, rows.stop, min(rule.blocks, max(1, size // rule.block_samples)) + 1).round().astype(int)
    )
    return [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
