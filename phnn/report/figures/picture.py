"""The picture at the location: what the recordings taught."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from phnn.report.evidence import Curve
from phnn.report.figures.style import AFTER, label, new_figure, quiet_grid


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
