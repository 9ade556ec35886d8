"""The fingerprint of a named element in the data."""

from __future__ import annotations

from matplotlib.figure import Figure

from phnn.report.figures.style import AFTER, BEFORE, label, new_figure, quiet_grid
from phnn.report.support import Fingerprint


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
