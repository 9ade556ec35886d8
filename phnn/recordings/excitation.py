"""The input of a recording: its kind, frequencies, amplitude and period; its values on the sub-steps of a simulation,
and the unknown instants of its jumps."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.signal import correlate
from scipy.stats import spearmanr

from phnn.signals.least_squares import residual, spline
from phnn.signals.noise import longest_hold
from phnn.signals.reconstruct import WITH_BREAKS, Reconstruction, mean_input, starts_with_jump, substep_counts

if TYPE_CHECKING:
    from phnn.recordings.recording import Recording

# Share of an input's swing around its middle in which no crossing is told from noise.
_MIDDLE = 0.15
_UNLIKE = 0.3  # mismatch that a signal must reach before a return counts as a period
_ALIKE = 1e-3  # mismatch of a noisy repetition
_EXACT = 1e-4  # mismatch accepted where only two periods bear witness
_DISTURBED = 0.01  # share of its variance that a recorded sine may have beside the sine: noise, steps, a slow trend


@dataclass(frozen=True)
class Excitation:
    """The input of one recording in a few numbers."""

    kind: str  # constant, steps, sine, periodic, chirp or broadband
    low_Hz: float  # equal to the highest for a sine, 0 for steps
    high_Hz: float
    amplitude: float  # half the input's range, SI
    period: float | None  # s, where at least two periods were recorded
    cycles: float  # periods recorded
    span: tuple[int, int]  # samples [first, last) in which the input is at work, without rests before and after

    @property
    def frequency(self) -> float:
        """Return a single frequency that stands for the band, Hz."""
        return float(np.sqrt(self.low_Hz * self.high_Hz))


def excitation_of(u: np.ndarray, dt: float) -> Excitation:
    """Recognise the input ``u`` ``(N,)`` sampled every ``dt`` seconds."""
    amplitude = 0.5 * float(np.ptp(u))
    if amplitude == 0.0:
        return Excitation("constant", 0.0, 0.0, 0.0, None, 0.0, (0, u.size))
    # The rests at the beginning and the end are left out.
    moving = np.flatnonzero(np.abs(np.diff(u)) > 1e-9 * float(np.ptp(u)))
    first, last = int(moving[0]), int(moving[-1]) + 2
    first, last = span = (first if first > 2 else 0), (last if last < u.size - 2 else u.size)
    x = u[first:last]
    samples = find_period(x)
    if samples is not None:
        period, sine = samples * dt, _sine_misfit(x, 1.0 / samples) < 1e-3
        high = 1.0 / period if sine else _band(x, dt)[1]
        kind = "sine" if sine else "periodic"
        return Excitation(kind, 1.0 / period, high, amplitude, period, x.size / samples, span)
    if _few_levels(u):
        return Excitation("steps", 0.0, 0.0, amplitude, None, 0.0, span)
    frequency = _single_sine(x)
    sweep = _sweep(x) if frequency is None else None
    if sweep is not None:
        return Excitation("chirp", sweep[0] / dt, sweep[1] / dt, amplitude, None, 0.0, span)
    if frequency is None:
        # Noise may keep a sine from repeating exactly.
        peak = int(np.argmax(spectrum(x)[1:] ** 2)) + 1
        frequency = _sine_between(x, max(peak - 1.0, 0.3) / x.size, (peak + 1.0) / x.size, _DISTURBED)
    if frequency is not None:
        return Excitation("sine", frequency / dt, frequency / dt, amplitude, None, x.size * frequency, span)
    return Excitation("broadband", *_band(x, dt), amplitude, None, 0.0, span)


def spectrum(x: np.ndarray) -> np.ndarray:
    """Return the amplitudes (not scaled) of the Fourier transform of ``x`` without its mean, through a Hann window."""
    return np.asarray(np.abs(np.fft.rfft((x - x.mean()) * np.hanning(x.size))))


def find_period(x: np.ndarray) -> float | None:
    """Return the period of ``x`` ``(N,)`` in samples (not necessarily whole), where at least two are there.

    A lag L counts when ``mean((x[k+L] − x[k])²) / (2 var x)`` returns to nearly nothing after the signal has become
    unlike itself, and when it does not grow over several periods, as it would for a changing amplitude.
    """
    x = x - x.mean()
    most = int(x.size / 1.95) + 2
    if x.size < 16 or float(np.ptp(x)) == 0.0:
        return None
    # Of x with itself at whole lags.
    cross = correlate(x, x, method="fft")[x.size - 1 : x.size + most]
    squares = np.concatenate(([0.0], np.cumsum(x * x)))
    energy = squares[x.size - most :][::-1] + (squares[-1] - squares[: most + 1])
    mismatch = (energy - 2.0 * cross) / (x.size - np.arange(most + 1)) / (2.0 * float(x.var()))
    unlike = np.flatnonzero(mismatch > _UNLIKE)
    if unlike.size == 0:
        return None
    inner = np.arange(max(int(unlike[0]), 1), most)
    dips = inner[(mismatch[inner] <= mismatch[inner - 1]) & (mismatch[inner] <= mismatch[inner + 1])]
    dips = dips[mismatch[dips] < 0.2][:20]
    for lag in dips.tolist():
        period, rest = _refined(x, float(lag), 1.0)
        if rest < _ALIKE:
            return _over_many(x, period, rest)
    return None


def _over_many(x: np.ndarray, period: float, rest: float) -> float | None:
    """Return the period refined over as many cycles as there are; ``None`` where the repetition is not steady."""
    count = max(int((x.size - 0.95 * period) / period), 1)
    steady = rest < _EXACT
    if count > 1:
        multiple, left_many = _refined(x, count * period, min(1.0 + 0.02 * count, 0.2 * period))
        period, steady = multiple / count, left_many <= 3.0 * rest + 1e-5
    if not steady:
        return None
    # A whole number of samples where the difference cannot be seen over the recording.
    return float(round(period)) if abs(period - round(period)) * count < 0.02 else period


def _refined(x: np.ndarray, lag: float, reach: float) -> tuple[float, float]:
    """Return the lag of least mismatch within ``reach`` samples, and that mismatch."""
    stride = max(1, x.size // 20_000)  # some thousands of samples settle it
    k, curve = np.arange(x.size), spline(x)
    variance = 2.0 * float(x.var())

    def mismatch(at: float) -> float:
        rows = k[: max(int(x.size - np.ceil(at)), 1) : stride]
        return float(np.mean((curve(rows + at) - x[rows]) ** 2)) / variance

    highest = min(lag + reach, x.size - 2.0)
    best = minimize_scalar(mismatch, bounds=(lag - reach, highest), method="bounded", options={"xatol": 1e-4})
    whole = float(round(lag))
    # corners and jumps do not survive interpolation; at a whole lag none is needed
    return min(((float(best.x), float(best.fun)), (whole, mismatch(whole))), key=lambda pair: pair[1])


def waves(rows: slice, frequency: float, harmonics: int) -> NDArray[np.float64]:
    """Return (n, 1 + 2 K) a constant, cosines and sines of the first harmonics of a frequency, in cycles per sample."""
    phase = 2.0 * np.pi * frequency * np.outer(np.arange(rows.start, rows.stop), np.arange(1, harmonics + 1))
    return np.column_stack([np.ones(phase.shape[0]), np.cos(phase), np.sin(phase)])


def _sine_misfit(x: NDArray[np.float64], frequency: float) -> float:
    """Return the share of the variance of ``x`` that a sine of that frequency (cycles per sample) leaves."""
    rest = residual(x, lambda rows: waves(rows, frequency, 1))
    return float(rest @ rest) / max(float(np.sum((x - x.mean()) ** 2)), 1e-300)


def _single_sine(x: np.ndarray) -> float | None:
    """Return the frequency, in cycles per sample, of a sine of half a period to two periods; None for other signals."""
    stride = max(1, x.size // 1000)
    thin = np.asarray(x[::stride], dtype=float)
    grid = np.geomspace(0.3, 3.0, 24) / thin.size
    i = int(np.argmin([_sine_misfit(thin, float(f)) for f in grid]))
    frequency = _sine_between(thin, float(grid[max(i - 1, 0)]), float(grid[min(i + 1, grid.size - 1)]), 1e-4)
    return None if frequency is None else frequency / stride


def _sine_between(x: NDArray[np.float64], low: float, high: float, most: float) -> float | None:
    """Return the frequency, between two, of the sine that fits best; None where it leaves more than a share."""
    best = minimize_scalar(lambda f: _sine_misfit(x, float(f)), bounds=(low, high), method="bounded")
    return float(best.x) if best.fun < most else None


def _few_levels(u: np.ndarray) -> bool:
    """Return whether the input mostly stands still: steps and holds."""
    still = np.abs(np.diff(u)) <= 1e-6 * float(np.ptp(u))
    first, last = longest_hold(u)
    return bool(still.mean() > 0.9 or (still.mean() > 0.5 and last - first > 0.3 * u.size))


def _sweep(x: np.ndarray) -> tuple[float, float] | None:
    """Return the first and last frequency (cycles per sample, ascending) of a sweep, from its zero crossings."""
    centred = x - 0.5 * (x.max() + x.min())
    # At the middle itself noise crosses it as well.
    outside = np.flatnonzero(np.abs(centred) > _MIDDLE * np.abs(centred).max())
    c, steps = centred[outside], np.diff(outside)
    i = np.flatnonzero(np.signbit(c[1:]) != np.signbit(c[:-1]))
    if i.size < 6:
        return None
    crossings = outside[i] + steps[i] * c[i] / (c[i] - c[i + 1])
    if abs(float(centred[0])) <= 1e-6 * float(np.ptp(x)) and crossings[0] > 0.5:
        crossings = np.concatenate(([0.0], crossings))  # it begins with a crossing
    rate = 0.5 / np.diff(crossings)
    if float(np.ptp(rate)) <= 1e-6 * float(rate.max()):
        return None
    order = float(spearmanr(np.arange(rate.size), rate).statistic)
    low, high = float(rate.min()), float(rate.max())
    return (low, high) if abs(order) > 0.95 and high > 1.5 * low else None


def _band(x: np.ndarray, dt: float) -> tuple[float, float]:
    """Return the frequencies in Hz between which 98 % of the power lies."""
    power = spectrum(x) ** 2
    share = np.cumsum(power) / max(float(power.sum()), 1e-300)
    frequency = np.fft.rfftfreq(x.size, dt)
    low, high = np.searchsorted(share, [0.01, 0.99])
    return float(frequency[max(int(low), 1)]), float(frequency[min(int(high), frequency.size - 1)])


Array = NDArray[np.float64]

# Jumps of a recording whose instants are estimated one by one. More of them come from one clock: their instants lie
# equally far behind the sample before.
_ALONE = 24
# Periods that miss whole samples by less than this over the recording let their jumps share an instant.
_WHOLE = 0.02


class Driving(NamedTuple):
    """The inputs of a recording between its samples."""

    counts: NDArray[np.int64]  # (N−1,) sub-steps of every sample interval, those of the lead before them
    # Samples before the first recorded one: a cycle where the recording starts in a steady one; the input before where
    # the recording starts with a jump from it, whose instant is not known.
    lead: int
    command: Reconstruction  # the first input
    further: Array  # (n, F) means of the other ones
    group: NDArray[np.int64]  # (J,) which of the recording's instants each jump of the first input has
    lengths: Array  # (N−1,) of the sample intervals, in mean ones

    def fine(self, recording: Recording) -> Array:
        """Return (n, 3) the first input with jumps at the recording's instants."""
        return self.command.fine(self.instants(recording)[self.group])

    def slopes(self, recording: Recording) -> Array:
        """Return (n, G) derivatives of the mean first input by the recording's instants."""
        return self.command.slopes(self.instants(recording)[self.group], self.group)

    def instants(self, recording: Recording) -> Array:
        """Return (G,) the recording's instants; assumed ones where it has none for the jumps of this input."""
        count = int(self.group.max(initial=-1)) + 1
        if recording.instants is not None and recording.instants.size == count:
            return recording.instants
        return np.array([self.command.nominal[self.group == g][0] for g in range(count)])


