"""Reconstruct a sampled input on the sub-steps of a simulation.

A linear hold of a 150 Hz sine at 10 kHz is wrong by more than the noise of a good sensor, so smooth inputs are
reconstructed by splines or band-limited. Where the input is not smooth the smooth stretches on both sides are continued
into the interval and exchanged at the instant of the break. The instant of a jump is not known from the samples: half a
microsecond of a step of 60 V moves a stage by more than its sensor's noise.

Breaks are jumps of the value and kinks of the slope. Between two samples a jump can happen at any instant. A kink can
be placed: its instant is where the smooth pieces on both sides, continued into the interval, meet.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import signal
from scipy.interpolate import make_interp_spline

from phnn.errors import InputRefused
from phnn.signals.sampling import quantisation_step

Array = NDArray[np.float64]

_DENSE = 8
_ORDER = {"linear": 1, "cubic": 3, "quintic": 5}


@dataclass(frozen=True, eq=False)
class Stretch:
    """Samples ``first, first + 1, …`` of a signal that is smooth there.

    Attributes:
        first: index of the first sample.
        u: (M,) samples.
        method: ``linear``, ``cubic``, ``quintic`` or ``band_limited``.
        clock: instants of all samples of the signal in mean intervals, where these are not equal.
    """

    first: int
    u: Array
    method: str
    clock: Array | None = None

    @cached_property
    def _spline(self) -> Callable[[Array], Array] | None:
        order = min(_ORDER.get(self.method, 3), self.u.size - 1)
        if self.method == "band_limited" and self.u.size > 32 and self.clock is None:
            return _band_limited(self.u)
        if order < 1:
            return None
        at = np.arange(self.u.size) if self.clock is None else self.clock[self.first : self.first + self.u.size]
        return make_interp_spline(at, self.u, k=order if order % 2 else order - 1)

    def __call__(self, positions: Array) -> Array:
        """Return the values at positions counted in samples of the whole signal, shape as ``positions``."""
        if self._spline is None:
            return np.full(positions.shape, self.u[0])
        if self.clock is not None:
            return np.asarray(self._spline(np.interp(positions, np.arange(self.clock.size), self.clock)))
        return np.asarray(self._spline(positions - self.first))


def _band_limited(u: Array) -> Callable[[Array], Array]:
    """Return the spline through a signal resampled eight times as densely."""
    # A straight line is taken out, because the filter assumes zero outside the record.
    line = np.linspace(u[0], u[-1], u.size)
    dense = np.asarray(signal.resample_poly(u - line, _DENSE, 1, window=("kaiser", 14.0)))
    dense = dense[: (u.size - 1) * _DENSE + 1]
    at = np.arange(dense.size) / _DENSE
    return make_interp_spline(at, dense + np.interp(at, np.arange(u.size), line), k=3)


# A difference of neighbouring samples is a jump above this share of the input's range, and above this multiple of the
# typical difference beside it.
_JUMP_SHARE, _JUMP_RATIO = 0.05, 20.0
# Most levels of a sequence, fewest samples for each, and least share of samples that equal the one before: of a
# sine whose period is few samples, at most a quarter do.
_LEVELS, _FEWEST, _DWELLS = 8, 10, 0.4
# A change of slope is a kink above this share of the range per sample interval (below it a spline through the kink is
# wrong by less than a ten-thousandth of the range), above this multiple of the change of slope that the smooth signal
# beside it has, and above so many steps of a quantised input, though never above the last share
# of the range.
_KINK_SHARE, _KINK_RATIO, _KINK_STEPS, _COARSE = 1e-3, 10.0, 6.0, 0.02
# Second differences on either side of a kink that show what the signal does when it is smooth.
_BESIDE = 6
# Differences inside a fast ramp are alike within this factor; those of a staircase are not.
_ALIKE = 3.0
# Fewest samples of a stretch beside a break that is taken for curved.
_CURVED = 8
# Stretches that come as near as this share of the range meet. They are compared on a grid, a little beyond the interval
# too: rounding may place a kink at a sample on its other side.
_TOUCHING, _BEYOND, _GRID = 1e-3, 0.25, 61


@dataclass(frozen=True, eq=False)
class Breaks:
    """Intervals in which an input is not smooth.

    Attributes:
        at: (B,) sample indices ``n``, ascending: the break lies between samples ``n − 1`` and ``n``.
        instant: (B,) of a kink, in sample intervals behind sample ``n − 1``; NaN for a jump, whose instant the samples
            do not tell.
    """

    at: NDArray[np.int64]
    instant: Array

    @property
    def jumps(self) -> NDArray[np.int64]:
        """Return (J,) the sample indices ``n`` of the jumps."""
        return self.at[np.isnan(self.instant)]

    def stretches(self, u: Array, method: str, clock: Array | None = None) -> list[Stretch]:
        """Return the B + 1 smooth stretches of the input (N,)."""
        edges = [0, *self.at.tolist(), u.size]
        # A curve through few samples, continued beyond them, leads far away from what they say.
        short = _CURVED if self.at.size else 0
        return [Stretch(a, u[a:b], method if b - a >= short else "linear", clock) for a, b in pairwise(edges)]


def find_jumps(u: Array) -> NDArray[np.int64]:
    """Return the indices ``n`` where the input jumps between samples ``n − 1`` and ``n``.

    A jump is a difference above 5 % of the range and above twenty times the typical difference next to it. An input
    that dwells on a few levels, such as a binary sequence, jumps at every change.
    """
    span = float(np.ptp(u))
    if span == 0.0 or u.size < 4:
        return np.zeros(0, np.int64)
    steps = np.abs(np.diff(u))
    levels = np.unique(u).size
    if _FEWEST * levels <= u.size and (levels == 2 or (levels <= _LEVELS and np.mean(steps == 0.0) > _DWELLS)):
        return np.flatnonzero(steps) + 1
    # Mirrored at the ends: padding with zeros would make every difference of a short record a jump.
    padded = np.pad(steps, 3, mode="reflect")
    neighbours = np.delete(np.lib.stride_tricks.sliding_window_view(padded, 7), 3, axis=1)
    typical = np.median(neighbours, axis=1)
    return np.flatnonzero((steps > _JUMP_SHARE * span) & (steps > _JUMP_RATIO * typical)) + 1


def find_breaks(u: Array, clock: Array | None = None) -> Breaks:
    """Return the jumps and kinks of an input (N,).

    A band-limited signal that is sampled well has second differences that vary slowly from sample to sample. A kink
    adds its change of slope to the two second differences next to it, whatever its instant between the samples. Where
    the smooth stretches on both sides do not meet within the interval, the value jumps.
    """
    jumps = _without_ramps(u, find_jumps(u))
    at = np.union1d(jumps, _kinks(u, jumps, clock))
    sides = Breaks(at, np.full(at.size, np.nan)).stretches(u, "cubic", clock)
    near = _TOUCHING * float(np.ptp(u))
    return Breaks(at, np.array([_meeting(n, a, b, near) for n, (a, b) in zip(at, pairwise(sides), strict=True)]))


def _meeting(n: int, earlier: Stretch, later: Stretch, near: float) -> float:
    """Return where two stretches meet, in sample intervals behind sample ``n − 1``; NaN where they do not."""
    if min(earlier.u.size, later.u.size) < 2:
        # A single sample has no slope: how it was reached and left is not known.
        return np.nan
    at = np.linspace(-_BEYOND, 1.0 + _BEYOND, _GRID)
    apart = later(n - 1 + at) - earlier(n - 1 + at)
    crossing = np.flatnonzero(apart[:-1] * apart[1:] <= 0.0)
    if crossing.size:
        i = int(crossing[0])
        share = apart[i] / (apart[i] - apart[i + 1]) if apart[i] != apart[i + 1] else 0.0
        return float(np.clip(at[i] + share * (at[i + 1] - at[i]), 0.0, 1.0))
    closest = int(np.argmin(np.abs(apart)))
    return float(np.clip(at[closest], 0.0, 1.0)) if abs(apart[closest]) < near else np.nan


def _without_ramps(u: Array, jumps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Drop jumps inside a fast ramp: of four or more in a row, one way and alike, the two ends remain."""
    kept: list[int] = []
    for run in np.split(jumps, np.flatnonzero(np.diff(jumps) != 1) + 1):
        steps = u[run] - u[run - 1]
        size = np.abs(steps[1:-1])
        ramp = run.size > 3 and np.all(steps * steps[0] > 0.0) and size.max() < _ALIKE * size.min()
        kept.extend([int(run[0]), int(run[-1])] if ramp else run.tolist())
    return np.array(kept, dtype=np.int64)


