"""Noise by differences of a recorded output, which see what is there in most samples.

Differences of order p pass white noise with the factor ``√C(2p, p)`` and a tone of angular frequency ω with
``(2 sin(ω dt/2))^p``: with rising order what was excited vanishes, and the estimate comes to rest at the noise. Jumps
and corners touch few samples and are clipped away.
"""

from __future__ import annotations

from math import comb, sqrt

import numpy as np

from phnn.signals.quantisation import quantisation_step

_ORDERS = range(1, 9)
# A noise has no larger spread in its strongest samples than this factor allows over that in most of them.
_UNEVEN = 2.0


def by_differences(y: np.ndarray) -> tuple[float, int]:
    """Deviation of white noise by differences of the lowest order that agrees with the best one, and that order.

    Args:
        y: ``(N,)`` output.
    """
    sigmas = [spread(np.diff(y, p)) / sqrt(comb(2 * p, p)) for p in _ORDERS]
    best = min(sigmas)
    order = next(i for i, s in enumerate(sigmas) if s <= 1.05 * best)
    return sigmas[order], order + 1


def spread(values: np.ndarray) -> float:
    """Standard deviation of the Gaussian core: median absolute deviation, then clipped at 3σ without bias."""
    core = np.abs(values)
    sigma = float(np.median(core)) / 0.67449
    for _ in range(10):
        kept = core[core <= 3.0 * sigma]
        if kept.size == 0:
            break
        sigma = sqrt(float(kept @ kept) / kept.size) / 0.98652
    return sigma


def holds_throughout(y: np.ndarray, deviation: float, correlation: np.ndarray) -> bool:
    """Whether a noise is there in most samples, and not in a few, as the ringing after a step is.

    Differences of order p with coefficients ``c`` would have the variance ``σ² Σ_ij c_i c_j ρ(|i − j|)``; the
    differences in most samples must reach half its root. Finer than the quantisation they show nothing.

    Args:
        y: ``(N,)`` output; deviation: σ of the noise, unit of the output; correlation: ``(K,)`` ρ at lags 0 to K − 1.
    """
    found, order = by_differences(y)
    coefficients = np.array([(-1.0) ** i * comb(order, i) for i in range(order + 1)])
    overlaps = np.correlate(coefficients, coefficients, "full")[order:]
    lags = min(overlaps.size, correlation.size)
    variance = correlation[0] * overlaps[0] + 2.0 * float(correlation[1:lags] @ overlaps[1:lags])
    visible = max(found, quantisation_step(y)) * sqrt(comb(2 * order, order))
    return deviation * sqrt(max(variance, 0.0)) <= _UNEVEN * visible
