"""Noise of a sensor: white or of first order, and how strong a signal is against it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from phnn.demo.parameters import Array


@dataclass(frozen=True)
class Noise:
    """Stationary Gaussian noise ``n_t = φ n_{t−1} + √(1 − φ²) σ ε_t`` followed by rounding to a least step.

    Attributes:
        deviation: σ, m.
        step: least step of the displacement, m; counted as white noise of variance step²/12.
        colour: φ, 0 for white noise.
    """

    deviation: float
    step: float
    colour: float = 0.0

    def drawn(self, count: int, rng: np.random.Generator) -> Array:
        """The noise before rounding, (count,), m."""
        white = rng.standard_normal(count)
        if self.colour == 0.0:
            return self.deviation * white
        fresh = math.sqrt(1.0 - self.colour**2)
        white[0] /= fresh  # stationary from the first sample on
        coloured: Array = self.deviation * lfilter([fresh], [1.0, -self.colour], white)
        return coloured

    def whitened(self, y: Array) -> Array:
        """``y`` filtered such that noise and rounding together become white of unit variance, shape as ``y``.

        A first-order process plus white noise is a process of order (1, 1); its innovations have the variance s² and
        the moving-average coefficient θ with ``s² |1 − θ z|² = σ² (1 − φ²) + step²/12 |1 − φ z|²``.
        """
        phi, rounding = self.colour, self.step**2 / 12.0
        if phi == 0.0:
            return y / math.sqrt(self.deviation**2 + rounding)
        if rounding == 0.0:
            theta, variance = 0.0, self.deviation**2 * (1.0 - phi**2)
        else:
            sum_of_squares = self.deviation**2 * (1.0 - phi**2) + rounding * (1.0 + phi**2)
            product = rounding * phi
            theta = (sum_of_squares - math.sqrt(sum_of_squares**2 - 4.0 * product**2)) / (2.0 * product)
            variance = product / theta
        filtered: Array = lfilter([1.0, -phi], [1.0, -theta], y, axis=0) / math.sqrt(variance)
        return filtered
