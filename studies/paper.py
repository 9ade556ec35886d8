"""The experiments of the paper's Sec. 3: recordings, refits, Table 3 and Figs. 10–15."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from phnn.diagnose.diagnosis import score_on_all
from phnn.identification.base import Progress, identify_base, identify_bouc_wen, quiet
from phnn.identification.evaluate import Evaluation, PartScore
from phnn.identification.fit import Fit, fit
from phnn.identification.identified import save_fit
from phnn.identification.plan import Options
from phnn.models.actuator import bouc_wen, from_paper
from phnn.recordings import read
from phnn.recordings.excitation import excitation_of
from phnn.recordings.recording import Campaign, Recording, unrecorded
from phnn.report.figures import envelope
from phnn.report.figures.style import AFTER, BEFORE, CATEGORIES, MEASURED, RC, Drawing, literal, new_figure, png
from phnn.report.figures.style import quiet_grid as grid
from phnn.report.formatting import markdown_table, number, percent, with_error
from phnn.results import claim
from phnn.setup import Setup
from phnn.trajectory import simulate
from studies.recordings import Conditions, Made, write_recordings
from studies.results import figure_lines, write_results

Array = NDArray[np.float64]

SCHEMA = "phnn.experiment/1"
REFITTED = ("phs", "bouc_wen")
RESULTS = ("figures", *REFITTED, "table3.csv", "experiment.json", "experiment.md", "recordings")
HEADS = {
    "phs": "PHS",
    "bouc_wen": "Bouc–Wen",
    "phs_published": "PHS, Table 1",
    "bouc_wen_published": "Bouc–Wen, Table 2",
}
TITLES = {"phs": "port-Hamiltonian", "bouc_wen": "Bouc–Wen"}
_PUBLISHED = {"phs": Setup(from_paper()), "bouc_wen": bouc_wen()}
_NEAR = 0.05  # relative distance at which a sine still counts as one of the table's
_CORNERS = np.array([0.0, 1.0, -0.4, 0.6, -1.0, 0.0])  # voltage over its peak, reached one after the other
_SAMPLES = 6000  # a whole number for each of five lines, and for each of three periods
_COLOURS = {"phs": AFTER, "bouc_wen": BEFORE}
_PANELS = ("Step", "1 Hz", "10 Hz", "100 Hz")  # of Figs. 10 and 11
_LOOPS = ("1 Hz", "10 Hz", "100 Hz", "150 Hz")  # of Fig. 12; a step has no loop
_PERIODS = 3.0
_SLOW, _FAST = 1.0, 0.03  # s, of the inputs of Fig. 15
_LOOPS_HZ = (1.0, 10.0, 50.0, 150.0)
_MICRO = 1e-6


@dataclass(frozen=True)
class Printed:
    """A line of Table 3: fit percentages and root mean square errors [m] of the two models."""

    phs_fit: float
    bouc_wen_fit: float
    phs_rmse: float
    bouc_wen_rmse: float

    def of(self, model: str) -> tuple[float, float]:
        """Return fit percentage and root mean square error [m] of ``"phs"`` or ``"bouc_wen"``."""
        return (self.phs_fit, self.phs_rmse) if model == "phs" else (self.bouc_wen_fit, self.bouc_wen_rmse)


TABLE_3 = {
    "1 Hz": Printed(97.11, 96.35, 2.3251e-6, 2.9358e-6),
    "10 Hz": Printed(97.23, 94.97, 2.2284e-6, 4.0418e-6),
    "25 Hz": Printed(97.41, 94.02, 2.0335e-6, 4.6937e-6),
    "50 Hz": Printed(96.59, 93.06, 2.6051e-6, 5.2988e-6),
    "75 Hz": Printed(96.69, 91.75, 2.4579e-6, 6.1254e-6),
    "100 Hz": Printed(96.99, 90.80, 2.2222e-6, 6.7942e-6),
    "150 Hz": Printed(96.98, 90.14, 2.1947e-6, 7.1673e-6),
    "Step": Printed(97.59, 97.07, 2.9342e-6, 3.5302e-6),
    "Chirp": Printed(95.36, 94.60, 3.6480e-6, 4.2410e-6),
}
_HERTZ = {float(name.split()[0]): name for name in TABLE_3 if name.endswith("Hz")}


def line_of(recording: Recording) -> str | None:
    """Return the line of Table 3 that a recording repeats; ``None`` where it has none.

    Kind and frequency of the input decide, not the amplitude: the paper's was 75 V throughout.
    """
    excitation = excitation_of(recording.u, recording.dt)
    near = [line for f, line in _HERTZ.items() if abs(excitation.frequency - f) <= _NEAR * f]
    return {"steps": "Step", "chirp": "Chirp", "sine": near[0] if near else None}.get(excitation.kind)


@dataclass(frozen=True)
class Passage:
    """A passage of a model: t (N,) time over the duration of the input, u (N,) input [V], y (N,) displacement [m]."""

    t: Array
    u: Array
    y: Array


def ramps(setup: Setup, peak: float, duration: float) -> Passage:
    """Simulate a model from rest under straight lines between fixed extreme values, in the time given.

    Args:
        setup: the model.
        peak: largest voltage, V.
        duration: of the five lines together, s.
    """
    t = np.linspace(0.0, 1.0, _SAMPLES + 1)
    u = peak * np.interp(t, np.linspace(0.0, 1.0, _CORNERS.size), _CORNERS)
    return Passage(t, u, simulate(setup, unrecorded("rate", t * duration, u, "linear"), substeps=2).y)


def loop(setup: Setup, peak: float, frequency: float) -> Passage:
    """Simulate three periods of a sine from rest and return the last one."""
    t = np.linspace(0.0, 3.0, _SAMPLES + 1)
    u, last = peak * np.sin(2.0 * np.pi * t), slice(2 * _SAMPLES // 3, None)
    y = simulate(setup, unrecorded("rate", t * (1.0 / frequency), u, "cubic"), substeps=2).y
    return Passage(t[last] - 2.0, u[last], y[last])


@dataclass(frozen=True)
class Scored:
    """A fit of the identification samples, with outputs and scores on all recordings.

    Of a published model only unknown initial states were estimated.
    """

    fit: Fit
    evaluation: Evaluation


@dataclass(frozen=True)
class Row:
    """One part of a recording, the line of the paper's Table 3 that it repeats, and the scores by model."""

    name: str
    use: str
    line: str | None
    scores: Mapping[str, PartScore]

    @property
    def printed(self) -> Printed | None:
        """The figures of the paper for it."""
        return TABLE_3[self.line] if self.line else None


