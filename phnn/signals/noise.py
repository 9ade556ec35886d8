"""The noise floor of a recorded output, from the recording alone (never from a model's fit).

Three sources, in order of preference: repeated periods of the excitation, a stretch at rest, and the part of the
output's spectrum above everything that was excited. Quantisation is a lower bound in every case.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import comb, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.signal import coherence, savgol_filter, welch
from scipy.signal.windows import parzen
from scipy.stats import chi2

from phnn.signals.first_order import (
    EDGES,
    SMEARED,
    correlation_of,
    density,
    fit_first_order,
    fits,
    periodogram,
    without_trend,
)
from phnn.signals.least_squares import deviation
from phnn.signals.sampling import longest_run, quantisation_step

# Differences of order p pass white noise with the factor ``√C(2p, p)`` and a tone of angular frequency ω with
# ``(2 sin(ω dt/2))^p``: with rising order what was excited vanishes, and the estimate comes to rest at the noise. Jumps
# and corners touch few samples and are clipped away.
_ORDERS = range(1, 9)
# A noise has no larger spread in its strongest samples than this factor allows over that in most of them.
_UNEVEN = 2.0


def by_differences(y: np.ndarray) -> tuple[float, int]:
    """Return the deviation of white noise in ``(N,)`` samples by differences of the lowest order that agrees with the
    best, and that order."""
    sigmas = [spread(np.diff(y, p)) / sqrt(comb(2 * p, p)) for p in _ORDERS]
    order = next(i for i, s in enumerate(sigmas) if s <= 1.05 * min(sigmas))
    return sigmas[order], order + 1


def spread(values: np.ndarray) -> float:
    """Return the deviation of the Gaussian core: median absolute deviation, then clipped at 3σ without bias."""
    core = np.abs(values)
    sigma = float(np.median(core)) / 0.67449
    for _ in range(10):
        kept = core[core <= 3.0 * sigma]
        sigma = sqrt(float(kept @ kept) / kept.size) / 0.98652
    return sigma


def holds_throughout(y: np.ndarray, sigma: float, correlation: np.ndarray) -> bool:
    """Return whether a noise is there in most samples, and not in a few, as the ringing after a step is.

    Differences of order p with coefficients ``c`` would have the variance ``σ² Σ_ij c_i c_j ρ(|i − j|)``; the
    differences in most samples must reach half its root. Finer than the quantisation they show nothing.

    Args:
        y: ``(N,)`` output; sigma: of the noise, unit of the output; correlation: ``(K,)`` ρ at lags 0 to K − 1.
    """
    level, order = by_differences(y)
    coefficients = np.array([(-1.0) ** i * comb(order, i) for i in range(order + 1)])
    visible = max(level, quantisation_step(y)) * sqrt(comb(2 * order, order))
    return sigma * deviation(coefficients, correlation) <= _UNEVEN * visible


# Longest stretch that a spectrum is averaged over, and how many of them there are at least, overlaps not counted.
_LONGEST, _STRETCHES = 512, 8
# Samples of a stretch that its window needs.
_SHORTEST = 8
# Coherence from which an output is the input's at a frequency, and the least share of frequencies where it is not.
_HEARD, _LEAST = 0.5, 0.05
# Part of the silent frequencies, from below, whose level is taken.
_NEAREST = 0.2


def silent_deviation(u: np.ndarray, y: np.ndarray) -> float | None:
    """Return the standard deviation of white noise that has the power of an output ``(N,)`` where its input ``(N,)``
    does not cause it; ``None`` where the input leaves hardly a frequency out, or too few samples tell.

        γ² = |S_uy|² / (S_uu S_yy) < ½

    Of those frequencies the lowest fifth counts. They lie next to what is excited, for it is low frequencies that are;
    towards the highest ones what protects a sensor from aliases takes its noise away too. What a nonlinear system
    sends there is counted as noise.
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
# Share of the deviation of the whole output from which a noise floor is as large as the output itself.
OWN_FLOOR = 0.5
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

    @property
    def is_level(self) -> bool:
        """Return whether it is the level of the highest frequencies, taken as white."""
        white = AS_WHITE in self.source and SILENT not in self.source
        return white and self.coefficient == 0.0 and self.interval is None


