"""Recordings on a common grid of time, for models in discrete time.

Recordings of slow and of fast signals have different sampling intervals; a model in discrete time has one. Inputs are
interpolated as the recording says, outputs by cubic splines, after those that are sampled much finer than the grid are
smoothed over a grid interval (Savitzky–Golay, cubic). Values are over the scales of `samples`; the zero of a recording
from rest is taken from its first samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter

from phnn.recordings.recording import Recording
from studies.rival_models.rival import Fitted
from studies.rival_models.samples import Mask, Scales, highest

Array = NDArray[np.float64]

_FINE = 5  # samples in a grid interval from which on outputs are smoothed
_FIRST = 0.01  # share of a recording whose samples tell its zero


@dataclass(frozen=True)
class Gridded:
    """One recording on the grid, in scaled values.

    Attributes:
        u: (N,) input; y: (N,) output less its zero, NaN where none was recorded.
        before: scaled input before the first sample.
        rest: it begins at rest; run_in: samples in front of it that belong to the run-in of a periodic one.
        noise: standard deviation of the output's noise, scaled, times the root of grid samples over recorded ones: a
            recording weighs as much as with the samples it was recorded with.
        known: grid samples before the first scored one that is held out; only their outputs may begin a simulation.
    """

    u: Array
    y: Array
    before: float
    rest: bool
    run_in: int
    noise: float
    known: int = 0


def interval(recordings: Sequence[Recording], per_period: float) -> float:
    """Grid interval [s]: so many samples a period of the highest frequency, and none finer than all recordings are."""
    return max(1.0 / (per_period * highest(recordings)), min(r.dt for r in recordings))


def gridded(recording: Recording, dt: float, scales: Scales, zero: float) -> Gridded:
    """A recording on the grid; a periodic one is preceded by a cycle.

    Args:
        zero: of recordings that do not start from rest, SI.
    """
    rest = recording.start.state == "rest"
    u, y, cycle = recording.u, recording.y, recording.cycle
    if rest:
        zero = first_zero(recording)
    if cycle:
        u, y = np.concatenate([u[-cycle:], u]), np.concatenate([y[-cycle:], y])
    t = np.arange(u.size, dtype=np.float64) * recording.dt
    grid = grid_times(t, dt)
    return Gridded(
        _input(recording, t, u, grid) / scales.u,
        (_output(recording, t, y, grid, dt) - zero) / scales.y,
        float(recording.start.input_before if rest else u[0]) / scales.u,
        rest, int(np.searchsorted(grid, cycle * recording.dt)),
        recording.noise / scales.y * float(np.sqrt(grid.size / t.size)),
        int(_unscored(recording) * recording.dt / dt),
    )  # fmt: skip


def _unscored(recording: Recording) -> int:
    """Samples before the first that is held out and scored."""
    return min((p.first for p in recording.parts if p.use == "confirmation"), default=recording.t.size)


def grid_times(t: Array, dt: float) -> Array:
    """(N,) times of the grid that reach the last sample."""
    return np.arange(int(np.ceil((t[-1] - t[0]) / dt - 1e-9)) + 1, dtype=np.float64) * dt


def _input(recording: Recording, t: Array, u: Array, grid: Array) -> Array:
    if abs(grid.size - t.size) <= 1 and abs(grid[1] - t[1]) < 1e-9 * t[1]:
        return np.interp(grid, t, u)
    if recording.interpolation == "zero_order":
        return np.asarray(u[np.clip(np.searchsorted(t, grid + 1e-9 * t[1], side="right") - 1, 0, u.size - 1)])
    if recording.interpolation == "linear":
        return np.interp(grid, t, u)
    return np.asarray(CubicSpline(t, u)(np.minimum(grid, t[-1])))


def _output(recording: Recording, t: Array, y: Array, grid: Array, dt: float) -> Array:
    if not np.isfinite(y).all():
        return np.full(grid.size, np.nan)
    fine = int(dt / recording.dt)
    if fine >= _FINE:
        y = savgol_filter(y, 2 * (fine // 2) + 1, 3)
    return np.asarray(CubicSpline(t, y)(np.minimum(grid, t[-1])))


def first_zero(recording: Recording) -> float:
    """Output at rest [SI]: a polynomial without a linear term through the first samples, as nothing moves at once."""
    count = max(8, round(_FIRST * recording.y.size))
    if not np.isfinite(recording.y[:count]).all():
        return 0.0
    x = np.arange(min(count, recording.y.size)) / count
    columns = np.column_stack([np.ones(x.size), x**2, x**3])
    return float(np.linalg.lstsq(columns, recording.y[: x.size], rcond=None)[0][0])


def on_grid(recording: Recording, mask: Mask, dt: float, run_in: int, samples: int) -> Mask:
    """(N,) the grid samples that lie in a mask of the recording; none in the run-in."""
    places = np.minimum(np.round((np.arange(samples) - run_in) * dt / recording.dt).astype(int), mask.size - 1)
    return (places >= 0) & mask[np.maximum(places, 0)]


def back(recording: Recording, y: Array, dt: float, run_in: int, scales: Scales) -> Array:
    """(N,) scaled outputs of the grid at the recording's own samples, SI."""
    if not np.isfinite(y).all():
        return np.full(recording.t.size, np.inf)
    grid = (np.arange(y.size) - run_in) * dt
    t = np.arange(recording.t.size) * recording.dt
    if abs(dt - recording.dt) < 1e-9 * dt:
        return y[run_in : run_in + t.size] * scales.y
    return np.asarray(CubicSpline(grid, y)(np.clip(t, grid[0], grid[-1]))) * scales.y


@dataclass(frozen=True)
class OnGrid(Fitted):
    """A fitted model in discrete time.

    Attributes:
        grid: its sampling interval, s; scales: of what it takes and gives.
        zero: of the output, SI, in recordings that do not start from rest.
    """

    grid: float = 0.0
    scales: Scales = None  # type: ignore[assignment]
    zero: float = 0.0

    @property
    def dt(self) -> float | None:
        return self.grid

    def gridded(self, recording: Recording) -> Gridded:
        """The recording on the model's grid."""
        return gridded(recording, self.grid, self.scales, self.zero)

    def back(self, recording: Recording, y: Array, g: Gridded) -> Array:
        """(N,) scaled outputs on the grid as outputs at the recording's samples [SI]."""
        return back(recording, y, self.grid, g.run_in, self.scales)