def _kinks(u: Array, jumps: NDArray[np.int64], clock: Array | None = None) -> NDArray[np.int64]:
    """Return the indices ``n`` of the intervals ``(n − 1, n)`` in which the slope changes."""
    span = float(np.ptp(u))
    if span == 0.0 or u.size < 2 * _BESIDE + 4:
        return np.zeros(0, np.int64)
    bend = np.diff(u, 2)  # bend[i] belongs to sample i + 1
    if clock is not None:
        bend = 2.0 * np.diff(np.diff(u) / np.diff(clock)) / (clock[2:] - clock[:-2])
    # A difference across a jump says nothing of slopes.
    across = np.concatenate([jumps - 2, jumps - 1])
    bend[across[(across >= 0) & (across < bend.size)]] = 0.0
    change = np.abs(bend[:-1] + bend[1:])  # at the interval between samples i + 1 and i + 2
    size = np.pad(np.abs(bend), _BESIDE, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(size, _BESIDE)
    # The lower median: the two second differences of another kink near by do not hide this one.
    typical = np.partition(windows, _BESIDE // 2 - 1, axis=1)[:, _BESIDE // 2 - 1]
    surroundings = np.maximum(typical[: change.size], typical[_BESIDE + 2 : _BESIDE + 2 + change.size])
    # Levels that lie far apart are a staircase, not a quantised signal.
    rounding = min(_KINK_STEPS * quantisation_step(u), _COARSE * span)
    bent = (change > max(_KINK_SHARE * span, rounding)) & (change > 2.0 * _KINK_RATIO * surroundings)
    # Of neighbouring intervals that share the bend of one sample, the one with the largest change of slope.
    next_to = np.maximum(np.pad(change, (0, 1))[1:], np.pad(change, (1, 0))[:-1])
    places = np.flatnonzero(bent & (change >= next_to)) + 2
    places = places[np.concatenate([[True], np.diff(places) > 1])] if places.size else places
    return places[~np.isin(places, jumps)]


METHODS = ("cubic", "quintic", "band_limited", "linear", "zero_order")
# What is declared to be linear or held between samples has no breaks to look for. What is band-limited has none either:
# it rings where it sets in, and a stretch cut off there is wrong at its ends.
WITH_BREAKS = ("cubic", "quintic")
_JUMP_INTERVALS = 32
# How many times as many sub-steps follow a jump; fewer where jumps follow each other so closely that most of the
# recording would have them.
_JUMP_FACTOR, _DENSE_FACTOR, _DENSE_SHARE = 16, 4, 0.5
# Instants of jumps that nobody knows: at the later sample, as of a source that holds each value; in the middle of the
# interval where the transition takes longer than that.
HELD, _MIDDLE = 1.0, 0.5
_SHARP = 1e-15


def substep_counts(u: Array, before: float, substeps: int) -> NDArray[np.int64]:
    """Return (N−1,) sub-steps of every sample interval: more of them after each jump, where motion is fastest; an input
    may jump from what it was ``before`` the first sample."""
    counts = np.full(u.size - 1, substeps, dtype=np.int64)
    jumps = (find_jumps(u) - 1).tolist()
    if starts_with_jump(u, before):
        jumps.append(0)
    dense = len(jumps) > 2 and len(jumps) * _JUMP_INTERVALS > _DENSE_SHARE * u.size
    for interval in jumps:
        counts[interval : interval + _JUMP_INTERVALS] = substeps * (_DENSE_FACTOR if dense else _JUMP_FACTOR)
    return counts


def starts_with_jump(u: Array, before: float) -> bool:
    """Return whether the first sample (N,) lies far from the input before it."""
    return bool(abs(u[0] - before) > _JUMP_SHARE * float(np.ptp(u)))


def mean_input(fine: Array) -> Array:
    """Return (n,) means over the sub-steps by Simpson's rule."""
    return np.asarray((fine[..., 0] + 4.0 * fine[..., 1] + fine[..., 2]) / 6.0)


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """An input between its samples.

    Attributes:
        u: (N,) samples.
        counts: (N−1,) sub-steps of the sample intervals.
        method: one of ``cubic``, ``quintic``, ``band_limited``, ``linear``, ``zero_order``.
        sharp: whether jumps to and from a single sample happen at once like all others.
        clock: (N,) instants of the samples in mean intervals, where these are not equal.

    Raises:
        InputRefused: an unknown method.
    """

    u: Array
    counts: NDArray[np.int64]
    method: str
    sharp: bool = False
    clock: Array | None = None

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise InputRefused(f"input: {self.method!r} is not a reconstruction; choose {', '.join(METHODS)}")

    @cached_property
    def breaks(self) -> Breaks:
        """Return where the input is not smooth."""
        if self.method in WITH_BREAKS:
            return find_breaks(self.u, self.clock)
        return Breaks(np.zeros(0, np.int64), np.zeros(0))

    @cached_property
    def nominal(self) -> Array:
        """Return (J,) instants that are assumed of jumps, in sample intervals behind the sample before the jump."""
        return np.array([HELD if j.law == _FAST else _MIDDLE for j in self._jumps])

    def fine(self, instants: Array | None = None) -> Array:
        """Return (n, 3) input at the start, middle and end of the sub-steps; its Simpson mean is exact in the sub-step
        of a break, where the end of one row and the start of the next differ.

        Args:
            instants: (J,) of the jumps, each between 0 and 1 sample interval behind the sample before it.
        """
        if not self._jumps:
            return self._known
        fine = self._known.copy()
        for jump, instant in zip(self._jumps, self.nominal if instants is None else instants, strict=True):
            fine[jump.rows] = jump.values(instant)
        return fine

    def slopes(self, instants: Array, group: NDArray[np.int64]) -> Array:
        """Return (n, G) derivatives of the mean input by instants that several jumps may share: ``group`` (J,) says
        which one each jump has, 0 … G − 1."""
        out = np.zeros((self._known.shape[0], int(group.max(initial=-1)) + 1))
        for jump, instant, g in zip(self._jumps, instants, group, strict=True):
            out[jump.rows, g] += jump.slope(instant)
        return out

    @cached_property
    def _nodes(self) -> NDArray[np.int64]:
        return np.concatenate([[0], np.cumsum(self.counts)])

    @cached_property
    def _positions(self) -> Array:
        """Return (n, 3) start, middle and end of the sub-steps, counted in samples."""
        nodes, interval = self._nodes, np.repeat(np.arange(self.counts.size), self.counts)
        first = interval + (np.arange(nodes[-1]) - nodes[interval]) / self.counts[interval]
        size = 1.0 / self.counts[interval]
        return np.column_stack([first, first + 0.5 * size, first + size])

    @cached_property
    def _stretches(self) -> list[Stretch]:
        return self.breaks.stretches(self.u, self.method, self.clock)

    @cached_property
    def _known(self) -> Array:
        """Return (n, 3) the input, zero in the intervals of jumps."""
        if self.method == "zero_order":
            return np.repeat(np.repeat(self.u[:-1], self.counts)[:, None], 3, axis=1)
        fine = np.zeros(self._positions.shape)
        for stretch in self._stretches:
            rows = slice(self._nodes[stretch.first], self._nodes[stretch.first + stretch.u.size - 1])
            fine[rows] = stretch(self._positions[rows])
        for n, instant, (earlier, later) in self._broken:
            if not np.isnan(instant):
                rows = slice(self._nodes[n - 1], self._nodes[n])
                fine[rows] = _kinked(self._positions[rows], n - 1 + instant, earlier, later)
        fine.flags.writeable = False
        return fine

    @property
    def _broken(self) -> list[tuple[int, float, tuple[Stretch, Stretch]]]:
        """Return the sample, instant and sides of every break."""
        return list(zip(self.breaks.at.tolist(), self.breaks.instant, pairwise(self._stretches), strict=True))

    @cached_property
    def _jumps(self) -> list[_Jump]:
        jumps = []
        for n, instant, (earlier, later) in self._broken:
            if np.isnan(instant):
                rows = slice(int(self._nodes[n - 1]), int(self._nodes[n]))
                at = self._positions[rows]
                law = _law_of(earlier, later, 0 if self.sharp else self.u.size)
                jumps.append(_Jump(rows, at - (n - 1), earlier(at), later(at) - earlier(at), law))
        return jumps


# Centre and duration of a transition, in sample intervals: linear functions of the one unknown.
_Law = tuple[tuple[float, float], tuple[float, float]]
_FAST: _Law = (0.0, 1.0), (0.0, 0.0)
# A transition by way of a single sample begins somewhere before and ends at it, or the other way round.
_INTO: _Law = (0.5, 0.5), (1.0, -1.0)
_OUT_OF: _Law = (0.0, 0.5), (0.0, 1.0)


def _law_of(earlier: Stretch, later: Stretch, samples: int) -> _Law:
    """Return the transition between two stretches; samples: of the input, 0 where a single one says nothing."""
    if samples and later.u.size == 1 and later.first + 1 < samples and earlier.u.size > 1:
        return _INTO
    if samples and earlier.u.size == 1 and earlier.first > 0 and later.u.size > 1:
        return _OUT_OF
    return _FAST


@dataclass(frozen=True, eq=False)
class _Jump:
    """A transition from the earlier to the later stretch, linear in time, within one sample interval.

    Attributes:
        rows: its sub-steps.
        at: (r, 3) their positions in the interval, 0 to 1.
        earlier: (r, 3) the earlier stretch; gap: (r, 3) the later one minus it.
        law: of centre and duration.
    """

    rows: slice
    at: Array
    earlier: Array
    gap: Array
    law: _Law

    def _shares(self, instant: float) -> tuple[Array, Array, Array, Array]:
        """Return the edges of the sub-steps (r+1,), the share of the transition that is done at them, its integral, and
        the derivative of the integral by the duration."""
        edges = np.append(self.at[:, 0], 1.0)
        centre, duration = (begun + rate * instant for begun, rate in self.law)
        duration = max(duration, _SHARP)
        share = np.clip((edges - centre) / duration + 0.5, 0.0, 1.0)
        # The transition ends within its interval, also where rounding says otherwise.
        share[0], share[-1] = 0.0, 1.0
        integral = np.maximum(edges - centre, 0.0)
        if duration > _SHARP:
            integral = 0.5 * duration * share**2 + np.maximum(edges - centre - 0.5 * duration, 0.0)
        return edges, share, integral, 0.5 * share * (1.0 - share)

    def values(self, instant: float) -> Array:
        """Return (r, 3) the input; means over the sub-steps are exact where the gap is constant."""
        edges, _, integral, _ = self._shares(instant)
        return self.earlier + self.gap * (np.diff(integral) / np.diff(edges))[:, None]

    def slope(self, instant: float) -> Array:
        """Return (r,) derivative of the mean input by the instant."""
        edges, share, _, by_duration = self._shares(instant)
        (_, moved), (_, grown) = self.law
        change = -moved * np.diff(share) + grown * np.diff(by_duration)
        return np.asarray(mean_input(self.gap) * change / np.diff(edges))


def _kinked(at: Array, instant: float, earlier: Stretch, later: Stretch) -> Array:
    """Return (r, 3) the input on the sub-steps around a kink: the earlier stretch up to its instant, then the later.

    In the sub-step of the kink the middle is such that Simpson's rule gives the exact mean.
    """
    before, gap = earlier(at), later(at) - earlier(at)
    values = np.where(at >= instant, before + gap, before)
    for i in np.flatnonzero((at[:, 0] < instant) & (instant < at[:, 2])):
        share = (at[i, 2] - instant) / (at[i, 2] - at[i, 0])
        meeting = gap[i, 2] + (gap[i, 0] - gap[i, 2]) * share
        mean = float(mean_input(before[i])) + 0.5 * (meeting + gap[i, 2]) * share
        values[i, 1] = (6.0 * mean - values[i, 0] - values[i, 2]) / 4.0
    return np.asarray(values)
