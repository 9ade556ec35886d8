"""The noise that scores are judged with: as the recordings state it, and as the residual has it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from phnn.diagnose.ground import Ground
from phnn.diagnose.residual_noise import first_order_of
from phnn.recordings.recording import Recording

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Colour:
    """The covariance of a ground's noise, in two versions.

    The floor of a recording is an estimate, its colour even more so: where most of the spectrum is full of signal, the
    power of the noise at low frequencies is carried on from high ones. Where the floor is too low there, the residual
    of a model says so, as it is nothing but noise where nothing is missing.
    """

    ground: Ground

    def stated(self, columns: Array) -> Array:
        """(C,) variances along columns (N, C) of the noise that the recordings state."""

        def one(recording: Recording, rows: slice) -> Array:
            rho, block = recording.noise_correlation, columns[rows]
            total = np.einsum("ij,ij->j", block, block)
            for lag in range(1, min(rho.size, block.shape[0])):
                if rho[lag] != 0.0:
                    total += 2.0 * rho[lag] * np.einsum("ij,ij->j", block[lag:], block[:-lag])
            return np.asarray(total)

        return np.sum(self.ground.plan.each(one, self.ground.slices), axis=0)

    def left(self, columns: Array) -> Array:
        """(C, C) covariance along columns (N, C) of first-order noise of the residual's power and lag-one correlation.

        The sum over all earlier samples, with half of the present one, is one half of the whole; the other mirrors it.
        """

        def one(_: Recording, rows: slice) -> Array:
            power, a = first_order_of(self.ground.residual[rows])
            block = columns[rows]
            half = 0.5 * block if a == 0.0 else lfilter([0.5, 0.5 * a], [1.0, -a], block, axis=0)
            return np.asarray(power * (block.T @ half))

        half = np.sum(self.ground.plan.each(one, self.ground.slices), axis=0)
        return half + half.T
