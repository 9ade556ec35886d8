"""Figs. 10–15: responses, errors, loops, the chirp, and rate dependence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from phnn.recordings.recording import Recording
from phnn.report.figures.style import AFTER, BEFORE, CATEGORIES, MEASURED, RC, Drawing, literal, new_figure, png
from phnn.report.figures.style import quiet_grid as grid
from phnn.report.reduction import envelope
from phnn.setup import Setup
from studies.paper.published import line_of
from studies.paper.rate import loop, ramps
from studies.paper.table import REFITTED, Comparison

Array = NDArray[np.float64]

TITLES = {"phs": "port-Hamiltonian", "bouc_wen": "Bouc–Wen"}
_COLOURS = {"phs": AFTER, "bouc_wen": BEFORE}
_PANELS = ("Step", "1 Hz", "10 Hz", "100 Hz")  # of Figs. 10 and 11
_LOOPS = ("1 Hz", "10 Hz", "100 Hz", "150 Hz")  # of Fig. 12; a step has no loop
_PERIODS = 3.0
_SLOW, _FAST = 1.0, 0.03  # s, of the inputs of Fig. 15
_LOOPS_HZ = (1.0, 10.0, 50.0, 150.0)
_MICRO = 1e-6


@dataclass(frozen=True)
class Response:
    """A recording and the outputs (N,) of the models, m, by model."""

    recording: Recording
    title: str
    outputs: Mapping[str, Array]

    @property
    def shown(self) -> slice:
        """The last periods of what repeats, all of what does not."""
        return self.recording.last_periods(_PERIODS)


def responses(comparison: Comparison) -> list[Response]:
    """All recordings with the refitted models."""
    return [
        Response(r, line_of(r) or r.name, {m: comparison.models[m].evaluation.outputs[r.name] for m in REFITTED})
        for r in comparison.campaign.recordings
    ]


def panels(found: Sequence[Response], wanted: Sequence[str], never: Sequence[str]) -> list[Response]:
    """Those wanted where they were recorded, filled up with others to as many."""
    by_title = {r.title: r for r in reversed(found)}
    chosen = [by_title[t] for t in wanted if t in by_title]
    others = [r for r in found if not any(r is c for c in chosen) and r.title not in never]
    return chosen + others[: len(wanted) - len(chosen)]


def draw_all(comparison: Comparison) -> list[Drawing]:
    """Figs. 10–15; 13 and 14 where a chirp was recorded, 10–12 where anything else was."""
    found = responses(comparison)
    four, loops = panels(found, _PANELS, ("Chirp",)), panels(found, _LOOPS, ("Step", "Chirp"))
    chirps = [r for r in found if r.title == "Chirp"][:1]
    drawings = []
    with rc_context(RC):
        if four:
            drawings += [
                _drawing("fig10-responses", "Responses: measured and both models", _each(four, _time)),
                _drawing("fig11-errors", "Errors: measured minus model", _each(four, _error)),
            ]
        if loops:
            title = "Hysteresis: displacement against voltage"
            drawings.append(_drawing("fig12-hysteresis", title, _each(loops, _hysteresis)))
        for chirp in chirps:
            drawings += [
                _drawing("fig13-chirp", "Response to the chirp", _chirp(chirp)),
                _drawing("fig14-chirp-error", "Error under the chirp", _chirp_error(chirp)),
            ]
        peak = max(float(np.abs(r.recording.u).max()) for r in found)
        rate = draw_rate(comparison.models["phs"].fit.setup, peak)
        drawings.append(_drawing("fig15-rate", "Rate dependence of the port-Hamiltonian model", rate))
    return drawings


def _drawing(stem: str, title: str, figure: Figure) -> Drawing:
    return Drawing(f"{stem}.png", title, title, png(figure))


def _each(found: Sequence[Response], draw: Callable[[Axes, Response], None]) -> Figure:
    """One panel for each recording, two in a row, one legend."""
    rows = -(-len(found) // 2)
    figure = new_figure(9.6, 2.9 * rows)
    places = figure.subplots(rows, min(2, len(found)), squeeze=False)
    for axes, response in zip(places.flat, found, strict=False):
        draw(axes, response)
        axes.set_title(literal(response.title))
        grid(axes)
    for axes in list(places.flat)[len(found) :]:
        axes.set_visible(False)
    handles, labels = places.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=len(labels))
    return figure


def _lines(axes: Axes, x: Array, response: Response, part: slice, fine: bool = False) -> None:
    """Measured, and both models on top of it; fine lines where there are many cycles."""
    for name, y in {"measured": response.recording.y, **response.outputs}.items():
        index = envelope(y[part])
        axes.plot(
            x[part][index],
            y[part][index] / _MICRO,
            color=_COLOURS.get(name, MEASURED),
            label=TITLES.get(name, name),
            linewidth=(3.5 if name == "measured" else 1.2) * (0.35 if fine else 1.0),
            linestyle=(0, (4, 2)) if name == "bouc_wen" and not fine else "-",
        )


def _time(axes: Axes, response: Response) -> None:
    t, label = _clock(response.recording, response.shown)
    _lines(axes, t, response, response.shown)
    axes.set_xlabel(label)
    axes.set_ylabel("displacement (µm)")
    axes.margins(x=0.01)


def _error(axes: Axes, response: Response) -> None:
    part = response.shown
    t, label = _clock(response.recording, part)
    _errors(axes, t, response, part)
    axes.set_xlabel(label)


def _errors(axes: Axes, t: Array, response: Response, part: slice) -> None:
    """The Bouc–Wen model first: its error is the larger one as a rule."""
    for name in reversed(REFITTED):
        error = (response.recording.y - response.outputs[name])[part]
        index = envelope(error)
        rms = np.sqrt(np.mean(error**2)) / _MICRO
        label = TITLES[name]
        axes.plot(t[part][index], error[index] / _MICRO, color=_COLOURS[name], linewidth=0.9, label=label)
        place = 0.95 if name == "phs" else 0.86
        text = f"{rms:.3g} µm r.m.s."
        axes.annotate(text, (0.99, place), xycoords="axes fraction", ha="right", va="top", color=_COLOURS[name])
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.28 * (high - low))
    axes.set_ylabel("error (µm)")
    axes.margins(x=0.01)


def _hysteresis(axes: Axes, response: Response) -> None:
    _lines(axes, response.recording.u, response, response.shown)
    axes.set_xlabel("voltage (V)")
    axes.set_ylabel("displacement (µm)")


def _clock(recording: Recording, part: slice) -> tuple[Array, str]:
    """Times in a unit that suits what is shown."""
    shown = recording.t[part]
    return (recording.t, "time (s)") if shown[-1] - shown[0] >= 0.3 else (1e3 * recording.t, "time (ms)")


def _chirp(response: Response) -> Figure:
    """The whole sweep, and its beginning and end close up."""
    figure = new_figure(9.6, 5.2)
    places = figure.subplot_mosaic([["whole", "whole"], ["first", "last"]])
    t = response.recording.t
    parts = {"whole": slice(0, t.size), "first": slice(0, t.size // 4), "last": slice(t.size - t.size // 20, t.size)}
    titles = {"whole": "Chirp", "first": "Its beginning", "last": "Its end"}
    for name, part in parts.items():
        axes = places[name]
        _lines(axes, t, response, part, fine=name == "whole")
        axes.set_title(titles[name])
        axes.set_xlabel("time (s)")
        axes.set_ylabel("displacement (µm)")
        axes.margins(x=0.01)
        grid(axes)
    handles, labels = places["first"].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=len(labels))
    return figure


def _chirp_error(response: Response) -> Figure:
    figure = new_figure(9.6, 3.0)
    axes = figure.subplots()
    _errors(axes, response.recording.t, response, slice(0, response.recording.t.size))
    axes.set_xlabel("time (s)")
    axes.set_title("Chirp: measured − model")
    axes.legend(loc="upper left", ncols=2, borderaxespad=0.1)
    grid(axes)
    return figure


def draw_rate(setup: Setup, peak: float) -> Figure:
    """Fig. 15: a slow and a fast passage of the same extreme values, and steady loops at several frequencies.

    Args:
        setup: the model.
        peak: largest voltage, V.
    """
    figure = new_figure(9.6, 6.2)
    places = figure.subplots(2, 2)
    for duration, colour in ((_SLOW, AFTER), (_FAST, BEFORE)):
        found = ramps(setup, peak, duration)
        label = f"{duration:g} s" if duration >= 1.0 else f"{1e3 * duration:g} ms"
        style = "-" if duration == _SLOW else (0, (5, 2))
        for axes, x, y in (
            (places[0, 0], found.t, found.u),
            (places[0, 1], found.t, found.y / _MICRO),
            (places[1, 0], found.u, found.y / _MICRO),
        ):
            axes.plot(x, y, color=colour, linestyle=style, linewidth=1.6, label=f"within {label}")
    for frequency, colour in zip(_LOOPS_HZ, CATEGORIES, strict=False):
        steady = loop(setup, peak, frequency)
        places[1, 1].plot(steady.u, steady.y / _MICRO, color=colour, linewidth=1.4, label=f"{frequency:g} Hz")
    titles = ("Same extreme values, two rates", "Response", "Response against voltage", "Steady loops under sines")
    for axes, title in zip(places.flat, titles, strict=True):
        axes.set_title(title)
        axes.set_ylabel("displacement (µm)")
        grid(axes)
    places[0, 0].set_ylabel("voltage (V)")
    for axes in places[0]:
        axes.set_xlabel("time over duration")
    for axes in places[1]:
        axes.set_xlabel("voltage (V)")
    places[0, 0].legend(loc="lower left")
    places[1, 1].legend(loc="upper left")
    return figure
