"""All models side by side: fit, residual over noise, loops, loop areas and harmonics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from phnn.comparison.document import HEADS, Entry, Table
from phnn.comparison.result import Result
from phnn.comparison.uses import CONFIRMATION, IDENTIFICATION, OUTSIDE
from phnn.recordings.recording import Campaign, Recording
from phnn.report.figures.style import CATEGORIES, MEASURED, RC, Drawing, literal, log_axis, new_figure, png, quiet_grid
from phnn.report.reduction import envelope

Array = NDArray[np.float64]

_FURTHER = ("#d55e00", "#117733", "#882255", "#44aa99", "#999933", "#332288", "#aa4499", "#777777", "#bb9922")
_COLOURS = dict(zip(HEADS, (*CATEGORIES, *_FURTHER), strict=True))
_MARKS = dict(zip(HEADS, "DoX*sv^P<>phdH8.", strict=True))
_GROUPS = {OUTSIDE: "outside", CONFIRMATION: "inside", IDENTIFICATION: "identified"}
_PANELS = 4
_MICRO, _NANO = 1e-6, 1e-9
_GAP = 0.8


def draw_all(table: Table, campaign: Campaign, results: Sequence[Result]) -> list[Drawing]:
    """The figures; those of cycles where any recording repeats."""
    with rc_context(RC):
        fit = _dots(table, lambda e: 100.0 - e.fit_percent, "100 % − fit (logarithmic; to the left is better)")
        noise = _dots(table, lambda e: e.residual_over_noise, "residual over noise (logarithmic)", floor=1.0)
        drawings = [
            _drawing("fit", "What is left of a full fit, by recording and model", fit),
            _drawing("noise", "Residual over noise, by recording and model", noise),
        ]
        shown = _cyclic(table, campaign)
        if shown:
            area = _dots(
                table,
                lambda e: None if e.cycles is None else 100.0 * abs(e.cycles.area),
                "error of the loop area (%, logarithmic)",
                noise=lambda e: None if e.cycles is None else 100.0 * e.cycles.area_noise,
            )
            drawings += [
                _drawing("loop-area", "Error of the hysteresis loop's area, by recording and model", area),
                _drawing("loops", "Hysteresis loops: measured and all models", _loops(shown, results)),
                _drawing("loop-errors", "Errors over the last period", _loops(shown, results, errors=True)),
                _drawing("harmonics", "Errors of the harmonics of the displacement", _harmonics(table, shown)),
            ]
    return drawings


def _drawing(stem: str, title: str, figure: Figure) -> Drawing:
    return Drawing(f"{stem}.png", title, title, png(figure))


def _places(table: Table) -> dict[str, float]:
    """Height of every recording, those outside on top, a gap between the groups."""
    found, at, last = {}, 0.0, ""
    for use in _GROUPS:
        for name, own in table.uses.items():
            if own == use:
                at += _GAP if last and last != use else 0.0
                found[name], last = at, use
                at += 1.0
    return found


def _dots(
    table: Table,
    value: Callable[[Entry], float | None],
    label: str,
    floor: float | None = None,
    noise: Callable[[Entry], float | None] | None = None,
) -> Figure:
    """One dot a model and recording on a logarithmic axis; grey ticks where the noise alone would lie."""
    places = _places(table)
    figure = new_figure(9.2, 1.3 + 0.31 * (len(places) + _GAP * 2))
    axes = figure.subplots()
    for model, rows in table.entries.items():
        pairs = [(value(rows[n]), at) for n, at in places.items()]
        known = [(x, at) for x, at in pairs if x is not None and x > 0.0 and np.isfinite(x)]
        axes.scatter(
            [x for x, _ in known], [at for _, at in known], s=34, color=_COLOURS[model], marker=_MARKS[model],
            label=HEADS[model], zorder=3, alpha=0.9,
        )  # fmt: skip
    if noise is not None:
        first = next(iter(table.entries.values()))
        marks = [(noise(first[n]), at) for n, at in places.items()]
        axes.scatter(
            [x for x, _ in marks if x is not None], [at for x, at in marks if x is not None], s=90, color="#4d555c",
            marker="|", label="noise alone", zorder=2,
        )  # fmt: skip
    log_axis(axes)
    if floor is not None:
        axes.axvline(floor, color="#4d555c", linewidth=1.0, dashes=(3, 2), zorder=0, label="noise floor")
    words = [f"{literal(n, 34)}  ({_GROUPS[table.uses[n]]})" for n in places]
    axes.set_yticks(list(places.values()), words)
    axes.set_ylim(max(places.values()) + 0.6, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    quiet_grid(axes)
    axes.set_xlabel(label)
    figure.legend(loc="outside upper right", ncols=4)
    return figure


def _cyclic(table: Table, campaign: Campaign) -> list[tuple[str, Recording]]:
    """Up to four periodic recordings: outside first, the fastest and the smallest of them before others."""
    rows = next(iter(table.entries.values()))
    owner = {p.name: r for r in campaign.recordings for p in r.parts}
    order = [n for use in _GROUPS for n, own in table.uses.items() if own == use]
    found = [(n, owner[n]) for n in order if rows[n].cycles is not None]
    return found[:_PANELS]


def _loops(shown: Sequence[tuple[str, Recording]], results: Sequence[Result], errors: bool = False) -> Figure:
    """Displacement, or what a model is wrong by, against the voltage over the last period."""
    rows = -(-len(shown) // 2)
    figure = new_figure(9.6, 3.4 * rows + 0.3)
    places = figure.subplots(rows, min(2, len(shown)), squeeze=False)
    for axes, (name, r) in zip(places.flat, shown, strict=False):
        part = r.last_periods(1.0)
        curves = {x.name: x.evaluation.outputs[r.name] for x in results}
        if not errors:
            _curve(axes, r.u[part], r.y[part], "measured", MEASURED, 4.0)
        # The best last: on top of the others.
        for model, y in reversed(curves.items()):
            shift = r.y if errors else 0.0
            _curve(axes, r.u[part], (y - shift)[part], HEADS[model], _COLOURS[model], 1.2)
        axes.set_title(literal(name))
        axes.set_xlabel("voltage (V)")
        axes.set_ylabel("model − measured (µm)" if errors else "displacement (µm)")
        quiet_grid(axes)
    for axes in list(places.flat)[len(shown) :]:
        axes.set_visible(False)
    handles, labels = places.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=4)
    return figure


def _curve(axes: Axes, u: Array, y: Array, label: str, colour: str, width: float) -> None:
    index = envelope(y)
    axes.plot(u[index], y[index] / _MICRO, color=colour, label=label, linewidth=width)


def _harmonics(table: Table, shown: Sequence[tuple[str, Recording]]) -> Figure:
    """Error of the first five harmonics on a logarithmic axis, the noise as a grey line."""
    rows = -(-len(shown) // 2)
    figure = new_figure(9.6, 2.9 * rows + 0.3)
    places = figure.subplots(rows, min(2, len(shown)), squeeze=False)
    for axes, (name, _) in zip(places.flat, shown, strict=False):
        _harmonic_panel(axes, {m: rows_[name] for m, rows_ in table.entries.items()})
        axes.set_title(literal(name))
    for axes in list(places.flat)[len(shown) :]:
        axes.set_visible(False)
    handles, labels = places.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=4)
    return figure


def _harmonic_panel(axes: Axes, entries: Mapping[str, Entry]) -> None:
    width = min(0.12, 0.9 / len(entries))
    for i, (model, entry) in enumerate(entries.items()):
        if entry.cycles is None:
            continue
        at = np.arange(1, len(entry.cycles.harmonics) + 1) + (i - 0.5 * (len(entries) - 1)) * width
        values = np.array(entry.cycles.harmonics) / _NANO
        axes.plot(
            at, values, linestyle="", marker=_MARKS[model], markersize=5.0, color=_COLOURS[model], label=HEADS[model]
        )
        noise = entry.cycles.harmonic_noise / _NANO
    axes.axhline(noise, color="#4d555c", linewidth=1.0, dashes=(3, 2), label="noise alone", zorder=0)
    log_axis(axes, "y")
    axes.set_xlabel("harmonic")
    axes.set_ylabel("error (nm)")
    quiet_grid(axes)
