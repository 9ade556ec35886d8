"""The noise that scores are judged with: as the recordings state it, and as the residual has it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri_exp
from scipy.stats import t as student

from phnn.criteria import Noise
from phnn.diagnosis.linearised_fit import LinearisedFit
from phnn.identification.residual_noise import NoiseSpectrum, noise_spectra
from phnn.recordings.recording import Recording

Array = NDArray[np.float64]

# Standard deviation of a normal variable over its median absolute deviation.
_ROBUST = 1.4826


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
        spread = np.sqrt(np.maximum(np.diag(covariance), self.stated(columns) if stated is None else stated))
        stationary = columns.T @ self.clipped / np.maximum(spread, 1e-300)
        t, freedom = (np.abs(x) for x in self.by_blocks(columns))
        # The normal deviate of the same tail probability as that of Student's t.
        blocked = -ndtri_exp(student.logsf(t, np.maximum(freedom, 1.0)))
        size = np.abs(stationary)
        rule = self.linearised.noise
        believed = np.where(freedom >= rule.block_freedom, np.clip(blocked, size / rule.uneven, size), size)
        return np.asarray(np.sign(stationary) * believed)


def _blocks(rows: slice, rule: Noise) -> list[slice]:
    """Some twenty blocks of neighbouring samples, none of them very short."""
    size = rows.stop - rows.start
    edges = (
        np.linspace(rows.start, rows.stop, min(rule.blocks, max(1, size // rule.block_samples)) + 1).round().astype(int)
    )
    return [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
