"""Every recording in one view: residual over noise, before and after."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from phnn.report.document import FitRow
from phnn.report.figures.style import AFTER, BEFORE, FAINT, literal, new_figure, quiet_grid


def _positions(rows: Sequence[FitRow]) -> list[float]:
    """A gap between the held-out recordings and the others."""
    gap = 0.7 if any(r.held_out for r in rows) and not all(r.held_out for r in rows) else 0.0
    return [i + (0.0 if row.held_out else gap) for i, row in enumerate(rows)]


def draw_overview(rows: Sequence[FitRow]) -> Figure:
    """Dots joined by a line for each recording, held-out recordings on top; 1 is the noise floor."""
    figure = new_figure(9.0, 1.0 + 0.29 * max(len(rows), 3))
    axes = figure.subplots()
    places = _positions(rows)
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
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    quiet_grid(axes, "both")
    subs = (1.0, 2.0, 5.0) if high / low < 300.0 else (1.0,)
    axes.xaxis.set_major_locator(LogLocator(base=10.0, subs=subs))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("residual over noise (logarithmic)")
    return figure
