"""The pictures of a report; each function takes values and returns a matplotlib figure.

Traces are drawn through their envelope: no spike is lost, and nothing aliases.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.signal import welch

from phnn.report.figures.style import AFTER, BEFORE, FAINT, INK, MEASURED, finish, literal, new_figure
from phnn.report.formatting import display_unit

if TYPE_CHECKING:
    from phnn.report.words import Picture


def envelope(y: np.ndarray, bins: int = 1500) -> np.ndarray:
    """Return the indices of the smallest and the largest sample of each of ``bins`` stretches, in order of time.

    A line through them covers the same pixels as the whole trace: no spike is lost, nothing aliases.
    Samples that are not finite are passed over. A trace of at most ``2 bins`` samples is kept as it is.
    """
    count = len(y)
    if count <= 2 * bins:
        return np.arange(count)
    width = -(-count // bins)
    blocks = np.full((-(-count // width), width), np.nan)
    blocks.ravel()[:count] = y
    finite = np.isfinite(blocks)
    lowest, highest = np.where(finite, blocks, np.inf).argmin(axis=1), np.where(finite, blocks, -np.inf).argmax(axis=1)
    starts = width * np.arange(len(blocks))
    return np.unique(np.concatenate(([0], starts + lowest, starts + highest, [count - 1])))


def draw_trace(axes: Axes, x: np.ndarray, y: np.ndarray, size: float = 1.0, bins: int = 1500, **style: Any) -> None:
    """Draw ``y / size`` over ``x``, through its envelope of ``bins`` stretches."""
    index = envelope(y, bins)
    axes.plot(x[index], y[index] / size, **style)


def cycles(u: np.ndarray) -> float:
    """Return the number of cycles in an input, counted by crossings of its mid-range with 5 % hysteresis."""
    finite = u[np.isfinite(u)]
    if finite.size < 2 or np.ptp(finite) == 0.0:
        return 0.0
    middle = 0.5 * (finite.max() + finite.min())
    margin = 0.05 * np.ptp(finite)
    sides = np.where(finite > middle + margin, 1, np.where(finite < middle - margin, -1, 0))
    sides = sides[sides != 0]
    return 0.5 * float(np.count_nonzero(np.diff(sides)))


def telling_stretch(u: np.ndarray, error: np.ndarray, scored: np.ndarray, shown: float = 4.0) -> slice:
    """Return about ``shown`` cycles of the largest error of scored samples; a trace of at most twice as many whole."""
    count = len(u)
    number = cycles(u)
    if number <= 2.0 * shown or count < 100:
        return slice(0, count)
    width = min(count, max(50, round(shown * count / number)))
    square = np.where(scored & np.isfinite(error), error, 0.0) ** 2
    running = np.concatenate(([0.0], np.cumsum(square)))
    first = int(np.argmax(running[width:] - running[:-width]))
    return slice(first, first + width)


_SHORTEST = 32


def amplitude_density(x: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (K,) frequencies [Hz] without zero, and the one-sided amplitude density, in the unit of ``x`` by √Hz.

    Args:
        x: (N,) samples; dt: sampling interval [s].
    """
    segment = x.size if x.size < 8 * _SHORTEST else x.size // 3
    f, power = welch(x, fs=1.0 / dt, nperseg=segment, detrend="constant")
    return f[1:], np.sqrt(power[1:])


# Samples of a trace on the page: two for each of so many stretches.
_STRETCHES = 500
# Share of the samples whose errors fill a panel: a single jump must not flatten all others.
_USUAL = 99.9
# The band of the noise, in standard deviations.
_BAND = 2.0


@dataclass(frozen=True)
class Trace:
    """One part of one recording, with what the base model and the final model say of it.

    Attributes:
        t: (N,) time [s]; u: (N,) input; measured, before, after: (N,) recorded output and outputs of both models, SI.
        noise: standard deviation of the output's noise; None where no floor was found.
        unit: SI unit of the output; held_out: no model was fitted to it.
        over_noise: root mean square of the error of the base model, over that of the noise; NaN where it is unknown.
    """

    name: str
    t: np.ndarray
    u: np.ndarray
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray
    noise: float | None
    unit: str
    held_out: bool
    over_noise: float

    @property
    def changed(self) -> bool:
        """Return whether the final model differs from the base model."""
        return not np.array_equal(self.before, self.after, equal_nan=True)

    @property
    def stretch(self) -> slice:
        """Return the samples that are drawn: some cycles where the error of the base model is largest."""
        return telling_stretch(self.u, self.measured - self.before, np.isfinite(self.measured))