@dataclass(frozen=True)
class Comparison:
    """Attributes:
    models: ``phs`` and ``bouc_wen``, and ``phs_published`` and ``bouc_wen_published`` where they were asked for.
    numerical_error: of the port-Hamiltonian fit over the identification samples, in standard deviations.
    """

    campaign: Campaign
    models: Mapping[str, Scored]
    numerical_error: float

    def rows(self) -> tuple[Row, ...]:
        """Return Table 3, in the order of the recordings."""
        lines = {part.name: line_of(r) for r in self.campaign.recordings for part in r.parts}
        parts = next(iter(self.models.values())).evaluation.parts
        return tuple(
            Row(p.name, p.use, lines[p.name], {n: m.evaluation.parts[i] for n, m in self.models.items()})
            for i, p in enumerate(parts)
        )


def compare(
    campaign: Campaign, options: Options | None = None, published: bool = True, progress: Progress = quiet
) -> Comparison:
    """Refit both models on the identification recordings by the flow of Fig. 9, and score them on all recordings.

    Nonlinear least squares begin from many starting points of hysterons with open dead zones, which do without the
    paper's linear electrical part (`phnn.identification.staged`); Bouc–Wen skips it in the paper too.

    Args:
        campaign: recordings with their uses; a weighed mass, where it has one, is held.
        options: how hard to try.
        published: score Tables 1 and 2 of the paper as well.
        progress: called with a line of text at every stage.

    Raises:
        InputRefused: the recordings cannot be used.
    """
    chosen = options or Options()
    actuator = {"model": "piezo_actuator", "hysterons": campaign.setup.get("hysterons", 2)}
    phs, error = identify_base(replace(campaign, setup=actuator), chosen, progress)
    fits = {"phs": phs, "bouc_wen": identify_bouc_wen(phs.plan, campaign, chosen, progress)}
    if published:
        progress("score the published parameters")
        fits["phs_published"] = fit(Setup(from_paper(), name="phs"), phs.plan, (), max_evaluations=15)
        fits["bouc_wen_published"] = fit(bouc_wen(), phs.plan, (), max_evaluations=15)
    models = {name: Scored(fitted, score_on_all(fitted, campaign)) for name, fitted in fits.items()}
    return Comparison(campaign, models, error.sigma)


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
    """Return all recordings with the refitted models."""
    return [
        Response(r, line_of(r) or r.name, {m: comparison.models[m].evaluation.outputs[r.name] for m in REFITTED})
        for r in comparison.campaign.recordings
    ]


