"""The share of the mismatch that each location explains: one bar for each, ties marked."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from phnn.report.document import Location
from phnn.report.figures.style import AFTER, FAINT, INK, literal, new_figure, quiet_grid
from phnn.report.formatting import words

_TIED = "#8fb8d8"


def draw_locations(location: Location) -> Figure:
    """Share of the explainable residual that each location predicts on recordings left out, best on top."""
    figure = new_figure(7.2, height_of(location))
    locations_into(figure.subplots(), location)
    return figure


def height_of(location: Location) -> float:
    """Height of the figure in inches."""
    return 0.95 + 0.3 * max(len(location.scores), 2)


def locations_into(axes: Axes, location: Location) -> None:
    """Draw the bars into axes."""
    values = [score or 0.0 for _, score in location.scores]
    for row, (name, score) in enumerate(location.scores):
        first, tied = name == location.name, name in location.tied
        colour = AFTER if first else _TIED if tied else FAINT
        hatch = "////" if tied and not first else None
        axes.barh(row, score or 0.0, height=0.66, color=colour, hatch=hatch, edgecolor=AFTER if hatch else colour)
        text = "not tried" if score is None else f"{score:.2f}".replace("-", "−")
        axes.annotate(
            text,
            (max(score or 0.0, 0.0), row),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            fontweight="bold" if first else "normal",
        )
    axes.set_yticks(range(len(values)), [literal(words(name)) for name, _ in location.scores])
    for tick, (name, _) in zip(axes.get_yticklabels(), location.scores, strict=True):
        tick.set_fontweight("bold" if name == location.name else "normal")
        tick.set_color(INK)
    axes.set_xlim(min(0.0, *values, 0.0), 1.08 * max(1.0, *values, 1.0))
    axes.set_ylim(len(values) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.axvline(0.0, color="#8f969c", linewidth=0.8)
    quiet_grid(axes, "x")
    label = "share of the explainable residual, predicted on recordings left out (1 = all of it)"
    best = dict(location.scores).get(location.name)
    if best is not None and max(values) > best:
        # The best one need not have the longest bar.
        label += "\na longer bar counts less where no other recording can confirm it, or where a refit has decided"
    axes.set_xlabel(label)
    if any(name in location.tied for name, _ in location.scores if name != location.name):
        handles = [
            Patch(facecolor=AFTER, label="best"),
            Patch(facecolor=_TIED, edgecolor=AFTER, hatch="////", label="tied with it"),
            Patch(facecolor=FAINT, label="explains less"),
        ]
        axes.legend(handles=handles, loc="lower right", frameon=True, framealpha=1.0, edgecolor="none")