# A line of a picture: its samples, colour, name and width.
Line = tuple[np.ndarray, str, str, float]


def draw_error(trace: Trace) -> Figure:
    """Draw the error of a recording before and after, against the band of its noise."""
    figure = new_figure(5.4, 2.7)
    _errors_of(figure.subplots(), trace)
    return figure


def draw_recording(trace: Trace) -> Figure:
    """Draw a recording and both models, with their errors below."""
    figure = new_figure(5.4, 4.2)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.2, 1.0])
    part = trace.stretch
    lines = [(trace.measured, MEASURED, "measured", 4.0), (trace.before, BEFORE, "base model", 1.5)]
    lines += [(trace.after, AFTER, "final model", 1.1)] if trace.changed else []
    shown = [(y[part], colour, name, width) for y, colour, name, width in lines]
    outputs_into(above, trace.t[part], shown, trace.unit, _STRETCHES)
    _errors_of(below, trace)
    return figure


def _errors_of(axes: Axes, trace: Trace) -> None:
    part = trace.stretch
    lines = [((trace.measured - trace.before)[part], BEFORE, "base model", 0.9)]
    lines += [((trace.measured - trace.after)[part], AFTER, "final model", 0.9)] if trace.changed else []
    errors_into(axes, trace.t[part], lines, trace.noise, trace.unit, _STRETCHES)


def outputs_into(axes: Axes, t: np.ndarray, lines: Sequence[Line], unit: str, bins: int = 1500) -> None:
    """Draw outputs over time [s] into axes; the first line gives the unit that suits."""
    shown = display_unit(_reach(lines[0][0], 100.0), unit)
    for y, colour, name, width in lines:
        draw_trace(axes, t, y, shown.scale, bins, color=colour, label=name, linewidth=width)
    axes.margins(x=0.01)
    finish(axes, "", f"output ({shown.name})", "upper left", room=0.2, ncols=len(lines))


def errors_into(
    axes: Axes, t: np.ndarray, lines: Sequence[Line], noise: float | None, unit: str, bins: int = 1500
) -> None:
    """Draw errors over time [s] into axes, against the band of the noise where its standard deviation is known."""
    band = _BAND * noise if noise else 0.0
    limit = 1.1 * max(_reach(np.concatenate([y for y, *_ in lines]), _USUAL), 1.5 * band) or 1.0
    shown = display_unit(limit, unit)
    if band:
        axes.axhspan(-band / shown.scale, band / shown.scale, color=FAINT, linewidth=0, label="noise (± 2 σ)")
    for y, colour, name, width in lines:
        draw_trace(axes, t, y, shown.scale, bins, color=colour, label=name, linewidth=width)
    axes.set_ylim(-limit / shown.scale, 1.5 * limit / shown.scale)
    axes.margins(x=0.01)
    finish(axes, "time (s)", f"error ({shown.name})", "upper left", ncols=3)


def _reach(y: np.ndarray, share: float) -> float:
    """Return the size that a share [%] of the finite samples does not exceed."""
    known = np.abs(y[np.isfinite(y)])
    return float(np.percentile(known, share)) if known.size else 0.0


def draw_curve(curve: Picture) -> Figure:
    """Draw what was learned where an element acts, or the law of a learned element."""
    figure = new_figure(5.4, 2.8)
    axes = figure.subplots()
    order = np.argsort(curve.x, kind="stable")
    x, y = curve.x[order], curve.y[order]
    if curve.std is not None:
        spread = 2.0 * curve.std[order]
        axes.fill_between(x, y - spread, y + spread, color=FAINT, linewidth=0, label="± 2 standard errors")
    axes.plot(x, y, color=AFTER, linewidth=2.0, label="learned from the recordings")
    axes.axhline(0.0, color=INK, linewidth=0.5, zorder=0)
    if curve.x_label.startswith("time after"):
        axes.set_xscale("log")
    if x.size and x[0] < 0.0 < x[-1]:
        axes.axvline(0.0, color=INK, linewidth=0.5, zorder=0)
    finish(axes, literal(curve.x_label, 120), literal(curve.y_label, 120))
    return figure