def panels(found: Sequence[Response], wanted: Sequence[str], never: Sequence[str]) -> list[Response]:
    """Return those wanted where they were recorded, filled up with others to as many."""
    by_title = {r.title: r for r in reversed(found)}
    chosen = [by_title[t] for t in wanted if t in by_title]
    others = [r for r in found if not any(r is c for c in chosen) and r.title not in never]
    return chosen + others[: len(wanted) - len(chosen)]


def draw_all(comparison: Comparison) -> list[Drawing]:
    """Draw Figs. 10–15; 13 and 14 where a chirp was recorded, 10–12 where anything else was."""
    shown = responses(comparison)
    four, loops = panels(shown, _PANELS, ("Chirp",)), panels(shown, _LOOPS, ("Step", "Chirp"))
    peak = max(float(np.abs(r.recording.u).max()) for r in shown)
    with rc_context(RC):
        figures = []
        if four:
            figures.append(("fig10-responses", "Responses: measured and both models", _each(four, _time)))
            figures.append(("fig11-errors", "Errors: measured minus model", _each(four, _error)))
        if loops:
            figures.append(("fig12-hysteresis", "Hysteresis: displacement against voltage", _each(loops, _hysteresis)))
        for chirp in [r for r in shown if r.title == "Chirp"][:1]:
            figures.append(("fig13-chirp", "Response to the chirp", _chirp(chirp)))
            figures.append(("fig14-chirp-error", "Error under the chirp", _chirp_error(chirp)))
        rate = draw_rate(comparison.models["phs"].fit.setup, peak)
        figures.append(("fig15-rate", "Rate dependence of the port-Hamiltonian model", rate))
        return [Drawing(f"{stem}.png", title, title, png(figure)) for stem, title, figure in figures]


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
    _legend(figure, places.flat[0])
    return figure


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=len(labels))


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
    axes.set(xlabel=label, ylabel="displacement (µm)")
    axes.margins(x=0.01)


def _error(axes: Axes, response: Response) -> None:
    t, label = _clock(response.recording, response.shown)
    _errors(axes, t, response, response.shown)
    axes.set_xlabel(label)


def _errors(axes: Axes, t: Array, response: Response, part: slice) -> None:
    """The Bouc–Wen model first: its error is the larger one as a rule."""
    for name in reversed(REFITTED):
        error = (response.recording.y - response.outputs[name])[part]
        index = envelope(error)
        rms = np.sqrt(np.mean(error**2)) / _MICRO
        axes.plot(t[part][index], error[index] / _MICRO, color=_COLOURS[name], linewidth=0.9, label=TITLES[name])
        at, text = (0.99, 0.95 if name == "phs" else 0.86), f"{rms:.3g} µm r.m.s."
        axes.annotate(text, at, xycoords="axes fraction", ha="right", va="top", color=_COLOURS[name])
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.28 * (high - low))
    axes.set_ylabel("error (µm)")
    axes.margins(x=0.01)


def _hysteresis(axes: Axes, response: Response) -> None:
    _lines(axes, response.recording.u, response, response.shown)
    axes.set(xlabel="voltage (V)", ylabel="displacement (µm)")


def _clock(recording: Recording, part: slice) -> tuple[Array, str]:
    """Times in a unit that suits what is shown."""
    shown = recording.t[part]
    return (recording.t, "time (s)") if shown[-1] - shown[0] >= 0.3 else (1e3 * recording.t, "time (ms)")


