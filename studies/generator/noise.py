"""Noise of a sensor: its families, its size, and how strong a signal is against it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from studies.generator.parameters import Array

FIRST_ORDER = "first_order"  # white where its coefficient is 0
PROCESS, PINK, HEAVY, QUANTISED, JITTERED = "process", "pink", "heavy", "quantised", "jittered"


@dataclass(frozen=True)
class Noise:
    """Stationary noise of standard deviation σ, followed by rounding to a least step.

    =========== ==================================================== ===============================================
    family      noise of the sensor                                  amount
    =========== ==================================================== ===============================================
    first_order ``n_t = φ n_{t−1} + √(1 − φ²) σ ε_t``, Gaussian      φ is ``colour``; 0 is white noise
    process     white; the rest passes through the plant as a force  share of that rest in the power σ²
    pink        white, and a part whose spectrum falls as 1/f        share of that part in the power σ²
    heavy       white, Student's t, scaled to the variance σ²        degrees of freedom
    quantised   white                                                least step over σ
    jittered    white; the sampling instants err besides             deviation of the error times the root mean
                                                                     square speed of the fastest recording, over σ
    =========== ==================================================== ===============================================

    Attributes:
        deviation: σ, m: the total of all that is added before rounding, but for the jitter.
        step: least step of the displacement, m; counted as white noise of variance step²/12.
        colour: φ, 0 for white noise.
        family: one of the table.
        amount: see the table; without meaning for first_order.
    """

    deviation: float
    step: float
    colour: float = 0.0
    family: str = FIRST_ORDER
    amount: float = 0.0

    def drawn(self, count: int, rng: np.random.Generator) -> Array:
        """Noise of the sensor before rounding, (count,), m; without jitter and what passes through the plant."""
        if self.family == PROCESS:
            return math.sqrt(1.0 - self.amount) * self.deviation * rng.standard_normal(count)
        if self.family == PINK:
            white = math.sqrt(1.0 - self.amount) * rng.standard_normal(count)
            return self.deviation * (white + math.sqrt(self.amount) * pink(count, rng))
        if self.family == HEAVY:
            # The variance of Student's t with ν degrees of freedom is ν/(ν − 2).
            return self.deviation * math.sqrt(1.0 - 2.0 / self.amount) * rng.standard_t(self.amount, count)
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
        the moving-average coefficient θ with ``s² |1 − θ z|² = σ² (1 − φ²) + step²/12 |1 − φ z|²``. The noise of any
        other family counts as white of its total deviation, jitter left out.
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


def pink(count: int, rng: np.random.Generator) -> Array:
    """Gaussian noise of unit variance whose spectrum falls as 1/f, (count,), from twice the duration to Nyquist.

    It is periodic over twice the length, of which one half is returned: its ends do not meet.
    """
    size = 2 * count
    line = np.arange(1, count, dtype=np.float64)  # neither a mean nor Nyquist's line
    lines = rng.standard_normal((2, line.size)) / np.sqrt(line)
    spectrum = np.zeros(count + 1, dtype=np.complex128)
    spectrum[1:-1] = lines[0] + 1j * lines[1]
    # irfft gives each line the variance 4/(k size²).
    scale = size / (2.0 * math.sqrt(float(np.sum(1.0 / line))))
    drawn: Array = scale * np.fft.irfft(spectrum, size)[:count]
    return drawn
