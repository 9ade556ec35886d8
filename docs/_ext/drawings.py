"""Sphinx extension: the flow chart and the table of "what did you record", drawn when the site is built."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from effect_pages import write_if_changed
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch
from sphinx.application import Sphinx

from phnn.check import QUESTIONS
from phnn.report.figures.style import AFTER, INK, RC
from phnn.signals.noise import LONG_REST

FOLDER = "drawn"
# What the words of the questions are filled with, where no recording says it.
_WORDS = {"input": "voltage", "rest": f"{LONG_REST} samples"}

# Each question of the chart: text, answer that leaves it sideways, and where that leads. The other answer goes down.
_STEPS = (
    (
        "Does phnn check\nread your folder?", "no",
        "The message names file, column and remedy;\nphnn template drafts a manifest.",
    ),
    (
        "Is the residual of the base model\nwithin the noise?", "yes",
        "none: these recordings show\nnothing that is missing.",
    ),
    (
        "Does an effect of the catalogue\nexplain the excess?", "no",
        "unknown: the location, a learned element or a\nformula, and the recording to make next.",
    ),
    (
        "More than one amplitude\nand one frequency?", "no",
        "unknown or equivalent: many effects\nlook alike on one sine.",
    ),
    (
        "Do held-out recordings bring a new\namplitude or frequency?", "no",
        "equivalent at most:\nnothing confirms the name.",
    ),
    (
        "Does exactly one effect predict\nthem better than chance?", "no",
        "equivalent: the class of effects,\nand what would separate them.",
    ),
)  # fmt: skip
_END = "named: the effect, its parameters\nwith intervals, a passive model."

_WIDTH, _HEIGHT, _GAP = 4.2, 0.86, 1.35


def chart() -> Figure:
    """The decisions from a folder of recordings to a verdict, from top to bottom."""
    figure = Figure((9.2, 1.02 * (len(_STEPS) + 1)))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set_xlim(-0.3, 10.4)
    axes.set_ylim(-_GAP * len(_STEPS) - 0.7, 0.7)
    for i, (question, answer, outcome) in enumerate(_STEPS):
        y, other = -_GAP * i, "yes" if answer == "no" else "no"
        _box(axes, 0.0, y, question, "#eef3f8", AFTER)
        _box(axes, 5.9, y, outcome, "#fbf3ec", "#d55e00")
        _arrow(axes, (_WIDTH, y), (5.9, y), answer, (5.05, y + 0.14))
        _arrow(
            axes,
            (_WIDTH / 2, y - _HEIGHT / 2),
            (_WIDTH / 2, y - _GAP + _HEIGHT / 2),
            other,
            (_WIDTH / 2 + 0.25, y - 0.69),
        )
    _box(axes, 0.0, -_GAP * len(_STEPS), _END, "#e6f4ee", "#009e73")
    return figure


def _box(axes: Axes, x: float, y: float, text: str, fill: str, edge: str) -> None:
    style = {"boxstyle": "round,pad=0.04", "facecolor": fill, "edgecolor": edge, "linewidth": 1.2}
    axes.add_patch(FancyBboxPatch((x, y - _HEIGHT / 2), _WIDTH, _HEIGHT, **style))
    axes.text(x + _WIDTH / 2, y, text, ha="center", va="center", fontsize=10, color=INK)


def _arrow(
    axes: Axes, start: tuple[float, float], end: tuple[float, float], word: str, at: tuple[float, float]
) -> None:
    axes.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": INK, "shrinkA": 2, "shrinkB": 2})
    axes.text(*at, word, ha="center", va="center", fontsize=9.5, color=INK, style="italic")


def table() -> str:
    """What recordings may show, and what to record for it, from the questions that ``phnn check`` asks."""
    rows = [f"| {record.format(**_WORDS)} | {shows} |" for shows, _, record in QUESTIONS]
    return "| what you recorded | what phnn can tell from it |\n|---|---|\n" + "\n".join(rows) + "\n"


def _draw(app: Sphinx) -> None:
    folder = Path(app.srcdir) / FOLDER
    folder.mkdir(exist_ok=True)
    with rc_context({**RC, "svg.hashsalt": "phnn", "figure.constrained_layout.use": False}):
        figure = chart()
        FigureCanvasSVG(figure)
        figure.savefig(folder / "flow.svg", metadata={"Date": None})
    write_if_changed(folder / "abilities.txt", table())


def setup(app: Sphinx) -> dict[str, Any]:
    """Draw before Sphinx looks for sources."""
    app.connect("builder-inited", _draw)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