def noise_floor(
    u: np.ndarray,
    y: np.ndarray,
    dt: float,
    period: float | None = None,
    span: tuple[int, int] | None = None,
    periodic_start: bool = False,
) -> NoiseFloor:
    """Return the noise floor of one recording by the best source it offers.

    Args:
        u: ``(N,)`` input.
        y: ``(N,)`` output.
        dt: sampling interval, s.
        period: of the excitation, s, where it repeats.
        span: samples ``[first, last)`` over which it repeats; all of them where left out.
        periodic_start: the recording begins in the periodic steady state, so no period is lost to a transient.
    """
    first, last = span if span is not None else (0, y.size)
    floor = None
    if period is not None:
        floor = from_periods(y[first:last], period / dt, 0 if periodic_start else 1)
    floor = floor or from_rest(u, y) or from_one_spectrum(u, y, dt)
    step = quantisation_step(y)
    if floor.value < step / sqrt(12.0):
        floor = NoiseFloor(step / sqrt(12.0), f"quantisation in steps of {step:.3g}", WHITE)
    least = _LEAST_SHARE_OF_RANGE * float(np.ptp(y))
    if floor.value < least:
        source = "no noise floor was found"
        if floor.interval is not None:
            low, high = floor.interval
            seen = f"a noise of {floor.value:.2g} ({low:.2g} to {high:.2g})"
            source = f"{seen} from {floor.source} is too small to fit to"
        source += "; fits are weighted by a millionth of the output's range"
        floor = NoiseFloor(least, source, WHITE, found=False, interval=floor.interval)
    return floor


