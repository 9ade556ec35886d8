"""The figures of a report; each function takes values and returns a matplotlib figure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from phnn.report.document import FitRow
from phnn.report.evidence import Curve
from phnn.report.figures.locations import draw_locations
from phnn.report.figures.recording import draw_recording
from phnn.report.figures.style import (
    AFTER,
    BEFORE,
    CATEGORIES,
    FAINT,
    INK,
    RC,
    Drawing,
    label,
    literal,
    new_figure,
    png,
    quiet_grid,
    svg,
)
from phnn.report.formatting import words
from phnn.report.shares import MISSING, SUPPLIED, Shares
from phnn.report.support import Fingerprint


def _by_rows(items: list[Any], columns: int) -> list[Any]:
    """A legend fills its columns one after the other: reorder so that it reads along its rows."""
    return [item for column in range(columns) for item in items[column::columns]]


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
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    quiet_grid(axes, "x")
    supplied = all(row.base == SUPPLIED for row in rows)
    axes.set_xlabel(f"share of the {'energy supplied' if supplied else 'largest flow of energy'} (%)")
    handles = _by_rows(axes.get_legend_handles_labels()[0], 4)
    axes.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderaxespad=0.2)
    return figure


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


def _draw(axes: Axes, curve: Curve) -> None:
    order = np.argsort(curve.x, kind="stable")
    x, y = curve.x[order], curve.y[order]
    if curve.y_std is not None:
        spread = 2.0 * curve.y_std[order]
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


def draw_picture(curves: Sequence[Curve]) -> Figure:
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


__all__ = [
    "RC",
    "Drawing",
    "draw_fingerprint",
    "draw_ledger",
    "draw_locations",
    "draw_overview",
    "draw_picture",
    "draw_recording",
    "png",
    "svg",
]
