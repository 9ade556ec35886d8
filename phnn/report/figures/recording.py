"""One recording before and after: time, error, loop, and the spectrum of the residual against the noise floor."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from phnn.report.document import FitRow
from phnn.report.evidence import Trace
from phnn.report.figures.style import AFTER, BEFORE, INK, MEASURED, new_figure, quiet_grid, say
from phnn.report.formatting import ratio
from phnn.report.reduction import envelope
from phnn.report.spectrum import longest_run, residual_spectrum
from phnn.report.view import View, error_limits, unscored, view_of

# Room for what stands around the panels, which is the same in all of these figures: to measure it in every one takes
# twice as long as to draw them.
_MARGINS = {"left": 0.072, "right": 0.992, "bottom": 0.09, "top": 0.95, "wspace": 0.175, "hspace": 0.38}


def _time_panel(axes: Axes, view: View) -> None:
    trace, part = view.trace, view.stretch
    t = trace.t[part]
    series = [(trace.measured, MEASURED, "measured", 4.0, "-"), (trace.before, BEFORE, view.names[0], 1.5, (0, (4, 2)))]
    if view.changed:
        series.append((trace.after, AFTER, view.names[1], 1.1, "-"))
    for y, colour, name, width, style in series:
        index = envelope(y[part])
        values = y[part][index] / view.output.scale
        axes.plot(t[index], values, color=colour, label=name, linewidth=width, linestyle=style)
    axes.set_title("In time" if view.whole else "In time, where the base model is worst")
    axes.set_ylabel(view.output_label)
    axes.set_xlabel("time (s)")
    axes.margins(x=0.01)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.16 * (high - low))
    axes.legend(loc="upper left", ncols=3, borderaxespad=0.1, columnspacing=1.2)


def _loop_panel(axes: Axes, view: View) -> None:
    trace, part = view.trace, view.stretch
    series = [(trace.measured, MEASURED, 4.0, "-"), (trace.before, BEFORE, 1.5, (0, (4, 2)))]
    if view.changed:
        series.append((trace.after, AFTER, 1.1, "-"))
    for y, colour, width, style in series:
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
        index = envelope(y)
        text = name if level is None else f"{name}: {ratio(level)} × noise"
        axes.plot(trace.t[index], y[index] / scale, color=colour, linewidth=0.8, label=text)
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
    axes.set_xlabel(_error_caption(view, remark))
    axes.set_ylabel(f"error ({view.error.name})")
    axes.margins(x=0.01)
    axes.legend(loc="upper left", ncols=3, borderaxespad=0.1, columnspacing=1.2)


def _error_caption(view: View, remark: str) -> str:
    remarks = [remark] if remark else []
    if not view.whole:
        remarks.append("bar: stretch above")
    if not view.trace.scored.all():
        remarks.append("pale: not scored")
    return "time (s)" + (f" – {'; '.join(remarks)}" if remarks else "")


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


def _panels() -> Figure:
    figure = new_figure(10.1, 5.5, constrained=False)
    figure.subplots(2, 2, width_ratios=[1.75, 1.0], gridspec_kw=_MARGINS)
    return figure


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
    figure = _panels() if reused is None else _emptied(reused)
    time, loop, error, spectrum = figure.axes
    _time_panel(time, view)
    _loop_panel(loop, view)
    _error_panel(error, view, fit)
    _spectrum_panel(spectrum, view)
    for axes in figure.axes:
        quiet_grid(axes)
    return figure
