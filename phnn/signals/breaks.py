"""Detect where a sampled input is not smooth: jumps of its value and kinks of its slope.

Between two samples a jump can happen at any instant. A kink can be placed: its instant is where the smooth pieces on
both sides, continued into the interval, meet.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from phnn.signals.sampling import quantisation_step
from phnn.signals.stretch import Stretch

Array = NDArray[np.float64]

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
        """(J,) the sample indices ``n`` of the jumps."""
        return self.at[np.isnan(self.instant)]

    def stretches(self, u: Array, method: str) -> list[Stretch]:
        """The B + 1 smooth stretches of the input (N,)."""
        edges = [0, *self.at.tolist(), u.size]
        # A curve through few samples, continued beyond them, leads far away from what they say.
        short = _CURVED if self.at.size else 0
        return [Stretch(a, u[a:b], method if b - a >= short else "linear") for a, b in pairwise(edges)]


def find_jumps(u: Array) -> NDArray[np.int64]:
    """Indices ``n`` where the input jumps between samples ``n − 1`` and ``n``.

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
    around = np.lib.stride_tricks.sliding_window_view(padded, 7)
    neighbours = np.delete(around, 3, axis=1)
    typical = np.median(neighbours, axis=1)
    return np.flatnonzero((steps > _JUMP_SHARE * span) & (steps > _JUMP_RATIO * typical)) + 1


def find_breaks(u: Array) -> Breaks:
    """Jumps and kinks of an input (N,).

    A band-limited signal that is sampled well has second differences that vary slowly from sample to sample. A kink
    adds its change of slope to the two second differences next to it, whatever its instant between the samples. Where
    the smooth stretches on both sides do not meet within the interval, the value jumps.
    """
    jumps = _without_ramps(u, find_jumps(u))
    at = np.union1d(jumps, _kinks(u, jumps))
    sides = Breaks(at, np.full(at.size, np.nan)).stretches(u, "cubic")
    near = _TOUCHING * float(np.ptp(u))
    return Breaks(at, np.array([_meeting(n, a, b, near) for n, (a, b) in zip(at, pairwise(sides), strict=True)]))


def _meeting(n: int, left: Stretch, right: Stretch, near: float) -> float:
    """Where two stretches meet, in sample intervals behind sample ``n − 1``; NaN where they do not."""
    if min(left.u.size, right.u.size) < 2:
        # A single sample has no slope: how it was reached and left is not known.
        return np.nan
    at = np.linspace(-_BEYOND, 1.0 + _BEYOND, _GRID)
    apart = right(n - 1 + at) - left(n - 1 + at)
    crossing = np.flatnonzero(apart[:-1] * apart[1:] <= 0.0)
    if crossing.size:
        i = int(crossing[0])
        share = apart[i] / (apart[i] - apart[i + 1]) if apart[i] != apart[i + 1] else 0.0
        return float(np.clip(at[i] + share * (at[i + 1] - at[i]), 0.0, 1.0))
    closest = int(np.argmin(np.abs(apart)))
    return float(np.clip(at[closest], 0.0, 1.0)) if abs(apart[closest]) < near else np.nan


def _without_ramps(u: Array, jumps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Jumps without those inside a fast ramp: of four or more in a row, one way and alike, the two ends remain."""
    kept: list[int] = []
    for run in np.split(jumps, np.flatnonzero(np.diff(jumps) != 1) + 1):
        steps = u[run] - u[run - 1]
        size = np.abs(steps[1:-1])
        ramp = run.size > 3 and np.all(steps * steps[0] > 0.0) and size.max() < _ALIKE * size.min()
        kept.extend([int(run[0]), int(run[-1])] if ramp else run.tolist())
    return np.array(kept, dtype=np.int64)


def _kinks(u: Array, jumps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Indices ``n`` of the intervals ``(n − 1, n)`` in which the slope changes."""
    span = float(np.ptp(u))
    if span == 0.0 or u.size < 2 * _BESIDE + 4:
        return np.zeros(0, np.int64)
    bend = np.diff(u, 2)  # bend[i] belongs to sample i + 1
    # A difference across a jump says nothing of slopes.
    across = np.concatenate([jumps - 2, jumps - 1])
    bend[across[(across >= 0) & (across < bend.size)]] = 0.0
    change = np.abs(bend[:-1] + bend[1:])  # at the interval between samples i + 1 and i + 2
    size = np.pad(np.abs(bend), _BESIDE, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(size, _BESIDE)
    # The lower median: the two second differences of another kink near by do not hide this one.
    typical = np.partition(windows, _BESIDE // 2 - 1, axis=1)[:, _BESIDE // 2 - 1]
    beside = np.maximum(typical[: change.size], typical[_BESIDE + 2 : _BESIDE + 2 + change.size])
    # Levels that lie far apart are a staircase, not a quantised signal.
    rounding = min(_KINK_STEPS * quantisation_step(u), _COARSE * span)
    found = (change > max(_KINK_SHARE * span, rounding)) & (change > 2.0 * _KINK_RATIO * beside)
    # Of neighbouring intervals that share the bend of one sample, the one with the largest change of slope.
    next_to = np.maximum(np.pad(change, (0, 1))[1:], np.pad(change, (1, 0))[:-1])
    places = np.flatnonzero(found & (change >= next_to)) + 2
    places = places[np.concatenate([[True], np.diff(places) > 1])] if places.size else places
    return places[~np.isin(places, jumps)]
