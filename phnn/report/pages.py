"""The files of `phnn check`: its document and its page with figures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.signal import periodogram

from phnn.check import Checked
from phnn.recordings.describe import facts
from phnn.recordings.recording import Part, Recording
from phnn.report.figures import draw_trace, style
from phnn.report.formatting import Unit, display_unit
from phnn.report.page import plain_page
from phnn.results import Place

Array = NDArray[np.float64]


# Decades below the highest line that are worth drawing.
_DECADES = 7.0


def draw_recorded(recording: Recording) -> Figure:
    """Four panels; held-out samples stand on grey."""
    figure = style.new_figure(10.1, 4.9)
    (u_axes, loop), (y_axes, spectrum) = figure.subplots(2, 2, width_ratios=[1.75, 1.0])
    measured = bool(np.isfinite(recording.y).all())
    scale = display_unit(float(np.abs(recording.y).max()) if measured else None, recording.units.output, floor=1.0)
    _in_time(u_axes, recording.t, recording.u, f"input ({recording.units.input})", style.BEFORE, recording.parts)
    if measured:
        _in_time(y_axes, recording.t, recording.y / scale.scale, f"output ({scale.name})", style.AFTER, recording.parts)
        _loop(loop, recording, scale)
        _spectra(spectrum, recording)
    else:
        for axes in (y_axes, loop, spectrum):
            style.say(axes, "no output was recorded")
    y_axes.set_xlabel("time (s)")
    return figure


def _in_time(axes: Axes, t: Array, x: Array, label: str, colour: str, parts: Sequence[Part]) -> None:
    draw_trace(axes, t, x, color=colour, linewidth=0.9)
    for part in (p for p in parts if p.use == "confirmation"):
        axes.axvspan(t[part.first], t[part.last - 1], color=style.FAINT, alpha=0.5, linewidth=0, zorder=0)
    axes.set_ylabel(label)
    axes.margins(x=0.01)
    style.quiet_grid(axes)


def _loop(axes: Axes, recording: Recording, scale: Unit) -> None:
    axes.plot(recording.u, recording.y / scale.scale, color=style.AFTER, linewidth=0.5)
    axes.set_xlabel(f"input ({recording.units.input})")
    axes.set_ylabel(f"output ({scale.name})")
    axes.locator_params(nbins=5)
    style.quiet_grid(axes)


def _spectra(axes: Axes, recording: Recording) -> None:
    """Amplitude densities through a Hann window, the input's over its largest so that both have one axis."""
    unit = display_unit(recording.noise, recording.units.output)
    f, drive = _density(recording.u, recording.dt)
    _, output = _density(recording.y, recording.dt)
    floor = recording.noise * float(np.sqrt(2.0 * recording.dt)) / unit.scale
    output /= unit.scale
    highest = float(output.max())
    drive *= highest / max(float(drive.max()), 1e-300)
    axes.loglog(*_drawn(f, output), color=style.AFTER, linewidth=0.8, label="output")
    axes.loglog(*_drawn(f, drive), color=style.BEFORE, linewidth=0.6, label="input")
    axes.axhline(floor, color=style.INK, linewidth=1.0, dashes=(4, 2), label="noise floor")
    axes.set_ylim(max(0.1 * floor, highest * 10.0**-_DECADES), 3.0 * highest)
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel(f"output ({unit.name}/√Hz)")
    axes.legend(loc="upper right", ncols=3, borderaxespad=0.1, columnspacing=1.0)
    style.quiet_grid(axes)


def _density(x: Array, dt: float) -> tuple[Array, Array]:
    f, power = periodogram(x, fs=1.0 / dt, window="hann", detrend="constant")
    return f[1:], np.sqrt(power[1:])


def _drawn(f: Array, density: Array) -> tuple[Array, Array]:
    """Evenly many points a decade, the highest of each stretch, so that no line is lost."""
    edges = np.unique(np.searchsorted(f, np.geomspace(f[0], f[-1], 1200)))
    return f[edges], np.maximum.reduceat(density, edges)


def write_check(checked: Checked, place: Place) -> None:
    """Write ``check.json`` and ``check.html`` into a folder."""
    (place / "check.json").write_json(checked.document())
    recordings = checked.campaign.recordings
    page = plain_page(
        "phnn.report",
        "checked.html",
        checked=checked,
        noticed=[(name, f) for name, found in checked.findings.items() for f in found],
        place={r.name: i for i, r in enumerate(recordings, start=1)},
        entries=[_entry(r) for r in recordings],
    )
    (place / "check.html").write(page)


def _entry(recording: Recording) -> tuple[str, list[tuple[str, str]], style.Drawing]:
    """Return the head, the facts and the figure of a recording."""
    with rc_context(style.RC):
        picture = style.png(draw_recorded(recording))
    title = f"{recording.name}: input and output in time, loop, spectra"
    return f"{recording.name} ({recording.source})", facts(recording), style.Drawing("", title, title, picture)
