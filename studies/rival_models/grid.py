"""Recordings on a common grid of time, for models in discrete time.

Recordings of slow and of fast signals have different sampling intervals; a model in discrete time has one. Inputs are
interpolated as the recording says, outputs by cubic splines, after those that are sampled much finer than the grid are
smoothed over a grid interval (Savitzky–Golay, cubic). Values are over their `Scales`; the zero of a recording from
rest is taken from its first samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter

from phnn.errors import InputRefused
from phnn.recordings.recording import Recording
from studies.rival_models.rival import Fitted, Mask, Scales, Stepper, highest, run_in, scales_of, split

Array = NDArray[np.float64]

_FINE = 5  # samples in a grid interval from which on outputs are smoothed
_FIRST = 0.01  # share of a recording whose samples tell its zero


@dataclass(frozen=True)
class Gridded:
    """One recording on the grid, in scaled values.

    Attributes:
        u: (N,) input; middle: (N,) input in the middle of the interval before each sample.
        y: (N,) output less its zero, NaN where none was recorded.
        before: scaled input before the first sample; rest: it begins at rest.
        run_in: samples in front of it that belong to the run-in of a periodic one.
        noise: standard deviation of the output's noise, scaled, times the root of grid samples over recorded ones: a
            recording weighs as much as with the samples it was recorded with.
        known: grid samples before the first scored one that is held out; only their outputs may begin a simulation.
    """

    u: Array
    middle: Array
    y: Array
    before: float
    rest: bool
    run_in: int
    noise: float
    known: int = 0

    @property
    def fine(self) -> Array:
        """Return (N, 3) inputs at the start, middle and end of the interval before each sample."""
        return np.column_stack([np.append(self.before, self.u[:-1]), self.middle, self.u])


def interval(recordings: Sequence[Recording], per_period: float) -> float:
    """Return the grid interval [s] of so many samples a period of the highest frequency.

    It is not finer than all recordings are.
    """
    return max(1.0 / (per_period * highest(recordings)), min(r.dt for r in recordings))


def gridded(recording: Recording, dt: float, scales: Scales, zero: float) -> Gridded:
    """Put a recording on the grid; a periodic one is preceded by a cycle.

    Args:
        zero: of recordings that do not start from rest, SI.
    """
    rest = recording.start.state == "rest"
    u, y, cycle = recording.u, recording.y, run_in(recording)
    zero = _first_zero(recording) if rest else zero
    if cycle:
        u, y = np.concatenate([u[-cycle:], u]), np.concatenate([y[-cycle:], y])
    t = np.arange(u.size, dtype=np.float64) * recording.dt
    grid = np.arange(int(np.ceil(t[-1] / dt - 1e-9)) + 1, dtype=np.float64) * dt
    inside, fine = np.minimum(grid, t[-1]), int(dt / recording.dt)

    def at(times: Array) -> Array:
        if recording.interpolation == "zero_order":
            return u[np.clip(np.searchsorted(t, times + 1e-9 * t[1], side="right") - 1, 0, u.size - 1)]
        linear = recording.interpolation == "linear"
        return np.asarray(np.interp(times, t, u) if linear else CubicSpline(t, u)(np.minimum(times, t[-1])))

    on_grid, before = at(grid), float(recording.start.input_before if rest else u[0])
    middle = np.append(0.5 * (before + on_grid[0]), at(grid[1:] - 0.5 * dt))
    if np.isfinite(y).all():
        y = CubicSpline(t, savgol_filter(y, 2 * (fine // 2) + 1, 3) if fine >= _FINE else y)(inside)
    else:
        y = np.full(grid.size, np.nan)
    scored = min((p.first for p in recording.parts if p.use == "confirmation"), default=recording.t.size)
    return Gridded(
        on_grid / scales.u, middle / scales.u, (y - zero) / scales.y, before / scales.u, rest,
        int(np.searchsorted(grid, cycle * recording.dt)),
        recording.noise / scales.y * float(np.sqrt(grid.size / t.size)), int(scored * recording.dt / dt),
    )  # fmt: skip


def _first_zero(recording: Recording) -> float:
    """Return the output at rest [SI]: a polynomial without a linear term, as nothing moves at once."""
    first = recording.y[: max(8, round(_FIRST * recording.y.size))]
    if not np.isfinite(first).all():
        return 0.0
    x = np.arange(first.size) / first.size
    return float(np.linalg.lstsq(np.column_stack([np.ones(x.size), x**2, x**3]), first, rcond=None)[0][0])


class GridStepper(Stepper):
    """A model of `OnGrid`, one sample after the other."""

    def __init__(self, fitted: Any) -> None:
        self.dt, self._fitted = fitted.grid, fitted


@dataclass(frozen=True)
class OnGrid(Fitted):
    """A fitted model in discrete time.

    Attributes:
        steps: its model sample by sample.
        grid: its sampling interval, s; scales: of what it takes and gives.
        zero: of the output, SI, in recordings that do not start from rest.
    """

    steps: ClassVar[type[GridStepper]]
    grid: float = 0.0
    scales: Scales = None  # type: ignore[assignment]
    zero: float = 0.0

    @property
    def dt(self) -> float | None:
        return self.grid

    def simulate(self, recording: Recording) -> Array:
        g = gridded(recording, self.grid, self.scales, self.zero)
        y = self.run_grid(g)
        if not np.isfinite(y).all():
            return np.full(recording.t.size, np.inf)
        t = np.arange(recording.t.size) * recording.dt
        if abs(self.grid - recording.dt) < 1e-9 * self.grid:
            return y[g.run_in : g.run_in + t.size] * self.scales.y
        times = (np.arange(y.size) - g.run_in) * self.grid
        return np.asarray(CubicSpline(times, y)(np.clip(t, times[0], times[-1]))) * self.scales.y

    def run_grid(self, g: Gridded) -> Array:
        """Return the (N,) scaled outputs of free simulation on the grid; not finite where it diverged."""
        raise NotImplementedError

    def stepper(self, dt: float) -> Stepper:
        if self.dt is not None and abs(dt - self.dt) > 1e-9 * self.dt:
            raise InputRefused(f"dt = {dt:g} s: this model steps at {self.dt:g} s, close the loop at that interval")
        return self.steps(self)


@dataclass(frozen=True)
class Data:
    """Recordings on one grid with the masks of `Split` there.

    Attributes:
        dt: grid interval, s; zero: mean output, SI.
        checked: recorded samples that are set aside.
    """

    dt: float
    scales: Scales
    zero: float
    gridded: tuple[Gridded, ...]
    fit: tuple[Mask, ...]
    check: tuple[Mask, ...]
    checked: int


def data_on(recordings: Sequence[Recording], per_period: float) -> Data:
    """Put the identification recordings on the grid of so many samples a period."""
    dt, parts, scales = interval(recordings, per_period), split(recordings), scales_of(recordings)
    zero = float(np.mean(np.concatenate([r.y[r.mask("identification")] for r in recordings])))
    grids = tuple(gridded(r, dt, scales, zero) for r in recordings)

    def on_grid(r: Recording, mask: Mask, g: Gridded) -> Mask:
        # None in the run-in, nor behind the last recorded sample, where the grid ends: no output is known there.
        places = (np.arange(g.u.size) - g.run_in) * dt / r.dt
        samples = np.clip(np.round(places).astype(int), 0, mask.size - 1)
        return (places > -0.5) & (places < mask.size - 1 + 1e-6) & mask[samples]

    fit, check = (
        tuple(on_grid(r, m, g) for r, m, g in zip(recordings, side, grids, strict=True))
        for side in (parts.fit, parts.check)
    )
    return Data(dt, scales, zero, grids, fit, check, sum(int(m.sum()) for m in parts.check))
