"""The files of `phnn check` and of `phnn modes`: their documents, pages, figures and models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape
from rich.table import Table as Listing
from scipy.optimize import linear_sum_assignment

from phnn.check import Checked
from phnn.errors import SolverFailed
from phnn.modal.elements import STATEMENTS
from phnn.modal.experiment import Experiment, Study, response
from phnn.modal.fit import ModalFit
from phnn.modal.store import channels_of, model_document, study_document
from phnn.modal.study import EQUIVALENT, NAMED, NONE, UNKNOWN, HeldOut, Result, Score
from phnn.models.store import FILE
from phnn.recordings.describe import facts
from phnn.recordings.recording import Recording
from phnn.report.figures import amplitude_density, draw_trace, style
from phnn.report.formatting import DASH, Unit, display_unit, plain, short, words
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


# Half width of the resonance that is shown, in half-power widths; bands of the spectra in an octave.
_WIDE, _BANDS = 8.0, 12


def draw_resonance(result: Result) -> Figure:
    """Responses where they move most with amplitude, one panel for each model."""
    study = result.study
    levels = range(len(study.levels))
    measured = [response(study.identification(i)) for i in levels]
    f, lines = study.frequencies, study.lines
    peak = np.abs(measured[0][lines])
    moved = np.abs(measured[-1][lines] - measured[0][lines]) if len(study.levels) > 1 else peak
    line, out, into = np.unravel_index(int(moved.argmax()), moved.shape)
    centre = f[lines[line]]
    near = result.alone[0].model
    zeta = near.zeta[np.abs(near.omega / (2.0 * np.pi) - centre).argmin()]
    shown = lines[np.abs(f[lines] - centre) <= _WIDE * 2.0 * zeta * centre]
    models = [c.fit for c in {id(c): c for c in (result.candidates[0], result.final)}.values()]
    figure = style.new_figure(10.1, 3.6)
    panels = figure.subplots(1, len(models), sharey=True, squeeze=False)[0]
    unit = display_unit(float(peak.max()), study.units[1])
    for axes, fit in zip(panels, models, strict=True):
        for i in levels:
            experiments = study.identification(i)
            modelled = response([replace(e, y=fit.predict(e)) for e in experiments])
            colour, last = style.CATEGORIES[i % len(style.CATEGORIES)], axes is panels[-1]
            label = f"{study.levels[i][0].amplitude:.3g} {study.units[0]}"
            sizes = [np.abs(g[shown, out, into]) / unit.scale for g in (measured[i], modelled)]
            axes.plot(f[shown], sizes[0], "o", color=colour, markersize=4.5, alpha=0.3, markeredgewidth=0.0)
            axes.plot(f[shown], sizes[1], color=colour, linewidth=1.3, label=label if last else None)
        axes.set_title(f"one model: {style.literal(_words(fit))}")
        axes.set_xlabel("frequency (Hz)")
        style.quiet_grid(axes)
    panels[0].set_ylabel(
        f"{style.literal(study.outputs[out])} by {style.literal(study.inputs[into])} ({unit.name}/{study.units[0]})"
    )
    panels[-1].legend()
    return figure


def draw_left(result: Result) -> Figure:
    """Spectra of what models leave of the recordings that are held out, or of the fitted ones where none are."""
    study = result.study
    figure = style.new_figure(10.1, 3.6)
    panels = figure.subplots(1, len(study.levels), squeeze=False)[0]
    for i, axes in enumerate(panels):
        experiments = study.held_out(i) or study.identification(i)
        power = _power(study, [e.y for e in experiments])
        unit = display_unit(float(np.sqrt(power[1].max())), study.units[1])
        _draw(axes, power, unit, style.MEASURED, "measured")
        _draw(axes, _left(study, result.candidates[0].fit, experiments), unit, style.BEFORE, "one linear model")
        if result.final is not result.candidates[0]:
            label = style.literal(f"one model, {_words(result.final.fit)}")
            _draw(axes, _left(study, result.final.fit, experiments), unit, style.AFTER, label)
        _draw(
            axes, _left(study, result.alone[i], experiments), unit, style.CATEGORIES[2], "linear, this amplitude alone"
        )
        noise = float(np.mean([e.spread**2 for e in experiments])) * len(study.outputs)
        width = 2.0 * np.diff(_edges(study)) * study.dt
        _draw(axes, (power[0], noise * width), unit, style.FAINT, "difference between periods, if white")
        axes.set_title(f"{study.levels[i][0].amplitude:.3g} {study.units[0]}")
        axes.set_xlabel("frequency (Hz)")
        axes.set_ylabel(f"effective value in a twelfth of an octave ({unit.name})")
        style.quiet_grid(axes)
    panels[-1].legend()
    return figure


def _words(fit: ModalFit) -> str:
    return " + ".join(words(n) for n in fit.model.element.names) or "linear"


def _left(study: Study, fit: ModalFit, experiments: tuple[Experiment, ...]) -> tuple[Array, Array]:
    """Draw the spectrum of a model's residual; nothing if the model cannot be integrated."""
    try:
        return _power(study, [e.y - fit.predict(e) for e in experiments])
    except SolverFailed:
        return np.ones(1), np.zeros(1)


