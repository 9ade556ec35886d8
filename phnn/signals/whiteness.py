"""Correlations of a residual with itself and with an input, and how far noise alone would scatter them.

    r_k = Σ_t e_t x_{t−k} / √(Σ e² Σ x²)     over the N − k pairs, means removed

Under noise of autocorrelation ρ the estimated autocorrelation scatters about ρ_k with the variance (Bartlett 1946)

    (1/N) Σ_m (ρ_m² + ρ_{m+k} ρ_{m−k} + 2 ρ_k² ρ_m² − 4 ρ_k ρ_m ρ_{m−k}),

which is 1/N for white noise, and the correlation with an input of autocorrelation r_u about zero with Σ_m ρ_m r_u(m)/N.
At lag k both are smaller by (N − k)/N, as fewer pairs are summed and divided by the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def correlation(e: Array, x: Array, lags: int) -> Array:
    """(2L+1,) correlation of ``e`` with ``x`` at lags −L … L; at positive lags ``x`` is earlier. Zero without motion.

    Args:
        e, x: (N,) samples; lags: L < N.
    """
    e, x = e - e.mean(), x - x.mean()
    size = float(np.sqrt((e @ e) * (x @ x)))
    length = 2 * e.size
    product = np.fft.rfft(e, length) * np.conj(np.fft.rfft(x, length))
    sums = np.fft.irfft(product, length)
    found = np.concatenate([sums[length - lags :], sums[: lags + 1]])
    return np.asarray(found / size if size > 0.0 else np.zeros(2 * lags + 1))


def own_deviation(rho: Array, size: int, lags: int) -> Array:
    """(L+1,) standard deviation of an estimated autocorrelation at lags 0 … L.

    Args:
        rho: (K,) autocorrelation of the noise, first entry 1; size: N.
    """
    known = rho.size - 1
    reach = lags + 2 * known
    full = _about_zero(rho, reach + lags)
    zero = reach + lags
    m = np.arange(-reach, reach + 1)
    variances = np.empty(lags + 1)
    for k in range(lags + 1):
        at, later, earlier, here = full[zero + m], full[zero + m + k], full[zero + m - k], full[zero + k]
        terms = at**2 + later * earlier + 2.0 * here**2 * at**2 - 4.0 * here * at * earlier
        variances[k] = terms.sum()
    return np.sqrt(np.maximum(variances, 0.0) * _pairs(np.arange(lags + 1), size))


def cross_deviation(rho: Array, x: Array, lags: int) -> Array:
    """(2L+1,) standard deviation of the correlation of noise with an input at lags −L … L.

    Args:
        rho: (K,) autocorrelation of the noise, first entry 1; x: (N,) input.
    """
    known = min(rho.size - 1, x.size - 1)
    own = correlation(x, x, known)
    variance = float(_about_zero(rho[: known + 1], known) @ own)
    # Rounding, or a correlation that was cut off, may leave hardly anything beside a slow input.
    return np.sqrt(max(variance, 0.0) * _pairs(np.arange(-lags, lags + 1), x.size))


def _about_zero(rho: Array, reach: int) -> Array:
    """(2R+1,) an autocorrelation at lags −R … R, zero where it is not known."""
    half = np.zeros(reach + 1)
    half[: rho.size] = rho[: reach + 1]
    return np.concatenate([half[:0:-1], half])


def _pairs(lags: NDArray[np.int64], size: int) -> Array:
    """``(N − k)/N²``."""
    return np.asarray((size - np.abs(lags)) / size**2)
