"""Complex amplitudes of the harmonics of a periodic signal, and what noise does to them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Harmonics that are reported, the fundamental among them.
HARMONICS = 5
# Harmonics that are told apart where there are samples enough: what is not would leak into those reported.
_BASIS = 20


def harmonic_weights(t: Array, period: float) -> NDArray[np.complex128]:
    """(5, N) weights of the samples in the complex amplitudes ``Y_k`` of a periodic output, by least squares.

    ``y = Y_0 + Re Σ_k Y_k e^{ikωt}``; exact for as many harmonics as fit in, whole number of samples a period or not.
    """
    dt = (t[-1] - t[0]) / (t.size - 1)
    count = max(HARMONICS, min(_BASIS, int(0.5 * (period / dt - 1.0)) - 1))
    phase = 2.0 * np.pi * np.outer(t, np.arange(1, count + 1)) / period
    basis = np.hstack([np.ones((t.size, 1)), np.cos(phase), np.sin(phase)])
    rows = np.linalg.pinv(basis)
    cosines, sines = rows[1 : HARMONICS + 1], rows[count + 1 : count + HARMONICS + 1]
    return np.asarray(cosines - 1j * sines)


def deviation(weights: NDArray[np.complex128] | Array, correlation: Array) -> float:
    """Standard deviation of ``w·n`` for noise ``n`` of unit variance and the given autocorrelation."""
    total = float(np.vdot(weights, weights).real)
    for lag in range(1, min(correlation.size, weights.size)):
        total += 2.0 * float(correlation[lag]) * float(np.vdot(weights[lag:], weights[:-lag]).real)
    return float(np.sqrt(max(total, 0.0)))
