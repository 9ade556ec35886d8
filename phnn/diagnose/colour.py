"""The noise that scores are judged with: as the recordings state it, and as the residual has it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from phnn.diagnose.ground import Ground

Array = NDArray[np.float64]

# Lag-one correlations below so many standard deviations are none; no memory is taken to be longer than this one's.
_SEEN, _LARGEST = 3.0, 0.95
# By what factor noise may exceed what is stated: an effect that leaves more stands out from any such noise.
_MOST = 2.0


@dataclass(frozen=True)
class Colour:
    """The covariance of a ground's noise, in two versions.

    The floor of a recording is an estimate, its colour even more so: where most of the spectrum is full of signal, the
    power of the noise at low frequencies is carried on from high ones. Where the floor is too low there, the residual
    of a model says so, as it is nothing but noise where nothing is missing.
    """

    ground: Ground

    def stated(self, columns: Array) -> Array:
        """Columns (N, C) times the correlation of the noise that the recordings state."""
        out = np.array(columns, copy=True)
        for recording, rows in zip(self.ground.plan.recordings, self.ground.slices, strict=True):
            rho, block = recording.noise_correlation, columns[rows]
            for lag in range(1, min(rho.size, block.shape[0])):
                out[rows][lag:] += rho[lag] * block[:-lag]
                out[rows][:-lag] += rho[lag] * block[lag:]
        return out

    def left(self, columns: Array) -> Array:
        """Columns (N, C) times the covariance of first-order noise of the residual's power and lag-one correlation."""
        out = np.empty_like(columns)
        for rows in self.ground.slices:
            power, a = first_order_of(self.ground.residual[rows])
            block = columns[rows]
            earlier = lfilter([1.0], [1.0, -a], block, axis=0)
            later = lfilter([1.0], [1.0, -a], block[::-1], axis=0)[::-1]
            out[rows] = power * (earlier + later - block)
        return out


def first_order_of(residual: Array) -> tuple[float, float]:
    """Mean square, and coefficient of first-order noise of the same lag-one correlation (zero where none is seen)."""
    squares = float(residual @ residual)
    a = float(residual[1:] @ residual[:-1]) / max(squares, 1e-300)
    return squares / residual.size, min(a, _LARGEST) if a > _SEEN / np.sqrt(residual.size) else 0.0


def doubt(left: Array, stated: Array) -> Array:
    """Factor on standard deviations from the variances as left and as stated, between 1 and 2."""
    return np.asarray(np.sqrt(np.clip(left / np.maximum(stated, 1e-300), 1.0, _MOST**2)))