def _chirp(response: Response) -> Figure:
    """The whole sweep, and its beginning and end close up."""
    figure = new_figure(9.6, 5.2)
    places = figure.subplot_mosaic([["whole", "whole"], ["first", "last"]])
    t = response.recording.t
    parts = {
        "whole": ("Chirp", slice(0, t.size)),
        "first": ("Its beginning", slice(0, t.size // 4)),
        "last": ("Its end", slice(t.size - t.size // 20, t.size)),
    }
    for name, (title, part) in parts.items():
        axes = places[name]
        _lines(axes, t, response, part, fine=name == "whole")
        axes.set(title=title, xlabel="time (s)", ylabel="displacement (µm)")
        axes.margins(x=0.01)
        grid(axes)
    _legend(figure, places["first"])
    return figure


def _chirp_error(response: Response) -> Figure:
    figure = new_figure(9.6, 3.0)
    axes = figure.subplots()
    _errors(axes, response.recording.t, response, slice(0, response.recording.t.size))
    axes.set(xlabel="time (s)", title="Chirp: measured − model")
    axes.legend(loc="upper left", ncols=2, borderaxespad=0.1)
    grid(axes)
    return figure


def draw_rate(setup: Setup, peak: float) -> Figure:
    """Draw Fig. 15: two passages of the same extreme values, up to ``peak`` [V], and loops at several frequencies."""
    figure = new_figure(9.6, 6.2)
    places = figure.subplots(2, 2)
    for duration, colour in ((_SLOW, AFTER), (_FAST, BEFORE)):
        moved = ramps(setup, peak, duration)
        label = f"{duration:g} s" if duration >= 1.0 else f"{1e3 * duration:g} ms"
        style, t, u, y = "-" if duration == _SLOW else (0, (5, 2)), moved.t, moved.u, moved.y / _MICRO
        for axes, x, shown in ((places[0, 0], t, u), (places[0, 1], t, y), (places[1, 0], u, y)):
            axes.plot(x, shown, color=colour, linestyle=style, linewidth=1.6, label=f"within {label}")
    for frequency, colour in zip(_LOOPS_HZ, CATEGORIES, strict=False):
        steady = loop(setup, peak, frequency)
        places[1, 1].plot(steady.u, steady.y / _MICRO, color=colour, linewidth=1.4, label=f"{frequency:g} Hz")
    titles = ("Same extreme values, two rates", "Response", "Response against voltage", "Steady loops under sines")
    for axes, title in zip(places.flat, titles, strict=True):
        label = "time over duration" if axes in places[0] else "voltage (V)"
        axes.set(title=title, xlabel=label, ylabel="displacement (µm)")
        grid(axes)
    places[0, 0].set_ylabel("voltage (V)")
    places[0, 0].legend(loc="lower left")
    places[1, 1].legend(loc="upper left")
    return figure


def heads(rows: Sequence[Row]) -> list[str]:
    """Return the column titles of Table 3; the paper's own columns where a recording repeats one of its lines."""
    models = [HEADS[m] for m in rows[0].scores]
    paper = [f"{HEADS[m]}, paper" for m in REFITTED] if any(r.printed for r in rows) else []
    return ["recording", "use", *models, *paper]


def cells(row: Row, columns: int) -> list[str]:
    """Return one line of Table 3: fit percentage and root mean square error in µm, model by model."""
    pairs = [(score.fit_percent, score.rmse) for score in row.scores.values()]
    if row.printed is not None:
        pairs += [row.printed.of(m) for m in REFITTED]
    use = {"identification": "identified", "confirmation": "held out"}.get(row.use, row.use)
    line = [row.name, use, *(f"{percent(fit_percent, 2)}  ({number(rmse * 1e6)})" for fit_percent, rmse in pairs)]
    return line + [""] * (columns - len(line))


def table_csv(rows: Sequence[Row]) -> str:
    """Return Table 3 with one line for each recording and model, SI."""
    columns = ["recording", "use", "paper_line", "model", "fit_percent", "rmse_m", "residual_over_noise"]
    lines = []
    for row in rows:
        for model, score in row.scores.items():
            paper = row.printed.of(model) if row.printed is not None and model in REFITTED else (None, None)
            scores = (score.fit_percent, score.rmse, score.residual_over_noise)
            lines.append((row.name, row.use, row.line, model, *scores, *paper))
    table = pd.DataFrame(lines, columns=[*columns, "paper_fit_percent", "paper_rmse_m"])
    return table.to_csv(index=False)


def parameters(comparison: Comparison) -> dict[str, dict[str, Any]]:
    """Return refitted parameters by model and name with errors, why they are held, and the published values; SI."""
    found = {}
    for model in REFITTED:
        fitted = comparison.models[model].fit
        std, published = fitted.std(), _PUBLISHED[model].values()
        found[model] = {
            n: {
                "value": p.value,
                "std": std.get(n),
                "interval_95": fitted.interval(n),
                "unit": p.unit,
                "held": fitted.held.get(n),
                "published": published.get(n),
            }
            for n, p in fitted.setup.parameters.items()
        }
    return found


def document(comparison: Comparison, made: Made | None, folder: str, seed: int, seconds: float) -> dict[str, Any]:
    """Return everything as a mapping for ``experiment.json``; numbers may be infinite."""
    names = ("fit_percent", "rmse", "residual_over_noise")
    return {
        "schema": SCHEMA,
        "folder": folder,
        "made": None if made is None else vars(made) | {"conditions": vars(made.conditions)},
        "table": {
            row.name: {
                "use": row.use,
                "paper_line": row.line,
                "paper": None if row.printed is None else vars(row.printed),
                "models": {m: {n: getattr(score, n) for n in names} for m, score in row.scores.items()},
            }
            for row in comparison.rows()
        },
        "parameters": parameters(comparison),
        "noise_floor": {r.name: r.noise for r in comparison.campaign.recordings},
        "numerical_error_sigma": comparison.numerical_error,
        "seed": seed,
        "seconds": seconds,
    }


def markdown(comparison: Comparison, made: Made | None, folder: str, drawings: Sequence[Drawing]) -> str:
    """Return the experiment for a person: what was recorded, Table 3, parameters, figures."""
    rows = comparison.rows()
    head = heads(rows)
    origin = "Recordings of the folder named above, both models refitted on its identification part."
    if made is not None:
        unknown = "" if made.conditions.effect == "none" else " The published parameters do not know of it."
        origin = made.words("75 V sines, a step and a chirp") + unknown
    over = {HEADS[m]: comparison.models[m].evaluation.over_noise("confirmation") for m in REFITTED}
    reached = ", ".join(f"{model} {number(noise)} × noise" for model, noise in over.items() if np.isfinite(noise))
    lines = [f"# Both models on {folder}", "", origin, "", "## Table 3", ""]
    lines += ["Fit in percent as MATLAB's `compare`, and the root mean square error in µm in brackets.", ""]
    lines += [*markdown_table(head, [cells(row, len(head)) for row in rows]), ""]
    lines += [f"Held-out recordings: {reached}." if reached else "Nothing was held out.", ""]
    for model, values in parameters(comparison).items():
        body = []
        for name, v in values.items():
            value = number(v["value"], 5) if v["std"] is None else with_error(v["value"], v["std"])
            body.append([name, f"{value} {v['unit']}", number(v["published"], 5), v["held"] or ""])
        table = markdown_table(["parameter", "refitted", "published", "note"], body)
        lines += [f"## Parameters: {HEADS[model]}", "", *table, ""]
    return "\n".join([*lines, *figure_lines(drawings)])


def run(
    recorded: Conditions | tuple[Path, Path | None], out: Path, options: Options, published: bool, progress: Progress
) -> None:
    """Run the experiment and write `RESULTS` into ``out``.

    Args:
        recorded: how the paper's recordings are made, in ``out/recordings``; or a folder and its manifest, if any.
        published: score the published parameters too; they are those of the paper's own actuator.

    Raises:
        InputRefused: the recordings or settings cannot be used, or ``out`` holds files of others.
        SolverFailed: the second effect cannot be made as strong as asked.
    """
    began, made = time.monotonic(), None
    campaign = None if isinstance(recorded, Conditions) else read(*recorded)
    with claim(out, "experiment", () if isinstance(recorded, Conditions) else recorded[:1], RESULTS) as place:
        if isinstance(recorded, Conditions):
            progress("make recordings")
            folder = (place / "recordings").own_folder()
            made = write_recordings(folder, recorded)
            campaign = read(folder)
        assert campaign is not None
        comparison, name = compare(campaign, options, published, progress), campaign.folder
        progress("draw")
        drawings = draw_all(comparison)
        for model in REFITTED:
            save_fit(comparison.models[model].fit, place / model)
        content = document(comparison, made, name, options.seed, time.monotonic() - began)
        page = markdown(comparison, made, name, drawings)
        texts = {"table3.csv": table_csv(comparison.rows()), "experiment.md": page}
        write_results(place, texts, {"experiment.json": content}, drawings)
