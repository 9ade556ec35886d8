"""The figures of a proof."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from phnn.report.figures.style import AFTER, BEFORE, FAINT, INK, RC, Drawing, new_figure, png, quiet_grid
from studies.proof.grades import WRONG
from studies.proof.outcome import Outcome
from studies.proof.settings import FULL
from studies.proof.tally import Detection, confusion, detection, limit, reliability

_LEVELS = np.array([0.003, 0.01, 0.03, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9, 1.0])


def draw_all(outcomes: Sequence[Outcome]) -> list[Drawing]:
    """Those figures for which there are cases."""
    with rc_context(RC):
        drawings = []
        curve = detection(outcomes)
        if curve is not None:
            drawings.append(_detection(curve))
        if any(o.group == "fast_none" for o in outcomes):
            drawings.append(_reliability(outcomes))
        for stratum, words in (("same", "in the form of the catalogue"), ("other", "in another form")):
            table = confusion(outcomes, stratum)
            if table:
                drawings.append(_confusion(table, f"confusion-{stratum}", f"Concealed {words}, and what was said"))
        moved = [o for o in outcomes if o.tier == FULL and o.stratum == "same" and np.isfinite(o.held_after)]
        if moved:
            drawings.append(_improvement(moved))
        return drawings


def drawing(name: str, title: str, figure: Figure) -> Drawing:
    """A figure with its title as the alternative text."""
    return Drawing(f"{name}.png", title, title, png(figure))


def _detection(curve: Detection) -> Drawing:
    figure = new_figure(7.2, 3.6)
    axes: Axes = figure.subplots()
    quiet_grid(axes)
    fine = np.geomspace(curve.delta.min(), curve.delta.max(), 200)
    axes.plot(fine, limit(fine), color=FAINT, lw=2.0, label="limit: effect's own direction")
    axes.plot(curve.delta, curve.found, "o-", color=AFTER, label="verdict is not none")
    axes.plot(curve.delta, curve.named, "s--", color=BEFORE, label="right name or class")
    axes.set(xscale="log", xlabel="noncentrality of the concealed effect", ylabel="share of cases", ylim=(-0.03, 1.03))
    axes.legend(loc="lower right")
    return drawing("detection", "Detection and naming against strength", figure)


def _reliability(outcomes: Sequence[Outcome]) -> Drawing:
    figure = new_figure(4.2, 3.8)
    axes: Axes = figure.subplots()
    quiet_grid(axes)
    axes.plot(_LEVELS, _LEVELS, color=FAINT, lw=2.0, label="calibrated")
    axes.plot(_LEVELS, reliability(outcomes, _LEVELS.tolist()), "o-", color=AFTER, label="nothing missing")
    axes.set(xscale="log", yscale="log", xlabel="stated p-value", ylabel="share of cases at or below")
    axes.legend(loc="lower right")
    return drawing("reliability", "Stated p-values where nothing is missing", figure)


def _confusion(table: Mapping[str, Counter[str]], name: str, title: str) -> Drawing:
    rows = list(table)
    said = {n for counts in table.values() for n in counts}
    columns = [n for n in rows if n in said] + sorted(said - set(rows))
    counts = np.array([[table[r][c] for c in columns] for r in rows], dtype=float)
    figure = new_figure(2.6 + 0.34 * len(columns), 1.9 + 0.27 * len(rows))
    axes: Axes = figure.subplots()
    shares = counts / counts.sum(axis=1, keepdims=True)
    axes.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.3, aspect="auto")
    for i, j in zip(*np.nonzero(counts), strict=True):
        axes.text(j, i, f"{counts[i, j]:.0f}", ha="center", va="center", color=INK, fontsize=8.0)
    axes.set_xticks(range(len(columns)), [c.replace("_", " ") for c in columns], rotation=55, ha="right")
    axes.set_yticks(range(len(rows)), [r.replace("_", " ") for r in rows])
    axes.set(xlabel="said", ylabel="concealed")
    return drawing(name, title, figure)


def _improvement(outcomes: Sequence[Outcome]) -> Drawing:
    figure = new_figure(7.2, 3.4)
    left, right = figure.subplots(1, 2)
    right_ones = [o for o in outcomes if o.grade != WRONG]
    pairs = (
        (left, "held_before", "held_after", "residual over noise, held out"),
        (right, "worst_before", "worst_after", "worst error of a group of parameters"),
    )
    for axes, before, after, label in pairs:
        quiet_grid(axes)
        for chosen, colour, mark in ((outcomes, FAINT, "x"), (right_ones, AFTER, "o")):
            x = np.array([getattr(o, before) for o in chosen])
            y = np.array([getattr(o, after) for o in chosen])
            axes.plot(x, y, mark, color=colour, ms=4.0, label="right" if chosen is right_ones else "all")
        axes.set(xscale="log", yscale="log", xlabel="before", ylabel="after", title=label)
        # Between the decades they would run into one another.
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_minor_formatter(NullFormatter())
    left.legend(loc="upper left")
    return drawing("improvement", "Before and after the diagnosis", figure)
