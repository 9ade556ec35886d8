"""The files of `phnn check`: its document, its page and the figures of recordings."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from phnn.check import Checked
from phnn.recordings.reader import facts
from phnn.recordings.recording import Recording
from phnn.report.figures import amplitude_density, draw_trace, style
from phnn.report.formatting import display_unit
from phnn.report.page import Block, Section, Table, page
from phnn.report.sections import drawing
from phnn.results import Place

Array = NDArray[np.float64]

# Decades below the highest line that are worth drawing.
_DECADES = 7.0


def draw_recorded(recording: Recording) -> Figure:
    """Draw input, output (held-out samples on grey), loop and spectra of a recording; without an output its input."""
    r, u_label = recording, f"input ({recording.units.input})"
    if not np.isfinite(r.y).all():
        figure = style.new_figure(10.1, 2.5)
        _in_time(figure.subplots(), r, r.u, u_label, style.BEFORE)
        return figure
    figure = style.new_figure(10.1, 4.9)
    (u_axes, loop), (y_axes, spectrum) = figure.subplots(2, 2, width_ratios=[1.75, 1.0])
    scale = display_unit(float(np.abs(r.y).max()), r.units.output)
    y, y_label = r.y / scale.scale, f"output ({scale.name})"
    _in_time(u_axes, r, r.u, u_label, style.BEFORE)
    _in_time(y_axes, r, y, y_label, style.AFTER)
    loop.plot(r.u, y, color=style.AFTER, linewidth=0.5)
    loop.locator_params(nbins=5)
    style.finish(loop, u_label, y_label, None)
    _spectra(spectrum, r)
    return figure


def _in_time(axes: Axes, recording: Recording, x: Array, label: str, colour: str) -> None:
    draw_trace(axes, recording.t, x, color=colour, linewidth=0.9)
    for part in (p for p in recording.parts if p.use == "confirmation"):
        ends = recording.t[[part.first, part.last - 1]]
        axes.axvspan(*ends, color=style.FAINT, alpha=0.5, linewidth=0, zorder=0)
    axes.margins(x=0.01)
    style.finish(axes, "time (s)", label, None)


def _spectra(axes: Axes, recording: Recording) -> None:
    """Draw amplitude densities, the input's over its largest so that both have one axis."""
    unit = display_unit(recording.noise, recording.units.output)
    f, drive = amplitude_density(recording.u, recording.dt)
    _, output = amplitude_density(recording.y, recording.dt)
    floor = recording.noise * float(np.sqrt(2.0 * recording.dt)) / unit.scale
    output /= unit.scale
    highest = float(output.max())
    drive *= highest / max(float(drive.max()), 1e-300)
    axes.loglog(*_drawn(f, output), color=style.AFTER, linewidth=0.8, label="output")
    axes.loglog(*_drawn(f, drive), color=style.BEFORE, linewidth=0.6, label="input")
    axes.axhline(floor, color=style.INK, linewidth=1.0, dashes=(4, 2), label="noise floor")
    axes.set_ylim(max(0.1 * floor, highest * 10.0**-_DECADES), 3.0 * highest)
    style.finish(axes, "frequency (Hz)", f"output ({unit.name}/√Hz)", "upper right", ncols=3, columnspacing=1.0)


def _drawn(f: Array, density: Array) -> tuple[Array, Array]:
    """Evenly many points a decade, the highest of each stretch, so that no line is lost."""
    edges = np.unique(np.searchsorted(f, np.geomspace(f[0], f[-1], 1200)))
    return f[edges], np.maximum.reduceat(density, edges)


def write_check(checked: Checked, place: Place) -> None:
    """Write ``check.json`` and ``check.html`` into a folder."""
    (place / "check.json").write_json(checked.document())
    campaign = checked.campaign
    noticed = [[name, f.severity, f.text] for name, findings in checked.findings.items() for f in findings]
    noise = [[name, n.colour, "; ".join(n.notes)] for name, n in checked.noise.items()]
    able = [[a.shows, "yes" if a.able else "no", "" if a.able else a.record] for a in checked.abilities]
    first: list[Block] = [campaign.folder]
    first.append(Table(["recording", "", "what was noticed"], noticed, 3) if noticed else "Nothing suspicious.")
    sections = [
        Section(None, first),
        Section("What these recordings can show", [Table(["effects", "", "to record for them"], able, 3)], open=True),
        Section("Noise", [Table(["recording", "colour", "what else"], noise, 3)]),
        *(Section(f"{r.name} ({r.source})", _recorded(r)) for r in campaign.recordings),
        Section("What was understood", list(campaign.notes)),
    ]
    count = len(campaign.recordings)
    heading = f"What was understood of {count} recording{'s' if count != 1 else ''}"
    (place / "check.html").write(page(f"Recordings: {campaign.folder}", heading, sections))


def _recorded(recording: Recording) -> list[Block]:
    """Return the facts and the picture of a recording."""
    rows = [list(fact) for fact in facts(recording)]
    title = f"{recording.name}: input and output in time (held-out samples on grey), as a loop, and their spectra."
    return [
        Table(["", ""], rows, 2),
        *drawing(recording.name, title, title, partial(draw_recorded, recording), lines=False),
    ]
