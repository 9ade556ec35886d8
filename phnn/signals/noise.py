"""The noise floor of a recorded output, from the recording alone (never from a model's fit).

Three sources, in order of preference: repeated periods of the excitation, a stretch at rest, and the part of the
output's spectrum above everything that was excited. Quantisation is a lower bound in every case.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import comb, sqrt

import numpy as np
from scipy.signal import coherence, welch

from phnn.signals.first_order import correlation_of, fit_first_order
from phnn.signals.quantisation import quantisation_step
from phnn.signals.spectral_noise import estimated

# Differences of order p pass white noise with the factor ``√C(2p, p)`` and a tone of angular frequency ω with
# ``(2 sin(ω dt/2))^p``: with rising order what was excited vanishes, and the estimate comes to rest at the noise. Jumps
# and corners touch few samples and are clipped away.
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


# Longest stretch that a spectrum is averaged over, and how many of them there are at least, overlaps not counted.
_LONGEST, _STRETCHES = 512, 8
# Samples of a stretch that its window needs.
_SHORTEST = 8
# Coherence from which an output is the input's at a frequency, and the least share of frequencies where it is not.
_HEARD, _LEAST = 0.5, 0.05
# Part of the silent frequencies, from below, whose level is taken.
_NEAREST = 0.2


def silent_deviation(u: np.ndarray, y: np.ndarray) -> float | None:
    """Standard deviation of white noise that has the power of an output where its input does not cause it.

        γ² = |S_uy|² / (S_uu S_yy) < ½

    Of those frequencies the lowest fifth counts. They lie next to what is excited, for it is low frequencies that are;
    towards the highest ones what protects a sensor from aliases takes its noise away too. What a nonlinear system
    sends there is counted as noise.

    Args:
        u: ``(N,)`` input.
        y: ``(N,)`` output.

    Returns:
        In the unit of the output; ``None`` where the input leaves hardly a frequency out, or too few samples tell.
    """
    length = min(_LONGEST, y.size // _STRETCHES)
    if length < _SHORTEST:
        return None
    # This window lets nothing through from far away, where a resonance may be a hundred decibels stronger.
    options = {"window": "blackmanharris", "nperseg": length, "detrend": "linear"}
    density = welch(y, **options)[1][1:-1]
    silent = density[coherence(u, y, **options)[1][1:-1] < _HEARD]
    if silent.size < _LEAST * density.size:
        return None
    nearest = silent[: max(round(_NEAREST * silent.size), 1)]
    # One-sided, at a rate of one sample per second: white noise has twice its variance.
    return float(np.sqrt(0.5 * nearest.mean()))


WHITE = np.array([1.0])
_FEWEST_PERIODS = 3  # after the first one, which holds the transient
_FEWEST_AT_REST = 200
_SETTLING = 0.4  # share of a rest that is left to what still moves
# Samples of a rest that is long enough to show the noise.
LONG_REST = int(np.ceil(_FEWEST_AT_REST / (1.0 - _SETTLING)))
_LEAST_SHARE_OF_RANGE = 1e-6
FROM_PERIODS = "period-to-period differences"
SILENT = "the spectrum where the excitation is silent"
# Part of the words of a source whose band does not show the colour.
AS_WHITE = "noise taken as white"
UPPER = "; an upper bound, for the excitation reaches that high"


@dataclass(frozen=True, eq=False)
class NoiseFloor:
    """Standard deviation of the noise (unit of the output), its source in words, and its autocorrelation.

    ``correlation`` is ``(K,)``, lags ``0..K-1``, first entry 1; ``[1.0]`` when white or unknown.
    ``coefficient`` is that of first-order noise seen in a part of the spectrum only, zero where such a part was taken
    as white, and ``None`` where more of the noise was seen. ``found`` is False where the recording shows no noise:
    ``value`` is then a small share of the output's range, by which fits are weighted but against which nothing can be
    judged. ``interval`` holds the deviation with 95 % where it was estimated from one spectrum. ``smaller`` is the
    floor of white noise where colour alone makes it larger.
    """

    value: float
    source: str
    correlation: np.ndarray
    coefficient: float | None = None
    found: bool = True
    interval: tuple[float, float] | None = None
    smaller: NoiseFloor | None = None


def noise_floor(
    u: np.ndarray,
    y: np.ndarray,
    dt: float,
    period: float | None = None,
    span: tuple[int, int] | None = None,
    periodic_start: bool = False,
) -> NoiseFloor:
    """The noise floor of one recording by the best source it offers.

    Args:
        u: ``(N,)`` input.
        y: ``(N,)`` output.
        dt: sampling interval, s.
        period: of the excitation, s, where it repeats.
        span: samples ``[first, last)`` over which it repeats; all of them where left out.
        periodic_start: the recording begins in the periodic steady state, so no period is lost to a transient.
    """
    first, last = span if span is not None else (0, y.size)
    found = None
    if period is not None:
        found = from_periods(y[first:last], period / dt, 0 if periodic_start else 1)
    found = found or from_rest(u, y) or from_one_spectrum(u, y, dt)
    step = quantisation_step(y)
    if found.value < step / sqrt(12.0):
        found = NoiseFloor(step / sqrt(12.0), f"quantisation in steps of {step:.3g}", WHITE)
    least = _LEAST_SHARE_OF_RANGE * float(np.ptp(y))
    if found.value < least:
        source = "no noise floor was found"
        if found.interval is not None:
            low, high = found.interval
            source = (
                f"a noise of {found.value:.2g} ({low:.2g} to {high:.2g}) from {found.source} is too small to fit to"
            )
        source += "; fits are weighted by a millionth of the output's range"
        found = NoiseFloor(least, source, WHITE, found=False, interval=found.interval)
    return found


def from_periods(y: np.ndarray, period: float, skip: int = 1) -> NoiseFloor | None:
    """From differences of consecutive periods, divided by √2; ``None`` where there are too few periodic periods.

    What changes slowly from period to period (offset, trend, amplitude) and the fraction of a sample by which the
    period misses a whole number of samples are projected out of each difference.

    Args:
        y: ``(N,)`` output.
        period: in samples, not necessarily whole.
        skip: periods to leave out at the start.
    """
    lag = round(period)
    whole = int((y.size + 0.02 * period) / period)
    fewest = 2 if skip == 0 else _FEWEST_PERIODS
    if lag < 16 or whole - skip < fewest:
        return None
    pieces, shapes = [], []
    for j in range(skip, whole - 1):
        # starts are rounded one by one: errors of a fraction of a sample do not add up
        a, b = round(j * period), round((j + 1) * period)
        n = min(lag, y.size - b)
        if n >= 0.9 * lag:
            basis = _slow_changes(y[a : a + n], y[b : b + n], abs(period - lag) > 1e-9)
            difference = y[b : b + n] - y[a : a + n]
            pieces.append(difference - basis @ (basis.T @ difference))
            shapes.append(basis)
    variances = np.array([p @ p / (p.size - s.shape[1]) for p, s in zip(pieces, shapes, strict=True)])
    transient = _transient(variances, lag)
    if variances.size - transient < (2 if transient else 1):
        return None  # still dying away, and not enough left to tell that from noise
    pieces, variances = pieces[transient:], variances[transient:]
    # the median leaves out periods that were disturbed; few pairs need the mean's efficiency
    variance = float(np.median(variances) if variances.size >= 8 else np.mean(variances))
    correlation = _correlation(pieces)
    variance *= _white_loss(shapes[-1]) / _loss(shapes[-1], correlation)
    source = f"{FROM_PERIODS} over {variances.size + 1} cycles"
    return NoiseFloor(sqrt(variance / 2.0), source, correlation)


def _transient(variances: np.ndarray, n: int) -> int:
    """How many leading differences still hold a transient: they exceed the typical later one beyond chance."""
    limit = 1.0 + max(0.3, 8.0 / sqrt(n))
    for first in range(variances.size - 1):
        if variances[first] <= limit * float(np.median(variances[first + 1 :])):
            return first
    return max(variances.size - 1, 0)


def _slow_changes(earlier: np.ndarray, later: np.ndarray, fractional: bool) -> np.ndarray:
    """``(n, c)`` orthonormal shapes by which two periods may differ without noise.

    Offset, trend and amplitude; with a period of a fractional number of samples also the small shift in time, to
    second order.
    """
    from scipy.signal import savgol_filter

    n = earlier.size
    mean = 0.5 * (earlier + later)
    mean = (mean - mean.mean()) / max(float(np.ptp(mean)), 1e-300)
    window = max(7, 2 * (n // 40) + 1)
    shapes = [np.ones(n), np.linspace(-1.0, 1.0, n), mean]
    if fractional:
        shapes += [savgol_filter(mean, window, 4, deriv=d) for d in (1, 2)]
    basis = np.column_stack([s / max(float(np.linalg.norm(s)), 1e-300) for s in shapes])
    return np.asarray(np.linalg.qr(basis)[0])


def _white_loss(basis: np.ndarray) -> float:
    """Share of the variance of white noise that projecting out the basis leaves."""
    return 1.0 - basis.shape[1] / basis.shape[0]


def _loss(basis: np.ndarray, correlation: np.ndarray) -> float:
    """The same for noise of a given autocorrelation: ``1 − tr(Qᵀ R Q)/n``; a coloured noise loses more."""
    n = basis.shape[0]
    spectrum = np.abs(np.fft.rfft(basis, 2 * n, axis=0)) ** 2
    overlaps = np.fft.irfft(spectrum.sum(axis=1))[: correlation.size]
    taken = float(correlation[0] * overlaps[0] + 2.0 * correlation[1:] @ overlaps[1:])
    return float(np.clip(1.0 - taken / n, 0.5, 1.0))


def from_rest(u: np.ndarray, y: np.ndarray) -> NoiseFloor | None:
    """From the longest stretch of constant input, its part after the transient, trend removed; ``None`` without one."""
    first, last = longest_hold(u)
    first += int(_SETTLING * (last - first))
    n = last - first
    if n < _FEWEST_AT_REST:
        return None
    k = np.linspace(-1.0, 1.0, n)
    trend = np.polynomial.Polynomial.fit(k, y[first:last], 3)
    rest = y[first:last] - trend(k)
    sigma = sqrt(float(rest @ rest) / (n - 4))
    above, _ = by_differences(y[first:last])
    if sigma > 1.5 * above and float(rest[1:] @ rest[:-1]) > 0.9 * float(rest @ rest):
        return None  # it still moves smoothly: this is settling, not noise
    return NoiseFloor(sigma, f"{n} samples at rest", _correlation([rest]))


def longest_hold(u: np.ndarray) -> tuple[int, int]:
    """Samples ``[first, last)`` of the longest stretch of constant input."""
    still = np.abs(np.diff(u)) <= 1e-9 * max(float(np.ptp(u)), 1e-300)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], still.astype(int), [0]))))
    if edges.size == 0:
        return 0, 0
    longest = int(np.argmax(edges[1::2] - edges[::2]))
    return int(edges[2 * longest]), int(edges[2 * longest + 1]) + 1


def from_spectrum(y: np.ndarray, dt: float) -> NoiseFloor | None:
    """First-order noise fitted to the spectrum above what is excited; ``None`` where white noise does as well, or where
    few samples hold its power."""
    found = fit_first_order(y)
    if found is None or not holds_throughout(y, found.deviation, correlation_of(found.coefficient)):
        return None
    source = (
        f"the spectrum above {found.edge / dt:.4g} Hz, carried on below as first-order noise of coefficient "
        f"{found.coefficient:.2g}"
    )
    return NoiseFloor(found.deviation, source, correlation_of(found.coefficient), found.coefficient)


def from_high_band(u: np.ndarray, y: np.ndarray, dt: float) -> NoiseFloor:
    """From the highest frequencies: first-order noise where their spectrum shows it, else white noise.

    White noise is that of differences (`by_differences`). An excitation that reaches that high leaves but the
    frequencies between or above its own.
    """
    coloured = from_spectrum(y, dt)
    if coloured is not None:
        return coloured
    sigma, order = by_differences(y)
    source = f"the spectrum above {0.25 / dt:.4g} Hz, {AS_WHITE}"
    gain = float(np.ptp(y)) / max(float(np.ptp(u)), 1e-300)
    if gain * spread(np.diff(u, order)) / sqrt(comb(2 * order, order)) > 0.5 * sigma:
        silent = silent_deviation(u, y)
        if silent is not None and silent < sigma:
            return NoiseFloor(
                silent,
                f"{SILENT}, {AS_WHITE}; more is possible where it is not",
                WHITE,
                0.0,
            )
        source += UPPER
    return NoiseFloor(sigma, source, WHITE, 0.0)


def from_one_spectrum(u: np.ndarray, y: np.ndarray, dt: float) -> NoiseFloor:
    """From the highest frequencies, corrected where `spectral_noise.estimated` can be trusted and disagrees.

    What lies in its interval stays, and so does a floor from frequencies about which the input is silent.
    """
    simple = from_high_band(u, y, dt)
    known = estimated(u, y)
    if known is None or SILENT in simple.source:
        return simple
    correlation = correlation_of(known.coefficient) if known.coefficient else WHITE
    if not holds_throughout(y, known.value, correlation):
        return simple
    step = quantisation_step(y) / sqrt(12.0)
    interval = max(known.low, min(step, known.value)), max(known.high, step)
    if known.low <= simple.value <= known.high and UPPER not in simple.source:
        return replace(simple, interval=interval)
    smaller = None
    if simple.value < known.value and UPPER not in simple.source:
        smaller = replace(simple, interval=(min(simple.value, known.low), interval[1]))
    return NoiseFloor(known.value, known.words(dt), correlation, None, interval=interval, smaller=smaller)


def _correlation(pieces: list[np.ndarray]) -> np.ndarray:
    """``(K,)`` mean autocorrelation of the pieces, tapered, cut where it is no longer significant."""
    from scipy.signal.windows import parzen

    total = sum(p.size for p in pieces)
    lags = min(p.size for p in pieces) // 4
    sums = np.zeros(lags)
    for p in pieces:
        spectrum = np.abs(np.fft.rfft(p, 2 * p.size)) ** 2
        sums += np.fft.irfft(spectrum)[:lags]
    if sums[0] <= 0.0:
        return WHITE
    rho = sums / sums[0]
    significant = np.abs(rho) > 3.5 / sqrt(total)
    # two insignificant lags in a row end it: a single zero crossing of a coloured noise does not
    quiet = ~significant[1:-1] & ~significant[2:]
    cut = 1 + int(np.argmax(quiet)) if quiet.any() else lags
    if cut <= 1:
        return WHITE
    kept = min(4 * cut, lags)
    # Parzen's window is positive definite, so the tapered sequence remains an autocorrelation
    return np.asarray(rho[:kept] * parzen(2 * kept - 1)[kept - 1 :])