def _edges(study: Study) -> Array:
    f = study.frequencies[study.lines]
    return f[0] * 2.0 ** np.linspace(0.0, np.log2(f[-1] / f[0]), max(2, int(_BANDS * np.log2(f[-1] / f[0]))))


def _power(study: Study, signals: list[Array]) -> tuple[Array, Array]:
    """Centre of each band and the mean square in it, all outputs together."""
    edges, n = _edges(study), len(signals[0])
    density = np.mean([2.0 * (np.abs(np.fft.rfft(x, axis=0)) ** 2).sum(axis=1) / n**2 for x in signals], axis=0)
    total, _ = np.histogram(study.frequencies, bins=edges, weights=density)
    return np.sqrt(edges[1:] * edges[:-1]), total


def _draw(axes: Axes, power: tuple[Array, Array], unit: Unit, colour: str, label: str) -> None:
    some = power[1] > 0.0
    axes.loglog(power[0][some], np.sqrt(power[1][some]) / unit.scale, color=colour, linewidth=1.2, label=label)


# What `phnn modes` writes into its folder.
RESULTS = ("modes.json", "report.html", "figures", "model", "models")
# Frequencies at two amplitudes belong to one mode if they differ by less than this.
_SAME = 0.03


def write_modes(result: Result, folder: str, place: Place) -> None:
    """Write document, figures and page into a folder."""
    (place / "modes.json").write_json(study_document(result))
    (place / "model" / FILE).write_json(model_document(result.final.fit, channels_of(result.study)))
    levels, apart = names_of(result.study.levels, result), names_of(result.study.apart, result)
    resonance = f"The resonance that moves most, at {', '.join(levels)}: measured (dots) and by one model (lines)."
    left = "Residuals of the models on held-out recordings, by frequency, all outputs together."
    drawings = [
        *drawing("resonance", resonance, resonance, partial(draw_resonance, result)),
        *drawing("left", left, left, partial(draw_left, result)),
    ]
    for one in drawings:
        (place / "figures" / one.file).write(one.png)
    headline, explanation = sentences(result)
    unit = display_unit(_largest(result), result.study.units[1])
    head = [c for level in levels for c in (f"left to choose by, {level}", f"held out, {level}")]
    head += [f"amplitude held out, {level}" for level in apart]
    models = [[name, *cells] for name, cells in rows(result, unit.scale)]
    moved = [c for level in levels for c in (f"Hz, {level} alone", "damping, %")]
    chosen = (
        "the recordings that were fitted, as there are no others" if result.fitted_choose else "recordings left out"
    )
    note = (
        f"Held out: root mean square error over all recorded periods, averaged over the outputs, in {unit.name}. "
        f"To choose by: what is left over what was measured, in per cent, of {chosen}."
    )
    absent = [*result.study.left_out.items(), *((n, "a step had no solution") for n in result.failed)]
    sections = [
        Section(None, [explanation, folder, *drawings[:1]]),
        Section(
            "One model for all amplitudes", [Table(["at the ports", *head], models), note, *drawings[1:]], open=True
        ),
        Section("Modes", [Table([*moved, "moved, %"], _modes(result), 0)]),
        *([Section("Left out", [f"{name}: {reason}" for name, reason in absent])] if absent else []),
    ]
    (place / "report.html").write(page(f"Modes: {folder}", headline, sections))


