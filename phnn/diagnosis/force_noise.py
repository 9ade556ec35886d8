"""Noise of a sensor and of a white force that nobody records, by the response of the model that they meet.

    S(f) = s (1 + κ |G(f)|²)

Two numbers and the model's own response ``G`` about rest describe the spectrum, so that a line hardly raises the noise
that it is compared with, and a short recording does not show its resonance as one. ``s`` and ``κ`` are those of
greatest likelihood (Whittle 1953).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.optimize import minimize_scalar
from scipy.signal import periodogram

from phnn.identification.residual_noise import NoiseSpectrum

Array = NDArray[np.float64]
# (F,) amplitude of the output over that of a force, in any unit, at frequencies (F,) [Hz].
Response = Callable[[Array], Array]

# Bounds of log₁₀ κ, for a largest |G| of one: below, the force's part is lost in the sensor's.
_LEAST, _MOST = -2.0, 7.0
# Ordinates whose running median shows the noise beside a line, and multiples of it at which a line is cut off.
_NEIGHBOURS, _CUT = 31, 8.0


def force_noise(residual: Array, dt: float, response: Response, most: float = np.inf) -> NoiseSpectrum:
    """The spectrum ``S`` of a residual.

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