def from_periods(y: np.ndarray, period: float, skip: int = 1) -> NoiseFloor | None:
    """Estimate from differences of consecutive periods, over √2; ``None`` for too few periodic periods.

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
    rows, columns = shapes[-1].shape
    # White noise would lose the share columns/rows of its variance to what is projected out.
    variance *= (1.0 - columns / rows) / _loss(shapes[-1], correlation)
    source = f"{FROM_PERIODS} over {variances.size + 1} cycles"
    return NoiseFloor(sqrt(variance / 2.0), source, correlation)


def _transient(variances: np.ndarray, n: int) -> int:
    """Return how many leading differences still hold a transient: they exceed the typical later one beyond chance."""
    limit = 1.0 + max(0.3, 8.0 / sqrt(n))
    for first in range(variances.size - 1):
        if variances[first] <= limit * float(np.median(variances[first + 1 :])):
            return first
    return max(variances.size - 1, 0)


def _slow_changes(earlier: np.ndarray, later: np.ndarray, fractional: bool) -> np.ndarray:
    """Return ``(n, c)`` orthonormal shapes by which two periods may differ without noise.

    Offset, trend and amplitude; with a period of a fractional number of samples also the small shift in time, to
    second order.
    """
    n = earlier.size
    mean = 0.5 * (earlier + later)
    mean = (mean - mean.mean()) / max(float(np.ptp(mean)), 1e-300)
    window = max(7, 2 * (n // 40) + 1)
    shapes = [np.ones(n), np.linspace(-1.0, 1.0, n), mean]
    if fractional:
        shapes += [savgol_filter(mean, window, 4, deriv=d) for d in (1, 2)]
    basis = np.column_stack([s / max(float(np.linalg.norm(s)), 1e-300) for s in shapes])
    return np.asarray(np.linalg.qr(basis)[0])


def _loss(basis: np.ndarray, correlation: np.ndarray) -> float:
    """Return the share of the variance that projecting out a basis leaves of noise of a given autocorrelation.

    It is ``1 − tr(Qᵀ R Q)/n``; a coloured noise loses more than a white one.
    """
    n = basis.shape[0]
    spectrum = np.abs(np.fft.rfft(basis, 2 * n, axis=0)) ** 2
    overlaps = np.fft.irfft(spectrum.sum(axis=1))[: correlation.size]
    taken = float(correlation[0] * overlaps[0] + 2.0 * correlation[1:] @ overlaps[1:])
    return float(np.clip(1.0 - taken / n, 0.5, 1.0))


def from_rest(u: np.ndarray, y: np.ndarray) -> NoiseFloor | None:
    """Estimate from the longest stretch of constant input, its part after the transient, trend removed.

    ``None`` without one, and where the output still moves there: smoothly, or by more than its differences show and as
    much as anywhere else.
    """
    first, last = longest_hold(u)
    first += int(_SETTLING * (last - first))
    n = last - first
    if n < _FEWEST_AT_REST:
        return None
    rest = without_trend(y[first:last], 3)
    sigma = sqrt(float(rest @ rest) / (n - 4))
    above, _ = by_differences(y[first:last])
    smooth = float(rest[1:] @ rest[:-1]) > 0.9 * float(rest @ rest)
    if sigma > 1.5 * above and (smooth or sigma > OWN_FLOOR * float(np.std(y))):
        return None
    return NoiseFloor(sigma, f"{n} samples at rest", _correlation([rest]))


def longest_hold(u: np.ndarray) -> tuple[int, int]:
    """Return the samples ``[first, last)`` of the longest stretch of constant input."""
    still = np.abs(np.diff(u)) <= 1e-9 * max(float(np.ptp(u)), 1e-300)
    longest = longest_run(still)
    return (longest.start, longest.stop + 1) if longest.stop else (0, 0)


def from_high_band(u: np.ndarray, y: np.ndarray, dt: float) -> NoiseFloor:
    """Return the noise of the highest frequencies: first-order where most samples show it above the drive, else white.

    White noise is that of differences (`by_differences`). An excitation that reaches that high leaves but the
    frequencies between or above its own.
    """
    coloured = fit_first_order(y)
    if coloured is not None:
        value, coefficient, edge = coloured
        correlation = correlation_of(coefficient)
        if holds_throughout(y, value, correlation):
            above = f"the spectrum above {edge / dt:.4g} Hz"
            source = f"{above}, carried on below as first-order noise of coefficient {coefficient:.2g}"
            return NoiseFloor(value, source, correlation, coefficient)
    sigma, order = by_differences(y)
    source = f"the spectrum above {0.25 / dt:.4g} Hz, {AS_WHITE}"
    gain = float(np.ptp(y)) / max(float(np.ptp(u)), 1e-300)
    if gain * spread(np.diff(u, order)) / sqrt(comb(2 * order, order)) > 0.5 * sigma:
        silent = silent_deviation(u, y)
        if silent is not None and silent < sigma:
            return NoiseFloor(silent, f"{SILENT}, {AS_WHITE}; more is possible where it is not", WHITE, 0.0)
        source += UPPER
    return NoiseFloor(sigma, source, WHITE, 0.0)


def from_one_spectrum(u: np.ndarray, y: np.ndarray, dt: float) -> NoiseFloor:
    """Estimate from the highest frequencies, corrected where `estimated` can be trusted and disagrees.

    What lies in its interval stays, and so does a floor from frequencies about which the input is silent.
    """
    simple = from_high_band(u, y, dt)
    known = estimated(u, y, dt)
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
    return NoiseFloor(known.value, known.source, correlation, None, interval=interval, smaller=smaller)


def _correlation(pieces: list[np.ndarray]) -> np.ndarray:
    """Return ``(K,)`` mean autocorrelation of the pieces, tapered, cut where it is no longer significant."""
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


Array = NDArray[np.float64]

# Samples of the past that predict the next one; blocks of samples, each predicted by coefficients of the others.
ORDER, BLOCKS = 24, 4
# Fewest samples of a block, over the coefficients that are estimated.
_PER_COEFFICIENT = 10
# Ridge over the mean square of a column: makes equations solvable that a noise-free signal leaves undetermined.
_RIDGE = 1e-14
# Samples that are looked at, from the middle of longer recordings.
_MOST = 2**15
# Fewest frequencies above an edge.
_FEWEST = 100
# Coefficients and tails that are tried.
_COEFFICIENTS = np.concatenate([np.arange(0.0, 0.9, 0.05), [0.9, 0.93, 0.96, 0.98]])
# How tails fall with frequency: kinks of the output, kinks of the input through a resonance, what is smooth.
_STEEP, _STEPS = (4.0, 8.0, 16.0), 300
_BANDS = 256
# Share of the power that noise has where it is seen, and share of the frequencies above the edge where it must be.
_PURE, _SEEN = 0.8, 0.95
# Largest ratio of the bounds of an estimate that says something.
_WIDEST = 3.0
# Level of the interval; gain of the log likelihood, in independent frequencies, from which noise is coloured.
LEVEL, _CLEARLY = 0.95, 6.0


@dataclass(frozen=True)
class Estimate:
    """Standard deviation of a noise and its 95 % interval, unit of the output.

    Attributes:
        value, low, high: the deviation and its bounds; coefficient: of first-order noise, 0 where it is white.
        source: where it comes from, in words.
    """

    value: float
    low: float
    high: float
    coefficient: float
    source: str


def estimated(u: Array, y: Array, dt: float) -> Estimate | None:
    """Return the smaller of the estimates from input and output (N,) that can be trusted; None where none can.

    An estimate is trusted where the spectrum that it whitens has no lines and one level (`first_order.fits`).
    """
    first = max((y.size - _MOST) // 2, 0)
    u, y = u[first : first + _MOST], y[first : first + _MOST]
    # From the spectrum above what is excited, and from what a predictor leaves.
    spectrum = _above_an_edge(periodogram(without_trend(y))[None, :], "the spectrum", dt)
    estimates = [e for e in (spectrum, _of_one_step(u, y, dt)) if e is not None]
    best = min(estimates, key=lambda e: e.value, default=None)
    if best is None:
        return None
    agreeing = [e for e in estimates if e.low <= best.high and e.high >= best.low]
    return replace(best, low=min(e.low for e in agreeing), high=max(e.high for e in agreeing))


def _of_one_step(u: Array, y: Array, dt: float) -> Estimate | None:
    """Estimate from what an ARX predictor leaves of blocks that it was not fitted to."""
    size = (y.size - ORDER) // BLOCKS
    if size < _PER_COEFFICIENT * 2 * ORDER:
        return None
    columns, target = _lagged(u, y)
    rows = [slice(i * size, (i + 1) * size) for i in range(BLOCKS)]
    normal = [columns[r].T @ columns[r] for r in rows]
    right = [columns[r].T @ target[r] for r in rows]
    powers = []
    omega = 2.0 * np.pi * np.fft.rfftfreq(size)
    for i, r in enumerate(rows):
        others = sum(m for j, m in enumerate(normal) if j != i)
        scale = np.sqrt(np.diag(others))
        # An input that stands still in all of these blocks has no columns.
        scale[scale == 0.0] = 1.0
        scaled = others / np.outer(scale, scale) + _RIDGE * np.eye(scale.size)
        wanted = sum(m for j, m in enumerate(right) if j != i)
        c = np.linalg.solve(scaled, wanted / scale) / scale
        error = target[r] - columns[r] @ c
        filtered = np.concatenate([[1.0], -c[:ORDER]])
        gain = np.abs(np.exp(-1j * np.outer(omega, np.arange(ORDER + 1))) @ filtered) ** 2
        powers.append(periodogram(error - error.mean()) / np.maximum(gain, 1e-12 * gain.max()))
    return _above_an_edge(np.array(powers), f"one-step-ahead residuals of an autoregression of order {ORDER}", dt)


def _lagged(u: Array, y: Array) -> tuple[Array, Array]:
    """Return (N − p, 2p + 2) past outputs, inputs up to now and a constant, and the (N − p,) outputs they predict."""
    y, u = (x - x.mean() for x in (y, u))
    n = y.size - ORDER
    past = [y[ORDER - i : ORDER - i + n] for i in range(1, ORDER + 1)]
    driven = [u[ORDER - j : ORDER - j + n] for j in range(ORDER + 1)]
    return np.column_stack([*past, *driven, np.ones(n)]), y[ORDER:]


def _above_an_edge(power: Array, source: str, dt: float) -> Estimate | None:
    """Return the estimate above the lowest edge at which it can be trusted, from the periodograms (B, F) of B blocks,
    which reach from frequency zero to half the sampling rate."""
    omega = np.linspace(0.0, np.pi, power.shape[1])
    for edge in EDGES:
        band = (omega > 2.0 * np.pi * edge) & (omega < np.pi)
        # All blocks of one frequency stand side by side.
        p, w = power[:, band].T.ravel(), np.repeat(omega[band], len(power))
        if p.size < _FEWEST:
            return None
        if (likely := _likely(p, w)) is not None:
            return Estimate(*likely, f"{source} above {edge / dt:.4g} Hz")
    return None


def _likely(power: Array, omega: Array) -> tuple[float, float, float, float] | None:
    """Return the deviation, its bounds and the coefficient by Whittle's likelihood; None where the spectrum has another
    shape, where tails hide the noise, or where the bounds lie so far apart that nothing is known."""
    scale = float(power.mean())
    if scale <= 0.0:
        return None
    tails = np.stack([(omega / omega[0]) ** -e for e in _STEEP])
    noises = np.stack([density(a, np.cos(omega)) for a in _COEFFICIENTS])
    # Neighbouring frequencies have nearly one expectation.
    edges = np.unique(np.linspace(0, power.size, _BANDS + 1).astype(int))
    counts = np.diff(edges)
    p, n, t = (np.add.reduceat(x, edges[:-1], axis=-1) / counts for x in (power / scale, noises, tails))
    shapes = np.concatenate([n[:, None, :], np.broadcast_to(t, (len(n), *t.shape))], axis=1)
    weights, costs, errors = _fitted(p, shapes, counts)
    free = int(costs.argmin())
    at = free if (costs[0] - costs[free]) / SMEARED > _CLEARLY else 0
    noise = weights[at, 0] * noises[at]
    shape = noise + weights[at, 1:] @ tails
    if np.mean(noise > _PURE * shape) < _SEEN or not fits(power, shape):
        return None
    # What the window smears counts once; for each a, variances ln σ² ± δ are likely enough.
    spare = chi2.ppf(LEVEL, 1) * SMEARED - 2.0 * (costs - costs[free])
    likely = (spare > 0.0) & (weights[:, 0] > 0.0)
    middle, delta = np.log(weights[likely, 0]), np.sqrt(spare[likely]) * errors[likely]
    bounds = weights[at, 0], np.exp((middle - delta).min()), np.exp((middle + delta).max())
    value, low, high = (float(np.sqrt(scale * x)) for x in bounds)
    low, high = min(low, value), max(high, value)
    return (value, low, high, float(_COEFFICIENTS[at])) if high <= _WIDEST * low else None


def _fitted(power: Array, shapes: Array, counts: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    """For each coefficient the most likely weights (A, K) of noise and tails, none negative, minus the log likelihood
    (A,), and the standard error of the logarithm of the first weight (A,).

    Multiplicative steps for the Itakura–Saito divergence (Févotte & Idier 2011), which is Whittle's likelihood.

    Args:
        power: (F,) mean over each band; shapes: (A, K, F) of the noise and of the tails; counts: (F,) frequencies.
    """
    weights = power.mean() / shapes.mean(axis=2) / shapes.shape[1]
    for _ in range(_STEPS):
        total = np.einsum("ak,akf->af", weights, shapes)
        up = np.einsum("akf,af->ak", shapes, counts * power / total**2)
        weights = weights * up / np.einsum("akf,af->ak", shapes, counts / total)
    total = np.einsum("ak,akf->af", weights, shapes)
    costs = (counts * (np.log(total) + power / total)).sum(axis=1)
    # A weight of nothing counts as a little, so that every information matrix can be inverted.
    kept = np.maximum(weights, 1e-9 * weights.max(axis=1, keepdims=True))
    relative = shapes * kept[:, :, None] / total[:, None, :]
    information = np.einsum("akf,alf,f->akl", relative, relative, counts.astype(float))
    return weights, costs, np.sqrt(np.linalg.pinv(information)[:, 0, 0])
