"""The energy balance of each recording as a bar: fractions of the supplied energy or of the largest flow."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from phnn.report.figures.style import CATEGORIES, INK, literal, new_figure, quiet_grid
from phnn.report.formatting import words
from phnn.report.shares import MISSING, SUPPLIED, Shares


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