def show(result: Result, console: Console) -> None:
    """The headline and the table of models on a terminal."""
    headline, explanation = sentences(result)
    unit = display_unit(_largest(result), result.study.units[1])
    columns = [
        c
        for level in names_of(result.study.levels, result)
        for c in (f"left, {level} (%)", f"held out, {level} ({unit.name})")
    ]
    columns += [f"amplitude held out, {level} ({unit.name})" for level in names_of(result.study.apart, result)]
    table = Listing("at the ports", *columns)
    for name, cells in rows(result, unit.scale):
        table.add_row(name, *cells)
    console.print(table)
    for name, reason in result.study.left_out.items():
        console.print(escape(f"left out: {name}: {reason}"))
    console.print(escape(f"{headline}. {explanation}".strip()))


def names_of(levels: Sequence[Sequence[Experiment]], result: Result) -> list[str]:
    """Amplitudes with their unit."""
    return [f"{short(level[0].amplitude)} {result.study.units[0]}" for level in levels]


def sentences(result: Result) -> tuple[str, str]:
    """The headline and its explanation."""
    names = " or ".join(_names(m.element.names) for m in result.members)
    count = result.final.fit.model.omega.size
    modes = f"{count} mode{'s' if count > 1 else ''}"
    told = {
        NONE: (
            f"{modes}, and one linear model serves at every amplitude",
            "These recordings show no change with amplitude.",
        ),
        NAMED: (f"{modes}; {names} at the ports explains the change with amplitude", ""),
        EQUIVALENT: (
            f"{modes}; {names} at the ports explains the change with amplitude",
            "These recordings cannot tell which of them.",
        ),
        UNKNOWN: (
            f"{modes}; no element here explains the change with amplitude",
            "One linear model for all amplitudes has a larger residual than one for each, and no element at the "
            "ports removes half of the difference.",
        ),
    }
    headline, explanation = told[result.verdict]
    if len(result.study.levels) == 1:
        return f"{modes} at one amplitude", "Record at a second amplitude to see what changes with it."
    if result.verdict == UNKNOWN and result.members:
        explanation += f" The model has {names}, which improves predictions but proves no name."
    if result.verdict in (NAMED, EQUIVALENT):
        told_by = [f"{words(n).capitalize()}: {STATEMENTS[n]}." for n in result.final.element.names]
        explanation = " ".join([*told_by, explanation]).strip()
    return headline, explanation


def _names(names: Sequence[str]) -> str:
    return " and ".join(words(n) for n in names) or "linear"


def _largest(result: Result) -> float:
    known = [max(score.rmse) for c in result.candidates for score in result.held_out[c.fit].all if score]
    return max(known, default=1e-6)


def rows(result: Result, scale: float) -> list[tuple[str, list[str]]]:
    """Return name and cells of every model: errors at each amplitude, to choose by and held out."""

    def error(score: Score | None) -> str:
        return plain(float(np.mean(score.rmse)) / scale) if score else DASH

    def cells(left: Array, held: HeldOut) -> list[str]:
        pairs = [(plain(100.0 * float(x)), error(score)) for x, score in zip(left, held.levels, strict=True)]
        return [*(cell for pair in pairs for cell in pair), *(error(score) for score in held.apart)]

    # Each of these models knows one amplitude alone.
    scores = tuple(result.held_out[fit].levels[i] for i, fit in enumerate(result.alone))
    alone = cells(result.alone_by, HeldOut(scores, (None,) * len(result.study.apart)))
    found = [("linear, a model for each amplitude", alone)]
    return found + [(_names(c.element.names), cells(c.by_level, result.held_out[c.fit])) for c in result.candidates]


def _modes(result: Result) -> list[list[str]]:
    """Frequency and damping at each amplitude alone, mode beside mode, and how far each has moved at the highest."""
    models = [fit.model for fit in result.alone]
    first = models[0].omega
    pairs = []
    for m in models:
        away = np.abs(np.log(m.omega[None, :] / first[:, None]))
        # Pairs that are too far apart are worth nothing, so that they do not push others aside.
        mine, theirs = linear_sum_assignment(np.minimum(away, _SAME))
        pairs.append({int(i): int(j) for i, j in zip(mine, theirs, strict=True) if away[i, j] < _SAME})
    table = []
    for i in np.argsort(first):
        row = []
        for m, pair in zip(models, pairs, strict=True):
            j = pair.get(int(i))
            hz, ratio = (m.omega[j] / (2.0 * np.pi), 100.0 * m.zeta[j]) if j is not None else (None, None)
            row += [plain(hz, 4), plain(ratio)]
        last = pairs[-1].get(int(i)) if len(models) > 1 else None
        row.append(plain(100.0 * float(models[-1].omega[last] / first[i] - 1.0), 2) if last is not None else DASH)
        table.append(row)
    return table