@dataclass(frozen=True)
class _Input:
    """All that the input between samples depends on, as the key of a cache: arrays are equal to themselves alone."""

    recording: Recording = field(compare=False)  # keeps the arrays whose identities the key holds
    key: tuple[object, ...]


def driving_of(recording: Recording, substeps: int, method: str | None = None) -> Driving:
    """Return the input of a recording between its samples, by its own reconstruction or another ``method``; kept, for
    every candidate model sees the same one. There are ``substeps`` a sample interval, and more after jumps."""
    method, r = method or recording.interpolation, recording
    arrays = (r.u, *r.further.values(), *(() if r.clock is None else (r.t,)))
    key = (*map(id, arrays), r.cycle, r.input_before, r.period, r.dt, r.clock is None, method)
    return _driving(_Input(r, key), substeps, method)


@lru_cache(maxsize=64)
def _driving(given: _Input, substeps: int, method: str) -> Driving:
    """Return what `driving_of` does."""
    recording = given.recording
    lead = cycle = recording.cycle
    before, samples, others = recording.input_before, recording.u, list(recording.further.values())
    if cycle:
        samples, *others = (np.concatenate([x[:cycle], x]) for x in (samples, *others))
    elif method in WITH_BREAKS and starts_with_jump(samples, before):
        lead, samples = 1, np.concatenate([[before], samples])
        others = [np.concatenate([x[:1], x]) for x in others]
    counts = substep_counts(samples, before, substeps)
    for x in others:
        counts = np.maximum(counts, substep_counts(x, float(x[0]), substeps))
    counts, clock, lengths = made_periodic(counts, cycle), None, np.ones(counts.size)
    if recording.clock is not None:
        clock = np.concatenate([-np.arange(lead, 0.0, -1.0), recording.t * (recording.t.size - 1) / recording.t[-1]])
        lengths = np.diff(clock)
        # As many steps in a unit of time, whatever the intervals.
        counts = counts * np.maximum(np.rint(lengths / np.median(lengths)), 1.0).astype(np.int64)
    command = Reconstruction(samples, counts, method, clock=clock)
    means = np.zeros((int(counts.sum()), len(others)))
    for k, x in enumerate(others):
        means[:, k] = mean_input(Reconstruction(x, counts, method, clock=clock).fine())
    means.flags.writeable = False
    period = (recording.period or 0.0) / recording.dt  # sample intervals, 0 for none
    group = _shared(command.breaks.jumps, cycle, period, samples.size)
    if group.max(initial=-1) + 1 < group.size:
        # Jumps that share an instant have to mean the same by it.
        command = replace(command, sharp=True)
    return Driving(counts, lead, command, means, group, lengths)


