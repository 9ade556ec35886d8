"""The figures of a report; each function takes values and returns a matplotlib figure.

The view of a recording says what is drawn: units, labels, the stretch that tells most, envelopes and spectra.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from scipy.signal import welch

from phnn.report.document import FitRow, Location
from phnn.report.evidence import MISSING, SUPPLIED, Fingerprint, Shares, Trace
from phnn.report.figures.style import (
    AFTER,
    BEFORE,
    CATEGORIES,
    FAINT,
    INK,
    MEASURED,
    headroom,
    label,
    literal,
    new_figure,
    quiet_grid,
    quiet_rows,
    say,
)
from phnn.report.formatting import Unit, display_unit, quantity, ratio, words
from phnn.signals.sampling import longest_run, runs

if TYPE_CHECKING:
    from phnn.diagnose.words import Picture


def envelope(
    y: np.ndarray,  # (N,)
    bins: int = 1500,
) -> np.ndarray:
    """Indices of the smallest and the largest sample of each of ``bins`` stretches, in order of time.

    A line through them covers the same pixels as the whole trace: no spike is lost, nothing aliases.
    Samples that are not finite are passed over. A trace of at most ``2 bins`` samples is kept as it is.
    """
    count = len(y)
    if count <= 2 * bins:
        return np.arange(count)
    width = -(-count // bins)
    return np.unique(np.concatenate(([0], extremes(y, width).ravel(), [count - 1])))


def draw_trace(axes: Axes, x: np.ndarray, y: np.ndarray, size: float = 1.0, **style: Any) -> None:
    """Draw ``y / size`` over ``x``, through its envelope."""
    index = envelope(y)
    axes.plot(x[index], y[index] / size, **style)


def extremes(y: np.ndarray, width: int) -> np.ndarray:
    """(B, 2) indices of the smallest and the largest finite sample of every ``width`` samples (N,).

    Of a stretch without one both are its first sample.
    """
    rows = -(-len(y) // width)
    padded = np.full(rows * width, np.nan)
    padded[: len(y)] = y
    blocks = padded.reshape(rows, width)
    known = np.isfinite(blocks)
    ends = (np.where(known, blocks, np.inf).argmin(axis=1), np.where(known, blocks, -np.inf).argmax(axis=1))
    return np.stack(ends, axis=1) + np.arange(rows)[:, None] * width


def cycles(u: np.ndarray) -> float:
    """Number of cycles in an input, counted by crossings of its mid-range with 5 % hysteresis."""
    finite = u[np.isfinite(u)]
    if finite.size < 2 or np.ptp(finite) == 0.0:
        return 0.0
    middle = 0.5 * (finite.max() + finite.min())
    margin = 0.05 * np.ptp(finite)
    sides = np.where(finite > middle + margin, 1, np.where(finite < middle - margin, -1, 0))
    sides = sides[sides != 0]
    return 0.5 * float(np.count_nonzero(np.diff(sides)))


def telling_stretch(
    u: np.ndarray,  # (N,) input
    error: np.ndarray,  # (N,) residual of the base model
    scored: np.ndarray,  # (N,) bool
    shown: float = 4.0,
) -> slice:
    """About ``shown`` cycles where the error is largest, or the whole trace where it has no more than twice that."""
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


@dataclass(frozen=True)
class Spectrum:
    """Amplitude spectral densities, one-sided; the zero frequency is left out."""

    frequency: np.ndarray  # (K,) Hz
    before: np.ndarray  # (K,) m/√Hz
    after: np.ndarray  # (K,) m/√Hz
    noise: float  # m/√Hz, white noise of the stated standard deviation


def residual_spectrum(
    t: np.ndarray,  # (N,) s
    before: np.ndarray,  # (N,) residual of the base model
    after: np.ndarray,  # (N,) residual of the final model
    usable: np.ndarray,  # (N,) bool
    noise: float,
) -> Spectrum | None:
    """Welch estimate over the longest usable stretch, in segments of a third of it, so that lines stay sharp.

    White noise of standard deviation σ sampled every Δt has the one-sided density ``σ √(2 Δt)``.
    ``None`` where the stretch has fewer than 32 samples.
    """
    part = longest_run(usable & np.isfinite(before) & np.isfinite(after))
    count = part.stop - part.start
    if count < _SHORTEST:
        return None
    step = float(t[part][-1] - t[part][0]) / (count - 1)
    (f, drawn_before), (_, drawn_after) = (amplitude_density(x[part], step) for x in (before, after))
    return Spectrum(f, drawn_before, drawn_after, noise * float(np.sqrt(2.0 * step)))


def amplitude_density(x: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """(K,) frequencies [Hz] without zero, and the one-sided amplitude density, in the unit of ``x`` by √Hz.

    Args:
        x: (N,) samples; dt: sampling interval [s].
    """
    segment = x.size if x.size < 8 * _SHORTEST else x.size // 3
    f, power = welch(x, fs=1.0 / dt, nperseg=segment, detrend="constant")
    return f[1:], np.sqrt(power[1:])


_INPUTS = {"V": "voltage", "N": "force", "A": "current"}


@dataclass(frozen=True)
class View:
    """What all panels and plots of a recording share.

    Attributes:
        error_before, error_after: (N,) measured minus model, SI.
        stretch: samples where the base model is worst; all where the recording is short.
        output, error: display units of the output and of its errors.
        changed: the final model differs from the base model; names: of both models.
    """

    trace: Trace
    error_before: np.ndarray
    error_after: np.ndarray
    stretch: slice
    output: Unit
    error: Unit
    input_label: str
    output_label: str
    output_unit: str
    changed: bool
    names: tuple[str, str]

    @property
    def whole(self) -> bool:
        """The stretch that tells most is the whole recording."""
        return self.stretch == slice(0, len(self.trace.t))


def _largest(*arrays: np.ndarray) -> float:
    values = [float(np.max(np.abs(a[np.isfinite(a)]))) for a in arrays if np.isfinite(a).any()]
    return max(values, default=0.0)


def _spread(trace: Trace) -> float:
    """Size of an error worth an axis: its 99th percentile on scored samples, or the noise."""
    error = (trace.measured - trace.before)[trace.scored]
    error = np.abs(error[np.isfinite(error)])
    return max(float(np.percentile(error, 99.0)) if error.size else 0.0, trace.noise if trace.noise > 0.0 else 0.0)


def view_of(trace: Trace, input_unit: str, output_unit: str) -> View:
    """How a recording is shown; the units are SI units of its channels."""
    output = display_unit(_largest(trace.measured), output_unit, floor=1.0)
    changed = not np.array_equal(trace.before, trace.after, equal_nan=True)
    error_before = trace.measured - trace.before
    return View(
        trace=trace,
        error_before=error_before,
        error_after=trace.measured - trace.after,
        stretch=telling_stretch(trace.u, error_before, trace.scored),
        output=output,
        error=display_unit(_spread(trace), output_unit),
        input_label=f"{_INPUTS.get(input_unit, 'input')} ({input_unit})",
        output_label=f"{'displacement' if output_unit == 'm' else 'output'} ({output.name})",
        output_unit=output_unit,
        changed=changed,
        names=("base model", "final model") if changed else ("base model (nothing added)", ""),
    )


def error_limits(view: View) -> tuple[float, str]:
    """Half the height of the error axis, and a remark where a few lone samples would have flattened all others."""
    usable = view.trace.scored
    errors = np.abs(np.concatenate((view.error_before[usable], view.error_after[usable])))
    errors = errors[np.isfinite(errors)]
    largest = _largest(errors)
    common = float(np.percentile(errors, 99.9)) if errors.size else 0.0
    if common > 0.0 and largest > 3.0 * common:
        beyond = np.fmax(np.abs(view.error_before), np.abs(view.error_after)) > 2.0 * common
        count = int(np.count_nonzero(beyond & usable))
        limit, noun = 2.0 * common, "sample" if count == 1 else "samples"
        remark = f"{count} {noun} beyond, up to {quantity(largest, view.output_unit)}"
    else:
        limit, remark = largest, ""
    return 1.12 * max(limit, 3.0 * view.trace.noise if view.trace.noise > 0.0 else 0.0) or 1.0, remark


def unscored(scored: np.ndarray) -> list[slice]:
    """Stretches that were not scored, none where nothing was."""
    return runs(~scored) if scored.any() else []


_TIED = "#8fb8d8"


def draw_locations(location: Location) -> Figure:
    """Share of the explainable residual that each location predicts on recordings left out, best on top."""
    figure = new_figure(7.2, height_of(location))
    locations_into(figure.subplots(), location)
    return figure


def height_of(location: Location) -> float:
    """Height of the figure in inches."""
    return 0.95 + 0.3 * max(len(location.scores), 2)


def locations_into(axes: Axes, location: Location) -> None:
    """Draw the bars into axes."""
    values = [score or 0.0 for _, score in location.scores]
    for row, (name, score) in enumerate(location.scores):
        first, tied = name == location.name, name in location.tied
        colour = AFTER if first else _TIED if tied else FAINT
        hatch = "////" if tied and not first else None
        axes.barh(row, score or 0.0, height=0.66, color=colour, hatch=hatch, edgecolor=AFTER if hatch else colour)
        text = "not tried" if score is None else f"{score:.2f}".replace("-", "−")
        axes.annotate(
            text,
            (max(score or 0.0, 0.0), row),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            fontweight="bold" if first else "normal",
        )
    axes.set_yticks(range(len(values)), [literal(words(name)) for name, _ in location.scores])
    for tick, (name, _) in zip(axes.get_yticklabels(), location.scores, strict=True):
        tick.set_fontweight("bold" if name == location.name else "normal")
        tick.set_color(INK)
    axes.set_xlim(min(0.0, *values, 0.0), 1.08 * max(1.0, *values, 1.0))
    axes.set_ylim(len(values) - 0.4, -0.6)
    axes.axvline(0.0, color="#8f969c", linewidth=0.8)
    quiet_rows(axes)
    label = "share of the explainable residual, predicted on recordings left out (1 = all of it)"
    best = dict(location.scores).get(location.name)
    if best is not None and max(values) > best:
        # The best one need not have the longest bar.
        label += "\na longer bar counts less where no other recording can confirm it, or where a refit has decided"
    axes.set_xlabel(label)
    if any(name in location.tied for name, _ in location.scores if name != location.name):
        handles = [
            Patch(facecolor=AFTER, label="best"),
            Patch(facecolor=_TIED, edgecolor=AFTER, hatch="////", label="tied with it"),
            Patch(facecolor=FAINT, label="explains less"),
        ]
        axes.legend(handles=handles, loc="lower right", frameon=True, framealpha=1.0, edgecolor="none")


# Room for what stands around the panels, which is the same in all of these figures: to measure it in every one takes
# twice as long as to draw them.
_MARGINS = {"left": 0.072, "right": 0.992, "bottom": 0.09, "top": 0.95, "wspace": 0.175, "hspace": 0.38}


def _series(view: View) -> list[tuple[np.ndarray, str, str, float, Any]]:
    """What is drawn of the outputs: values, colour, name, width and style of the line."""
    trace = view.trace
    series: list[tuple[np.ndarray, str, str, float, Any]] = [
        (trace.measured, MEASURED, "measured", 4.0, "-"),
        (trace.before, BEFORE, view.names[0], 1.5, (0, (4, 2))),
    ]
    if view.changed:
        series.append((trace.after, AFTER, view.names[1], 1.1, "-"))
    return series


def _time_panel(axes: Axes, view: View) -> None:
    part = view.stretch
    t = view.trace.t[part]
    for y, colour, name, width, style in _series(view):
        draw_trace(axes, t, y[part], view.output.scale, color=colour, label=name, linewidth=width, linestyle=style)
    axes.set_title("In time" if view.whole else "In time, where the base model is worst")
    axes.set_ylabel(view.output_label)
    axes.set_xlabel("time (s)")
    axes.margins(x=0.01)
    headroom(axes, 0.16)
    axes.legend(loc="upper left", ncols=3, borderaxespad=0.1, columnspacing=1.2)


def _loop_panel(axes: Axes, view: View) -> None:
    trace, part = view.trace, view.stretch
    for y, colour, _, width, style in _series(view):
        axes.plot(trace.u[part], y[part] / view.output.scale, color=colour, linewidth=width, linestyle=style)
    axes.set_title("Loop" if view.whole else "Loop, same stretch")
    axes.set_xlabel(view.input_label)
    axes.set_ylabel(view.output_label)


def _error_panel(axes: Axes, view: View, fit: FitRow | None) -> None:
    trace, scale = view.trace, view.error.scale
    if trace.noise > 0.0:
        band = 2.0 * trace.noise / scale
        for edge, text in ((band, "± 2 × noise"), (-band, None)):
            axes.axhline(edge, color=INK, linewidth=0.8, dashes=(4, 2), zorder=6, label=text)
    levels = (fit.before.residual_over_noise, fit.after.residual_over_noise) if fit else (None, None)
    series = [(view.error_before, BEFORE, view.names[0], levels[0])]
    if view.changed:
        series.append((view.error_after, AFTER, view.names[1], levels[1]))
    for y, colour, name, level in series:
        text = name if level is None else f"{name}: {ratio(level)} × noise"
        draw_trace(axes, trace.t, y, scale, color=colour, linewidth=0.8, label=text)
    limit, remark = error_limits(view)
    limit /= scale
    axes.set_ylim(-limit, 1.3 * limit)
    for part in unscored(trace.scored):
        axes.axvspan(trace.t[part.start], trace.t[part.stop - 1], color="white", alpha=0.6, linewidth=0, zorder=4)
        axes.axvline(trace.t[part.stop - 1], color="#6a7278", ymax=0.8, linewidth=0.8, dashes=(2, 2), zorder=5)
    if not view.whole:
        edges = trace.t[view.stretch][[0, -1]]
        axes.plot(edges, [1.04 * limit] * 2, color=INK, linewidth=3.0, solid_capstyle="butt", zorder=5)
    axes.set_title("Error (measured − model)")
    remarks = [remark] if remark else []
    remarks += [] if view.whole else ["bar: stretch above"]
    remarks += [] if trace.scored.all() else ["pale: not scored"]
    axes.set_xlabel("time (s)" + (f" – {'; '.join(remarks)}" if remarks else ""))
    axes.set_ylabel(f"error ({view.error.name})")
    axes.margins(x=0.01)
    axes.legend(loc="upper left", ncols=3, borderaxespad=0.1, columnspacing=1.2)


def _spectrum_panel(axes: Axes, view: View) -> None:
    trace = view.trace
    axes.set_title("Spectrum of the error")
    usable = trace.scored if trace.scored.any() else np.ones(len(trace.t), dtype=bool)
    spectrum = residual_spectrum(trace.t, view.error_before, view.error_after, usable, trace.noise)
    if spectrum is None:
        length = longest_run(usable)
        say(axes, f"{length.stop - length.start} usable samples in a row:\ntoo few for a spectrum")
        return
    scale = view.error.scale
    axes.loglog(spectrum.frequency, spectrum.before / scale, color=BEFORE, linewidth=1.0)
    if view.changed:
        axes.loglog(spectrum.frequency, spectrum.after / scale, color=AFTER, linewidth=0.9)
    if spectrum.noise > 0.0:
        axes.axhline(spectrum.noise / scale, color=INK, linewidth=1.2, dashes=(4, 2), label="noise floor")
        axes.legend(loc="upper right", borderaxespad=0.1)
    drawn = np.concatenate((spectrum.before, spectrum.after if view.changed else spectrum.before)) / scale
    drawn = drawn[drawn > 0.0]
    if drawn.size:
        floor = min(float(np.percentile(drawn, 1.0)), spectrum.noise / scale if spectrum.noise > 0.0 else np.inf)
        axes.set_ylim(0.5 * floor, 2.5 * float(drawn.max()))
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel(f"error ({view.error.name}/√Hz)")


def _emptied(figure: Figure) -> Figure:
    """The panels as they were before anything was drawn into them, but with their ticks, which take longest to make."""
    for axes in figure.axes:
        legend = axes.get_legend()
        for artist in (*axes.lines, *axes.patches, *axes.texts, *([legend] if legend is not None else [])):
            artist.remove()
        axes.relim()
        axes.set(xscale="linear", yscale="linear", xlabel="", ylabel="")
        axes.autoscale(True)
    return figure


def draw_recording(
    trace: Trace, fit: FitRow | None, input_unit: str = "V", output_unit: str = "m", reused: Figure | None = None
) -> Figure:
    """Four panels. The time axes are drawn through an envelope; the spectrum uses every scored sample.

    Args:
        reused: the figure of another recording, no longer needed: it is emptied and drawn anew.
    """
    view = view_of(trace, input_unit, output_unit)
    if reused is None:
        figure = new_figure(10.1, 5.5, constrained=False)
        figure.subplots(2, 2, width_ratios=[1.75, 1.0], gridspec_kw=_MARGINS)
    else:
        figure = _emptied(reused)
    time, loop, error, spectrum = figure.axes
    _time_panel(time, view)
    _loop_panel(loop, view)
    _error_panel(error, view, fit)
    _spectrum_panel(spectrum, view)
    for axes in figure.axes:
        quiet_grid(axes)
    return figure


def draw_ledger(rows: Sequence[Shares]) -> Figure:
    """Stacked bars: each dissipator, what was stored, the work of the missing force; negative parts go left."""
    figure = new_figure(9.0, 1.35 + 0.32 * len(rows))
    axes = figure.subplots()
    kinds = rows[0].kinds
    left, right = [0.0] * len(rows), [0.0] * len(rows)
    for place, kind in enumerate(kinds):
        missing, stored = kind == MISSING, kind == "stored"
        colour = "white" if missing else "#aeb4ba" if stored else CATEGORIES[place % len(CATEGORIES)]
        values = [100.0 * row.share(kind) for row in rows]
        # an empty part must not leave its outline behind
        drawn = [value if abs(value) > 0.05 else np.nan for value in values]
        starts = [right[i] if value >= 0.0 else left[i] for i, value in enumerate(values)]
        axes.barh(
            range(len(rows)),
            drawn,
            left=starts,
            height=0.64,
            color=colour,
            edgecolor=INK if missing else "white",
            linewidth=0.7,
            hatch="/////" if missing else None,
            label=literal(words(kind)),
        )
        for i, value in enumerate(values):
            right[i] += max(value, 0.0)
            left[i] += min(value, 0.0)
    axes.set_yticks(range(len(rows)), [literal(row.recording, 34) for row in rows])
    axes.set_ylim(len(rows) - 0.45, -0.55)
    axes.set_xlim(min(left) * 1.05, max(max(right) * 1.02, 102.0))
    axes.axvline(100.0, color="#4d555c", linewidth=0.9, dashes=(3, 2))
    axes.axvline(0.0, color="#8f969c", linewidth=0.8)
    quiet_rows(axes)
    supplied = all(row.base == SUPPLIED for row in rows)
    axes.set_xlabel(f"share of the {'energy supplied' if supplied else 'largest flow of energy'} (%)")
    # A legend fills its columns one after the other: in this order it reads along its rows.
    bars = axes.get_legend_handles_labels()[0]
    handles = [bar for column in range(4) for bar in bars[column::4]]
    axes.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderaxespad=0.2)
    return figure


def draw_overview(rows: Sequence[FitRow]) -> Figure:
    """Dots joined by a line for each recording, held-out recordings on top; 1 is the noise floor."""
    figure = new_figure(9.0, 1.0 + 0.29 * max(len(rows), 3))
    axes = figure.subplots()
    # A gap between the held-out recordings and the others.
    gap = 0.7 if any(r.held_out for r in rows) and not all(r.held_out for r in rows) else 0.0
    places = [i + (0.0 if row.held_out else gap) for i, row in enumerate(rows)]
    values = []
    for place, row in zip(places, rows, strict=True):
        pair = [s.residual_over_noise for s in (row.before, row.after)]
        known = [value for value in pair if value is not None and value > 0.0]
        axes.plot(known, [place] * len(known), color=FAINT, linewidth=2.5, zorder=1)
        for value, colour, marker in zip(pair, (BEFORE, AFTER), ("o", "D"), strict=True):
            if value is not None and value > 0.0:
                values.append(value)
                axes.scatter(value, place, s=42 if marker == "o" else 34, color=colour, marker=marker, zorder=3)
    axes.set_xscale("log")
    low, high = min([*values, 0.9]), max([*values, 2.0])
    axes.set_xlim(low / 1.15, high * 1.25)
    axes.axvline(1.0, color="#4d555c", linewidth=1.0, dashes=(3, 2), zorder=0)
    axes.annotate(
        "noise floor", (1.0, 1.0), xycoords=("data", "axes fraction"), xytext=(4, 2), textcoords="offset points"
    )
    axes.scatter([], [], s=42, color=BEFORE, marker="o", label="base model")
    if any(not row.after.empty for row in rows):
        axes.scatter([], [], s=34, color=AFTER, marker="D", label="final model")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.0)
    names = [literal(row.name, 34) + (" (held out)" if row.held_out else "") for row in rows]
    axes.set_yticks(places, names)
    for tick, row in zip(axes.get_yticklabels(), rows, strict=True):
        tick.set_fontweight("bold" if row.held_out else "normal")
    axes.set_ylim((places[-1] if places else 0.0) + 0.6, -0.6)
    quiet_rows(axes, "both")
    subs = (1.0, 2.0, 5.0) if high / low < 300.0 else (1.0,)
    axes.xaxis.set_major_locator(LogLocator(base=10.0, subs=subs))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("residual over noise (logarithmic)")
    return figure


def draw_fingerprint(found: Fingerprint) -> Figure:
    """Means with two standard errors, of the base and of the final model."""
    figure = new_figure(7.2, 3.4)
    axes = figure.subplots()
    rows = (
        (found.before, found.before_std, BEFORE, "o", "base model"),
        (found.after, found.after_std, AFTER, "s", "final model"),
    )
    for y, std, colour, marker, name in rows:
        axes.errorbar(
            found.x, y, 2.0 * std, color=colour, marker=marker, markersize=4.0, linewidth=1.2, capsize=2.0, label=name
        )  # fmt: skip
    axes.axhline(found.level, color="#8f969c", linewidth=0.8, zorder=0, label="noise alone")
    if found.logarithmic:
        axes.set_xscale("log")
    elif found.x[0] < 0.0 < found.x[-1]:
        axes.axvline(0.0, color="#8f969c", linewidth=0.7, zorder=0)
    if found.level > 0.0 and found.before.max() > 20.0 * found.level:
        axes.set_yscale("log")
    quiet_grid(axes)
    axes.set_xlabel(label(found.x_label))
    axes.set_ylabel(label(found.y_label))
    axes.legend(loc="best")
    return figure


def _draw(axes: Axes, curve: Picture) -> None:
    order = np.argsort(curve.x, kind="stable")
    x, y = curve.x[order], curve.y[order]
    if curve.std is not None:
        spread = 2.0 * curve.std[order]
        axes.fill_between(x, y - spread, y + spread, color=AFTER, alpha=0.16, linewidth=0, label="± 2 standard errors")
    axes.plot(x, y, color=AFTER, linewidth=2.0, label="learned from the recordings")
    axes.axhline(0.0, color="#8f969c", linewidth=0.7, zorder=0)
    if x.size and x[0] < 0.0 < x[-1]:
        axes.axvline(0.0, color="#8f969c", linewidth=0.7, zorder=0)
    quiet_grid(axes)
    axes.set_title(label(curve.title))
    axes.set_xlabel(label(curve.x_label))
    axes.set_ylabel(label(curve.y_label))
    axes.legend(loc="best")


def draw_picture(curves: Sequence[Picture]) -> Figure:
    """Up to two curves side by side, further ones below."""
    columns = min(len(curves), 2)
    rows = -(-len(curves) // columns)
    figure = new_figure(10.1 if columns == 2 else 7.2, 3.5 * rows)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes, curve in zip(grid.flat, curves, strict=False):
        _draw(axes, curve)
    for axes in list(grid.flat)[len(curves) :]:
        axes.set_visible(False)
    return figure
