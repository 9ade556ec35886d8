"""First-order (autoregressive) noise under a signal, from that part of the spectrum which the signal does not reach.

    n_k = a n_{k−1} + w_k,   S(ω) = σ² (1 − a²)/(1 + a² − 2a cos ω)

The likelihood is Whittle's (1953), over the frequencies above an edge: the lowest one above which the fit leaves
neither lines nor a slope.

Correlations of a residual with itself and with an input, and how far noise alone would scatter them:

    r_k = Σ_t e_t x_{t−k} / √(Σ e² Σ x²)     over the N − k pairs, means removed

Under noise of autocorrelation ρ the estimated autocorrelation scatters about ρ_k with the variance (Bartlett 1946)

    (1/N) Σ_m (ρ_m² + ρ_{m+k} ρ_{m−k} + 2 ρ_k² ρ_m² − 4 ρ_k ρ_m ρ_{m−k}),

which is 1/N for white noise, and the correlation with an input of autocorrelation r_u about zero with Σ_m ρ_m r_u(m)/N.
At lag k both are smaller by (N − k)/N, as fewer pairs are summed and divided by the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, minimize, minimize_scalar
from scipy.signal import correlate
from scipy.signal.windows import blackmanharris

Array = NDArray[np.float64]

# Lowest frequencies of the fit that are tried, in cycles a sample.
EDGES = (0.03, 0.06, 0.1, 0.16, 0.25)
_FEWEST = 200
_PARTS = 5
# Neighbouring frequencies share what the window smears: so many count as one.
SMEARED = 2.0
# How much better than white noise the log likelihood must be, in such units.
_CLEARLY = 6.0
# Largest coefficient; logarithms of the strength of the tail to begin with.
_LARGEST = 0.95
_TAILS = (-12.0, -4.0)
# First ordinate, octaves below the highest frequency, stretches of time, and the largest coefficient of noise alone.
_SLOWEST, _OCTAVES, _TIMES, _COLOURED = 8, 7, 8, 0.85
# Correlation at which it is cut; least spectrum that a correlation may give.
_FORGOTTEN, _HARDLY = 0.01, 0.1


def correlation_of(coefficient: float) -> np.ndarray:
    """Return the autocorrelation ``aᵏ`` until it is forgotten, two lags at least."""
    lags = 1 + int(np.log(_FORGOTTEN) / np.log(max(coefficient, 1e-3)))
    return np.asarray(coefficient ** np.arange(max(lags, 2)))


def density_of(correlation: np.ndarray, cycles: np.ndarray) -> np.ndarray:
    """Return ``(F,)`` the spectrum over that of white noise, from an autocorrelation ``(K,)``; cycles a sample."""
    waves = np.cos(2.0 * np.pi * np.multiply.outer(cycles, np.arange(1, correlation.size)))
    # A correlation that was cut off may give a spectrum that is hardly positive somewhere.
    return np.asarray(np.maximum(1.0 + 2.0 * waves @ correlation[1:], _HARDLY))


def density(a: float, cosine: np.ndarray) -> np.ndarray:
    return np.asarray((1.0 - a * a) / (1.0 + a * a - 2.0 * a * cosine))


def _shape(z: np.ndarray, cosine: np.ndarray, tail: np.ndarray) -> np.ndarray:
    """Return the (F,) spectrum of noise of unit variance, and of the tail beside it."""
    return np.asarray(density(_coefficient(z[0]), cosine) + np.exp(min(z[1], 50.0)) * tail)


def _best(
    power: np.ndarray, cosine: np.ndarray, tail: np.ndarray, starts: tuple[float, ...], white: bool = False
) -> OptimizeResult:
    """Return the best coefficient and strength of the tail; the coefficient stays zero for white noise."""

    def negative(z: np.ndarray) -> float:
        shape = _shape(np.array([0.0, z[0]]) if white else z, cosine, tail)
        return float(np.log(np.mean(power / shape)) + np.mean(np.log(shape)))

    points = [[t] if white else [np.arctanh(np.sqrt(a)), t] for a in starts for t in _TAILS]
    return min((minimize(negative, z, method="Nelder-Mead") for z in points), key=lambda r: float(r.fun))


def without_trend(y: Array, degree: int = 1) -> Array:
    """Return (N,) samples without the polynomial of a degree that fits them best."""
    trend = np.polynomial.Polynomial.fit(np.arange(y.size), y, degree)
    return np.asarray(y - trend(np.arange(y.size)))


def periodogram(x: Array) -> Array:
    """Return the power over that of white noise of unit variance, through a window that leaks nothing from afar."""
    window = blackmanharris(x.size, sym=False)
    return np.asarray(np.abs(np.fft.rfft(window * x)) ** 2 / float(window @ window))


def fit_first_order(y: np.ndarray) -> tuple[float, float, float] | None:
    """Return deviation and coefficient ``a`` of the first-order noise in ``(N,)`` samples, and the edge [cycles a
    sample] above which they were fitted; ``None`` where white noise explains the high frequencies as well, or where the
    signal reaches too high.

    What the signal's kinks leave there falls with the fourth power of the frequency and is fitted beside the noise.
    """
    power = periodogram(without_trend(y))
    omega = 2.0 * np.pi * np.fft.rfftfreq(y.size)
    for edge in EDGES:
        band = (omega > 2.0 * np.pi * edge) & (omega < np.pi)
        if band.sum() < _FEWEST:
            return None
        p, w = power[band], omega[band]
        cosine, tail = np.cos(w), w**-4.0
        coloured = _best(p, cosine, tail, (0.1, 0.5, 0.8))
        white = _best(p, cosine, tail, (0.0,), white=True)
        shape = _shape(coloured.x, cosine, tail)
        if not fits(p, shape):
            continue
        a = _coefficient(coloured.x[0])
        variance = float(np.mean(p / shape))
        gain = (white.fun - coloured.fun) * p.size / SMEARED
        return (float(np.sqrt(variance)), a, edge) if gain > _CLEARLY else None
    return None


def _coefficient(z: float) -> float:
    """Return a coefficient from zero to the largest one: amplifiers and filters make neighbours alike."""
    return float(_LARGEST * np.tanh(z) ** 2)


def fits(power: np.ndarray, shape: np.ndarray, edges: int | NDArray[np.int64] = _PARTS) -> bool:
    """Return whether the whitened spectrum has no lines and the same level everywhere: in so many equal parts, or
    between some edges."""
    white = power / shape
    white = white / white.mean()
    levels = [np.sqrt(p.size / SMEARED) * (p.mean() - 1.0) for p in np.array_split(white, edges) if p.size]
    return bool(white.max() < np.log(white.size) + 6.0 and np.abs(levels).max() < 4.0)


def is_first_order(e: Array) -> bool:
    """Return whether samples (N,) are first-order noise alone: without lines, and with the level of its spectrum in
    every octave of frequency and at all times."""
    power, omega = (x[_SLOWEST:-1] for x in (periodogram(e - e.mean()), 2.0 * np.pi * np.fft.rfftfreq(e.size)))
    if omega.size < _FEWEST:
        return False

    def negative(a: float) -> float:
        shape = density(a, np.cos(omega))
        return float(np.log(np.mean(power / shape)) + np.mean(np.log(shape)))

    a = float(minimize_scalar(negative, bounds=(0.0, _COLOURED), method="bounded").x)
    octaves = np.searchsorted(omega, np.pi / 2.0 ** np.arange(_OCTAVES, 0, -1))
    levels = np.array([np.mean(part**2) / np.mean(e**2) for part in np.array_split(e, _TIMES)])
    spread = np.sqrt(2.0 * _TIMES / e.size * (1.0 + a * a) / (1.0 - a * a))
    return fits(power, density(a, np.cos(omega)), octaves) and bool(np.abs(levels - 1.0).max() < 4.0 * spread)


def correlation(e: Array, x: Array, lags: int) -> Array:
    """Return the (2L+1,) correlation of ``e`` with ``x``, both (N,), at lags −L … L, L < N; zero without motion. At
    positive lags ``x`` is earlier."""
    e, x = e - e.mean(), x - x.mean()
    size = float(np.sqrt((e @ e) * (x @ x)))
    sums = correlate(e, x)[e.size - 1 - lags : e.size + lags]
    return np.asarray(sums / size if size > 0.0 else np.zeros(2 * lags + 1))


def own_deviation(rho: Array, size: int, lags: int) -> Array:
    """Return the (L+1,) standard deviation of an autocorrelation at lags 0 … L that ``size`` samples give, under noise
    of autocorrelation ``rho`` (K,), first entry 1."""
    both = _both_sides(rho)
    at, overlaps = np.zeros(lags + 1), np.zeros(2 * lags + 1)
    at[: rho.size] = rho[: lags + 1]
    products = correlate(both, both)[both.size - 1 :][: overlaps.size]
    overlaps[: products.size] = products
    variances = overlaps[0] + overlaps[::2] + 2.0 * at**2 * overlaps[0] - 4.0 * at * overlaps[: lags + 1]
    return np.sqrt(np.maximum(variances, 0.0) * _pairs(np.arange(lags + 1), size))


def cross_deviation(rho: Array, x: Array, lags: int) -> Array:
    """Return the (2L+1,) standard deviation of the correlation of noise with an input ``x`` (N,) at lags −L … L, under
    noise of autocorrelation ``rho`` (K,), first entry 1."""
    known = min(rho.size - 1, x.size - 1)
    variance = float(_both_sides(rho[: known + 1]) @ correlation(x, x, known))
    # Rounding, or a correlation that was cut off, may leave hardly anything beside a slow input.
    return np.sqrt(max(variance, 0.0) * _pairs(np.arange(-lags, lags + 1), x.size))


def _both_sides(rho: Array) -> Array:
    """Return the (2K−1,) autocorrelation at negative and positive lags."""
    return np.concatenate([rho[:0:-1], rho])


def _pairs(lags: NDArray[np.int64], size: int) -> Array:
    """Return ``(N − k)/N²``."""
    return np.asarray((size - np.abs(lags)) / size**2)