def _shared(jumps: NDArray[np.int64], cycle: int, period: float, samples: int) -> NDArray[np.int64]:
    """Return (J,) numbers of the instants: jumps at one phase of the cycle share one, and if many, all do."""
    whole = round(period)
    if cycle:
        jumps = jumps % cycle
    elif whole and abs(period - whole) * samples / period < _WHOLE:
        jumps = jumps % whole
    group = np.unique(jumps, return_inverse=True)[1].astype(np.int64)
    return group if group.max(initial=-1) < _ALONE else np.zeros_like(group)


def unknown_instants(recording: Recording) -> Array:
    """Return (G,) present values of the instants that are to be estimated."""
    return driving_of(recording, 1).instants(recording)


def instants_known(recording: Recording) -> bool:
    """Return whether the instants of all jumps were estimated from the samples for identification."""
    if recording.instants is None:
        return False
    driving, fitted = driving_of(recording, 1), recording.mask("identification")
    at = driving.command.breaks.jumps - driving.lead
    return bool(np.isin(driving.group, driving.group[(at >= 0) & fitted[at]]).all())


def made_periodic(x: Any, cycle: int) -> Any:
    """Return (n, …) quantities of the steps of a simulation, the first cycle replaced by the second, which is periodic.

    A recording of one cycle lacks the last interval of its second cycle, but there the first is periodic too.
    """
    return np.concatenate([x[cycle : 2 * cycle], x[min(cycle, x.shape[0] - cycle) :]]) if cycle else x
