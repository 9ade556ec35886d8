"""One look for all figures: colours that the colour-blind can tell apart, units that suit, labels taken literally."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogFormatter

# Okabe & Ito's palette; before and after also differ in lightness, so that they survive a grey print
MEASURED = "#b4babf"
BEFORE = "#d55e00"
AFTER = "#00518f"
INK = "#23282d"
FAINT = "#c9ced3"
CATEGORIES = ("#0072b2", "#e69f00", "#009e73", "#56b4e9", "#cc79a7", "#7a5195", "#a6761d")

RC: dict[Any, Any] = {
    "font.family": "sans-serif", "font.sans-serif": ["DejaVu Sans"], "font.size": 9.0, "mathtext.fontset": "dejavusans",
    "axes.titlesize": 9.5, "axes.titleweight": "bold", "axes.titlelocation": "left", "axes.titlepad": 7.0,
    # Nothing stands between the panels and their titles; to make sure of it would measure every label of every axis.
    "axes.titley": 1.0,
    "axes.labelsize": 9.0, "axes.labelcolor": INK, "axes.edgecolor": "#8f969c", "axes.linewidth": 0.8,
    "axes.spines.top": False, "axes.spines.right": False, "axes.axisbelow": True,
    "text.color": INK, "xtick.color": "#4d555c", "ytick.color": "#4d555c",
    "xtick.labelsize": 8.5, "ytick.labelsize": 8.5,
    "legend.fontsize": 8.5, "legend.frameon": False, "legend.borderaxespad": 0.1, "legend.handlelength": 1.6,
    "grid.color": "#eceef0", "grid.linewidth": 0.8, "lines.solid_capstyle": "round", "hatch.linewidth": 0.6,
    "agg.path.chunksize": 20000,
    "figure.constrained_layout.use": True, "figure.constrained_layout.h_pad": 0.08,
    "figure.constrained_layout.w_pad": 0.06,
}  # fmt: skip
Corner = Literal["best", "upper left", "upper right"] | None
DPI = 150
# Of 9 at most: twice this takes half as long again, for files smaller by a tenth.
_EFFORT = 3
# Lines and their smoothed edges need no more colours; the files are a third as large.
_COLOURS, _PAPER = 256, 252


@dataclass(frozen=True)
class Drawing:
    """A finished figure.

    Attributes:
        file: name of the picture's file; title, alt: what it shows, in a few words and in a sentence.
        svg: the same picture as SVG, for a page that has dark colours too.
    """

    file: str
    title: str
    alt: str
    png: bytes
    svg: bytes = b""


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure in inches; call inside ``rc_context(RC)``."""
    return Figure(figsize=(width, height), layout="constrained")


def png(figure: Figure) -> bytes:
    """Return the figure as PNG of at most 256 colours; the same figure gives the same bytes."""
    from PIL import Image

    buffer = io.BytesIO()
    with rc_context(RC), _any_script():
        # `savefig` would draw everything twice to get the same bytes.
        figure.set_dpi(DPI)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    few = picture.quantize(_COLOURS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    # An octree's colours are means: the paper is not to be a shade of grey.
    palette = [255 if c >= _PAPER else c for c in few.getpalette() or []]
    few.putpalette(palette)
    few.save(buffer, "png", compress_level=_EFFORT, dpi=(DPI, DPI))
    return buffer.getvalue()


def svg(figure: Figure, salt: str = "phnn") -> bytes:
    """Return the figure as SVG with text as text; the same figure and salt give the same bytes."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    buffer, engine = io.BytesIO(), figure.get_layout_engine()
    with rc_context({**RC, "svg.fonttype": "none", "svg.hashsalt": salt}), _any_script():
        figure.set_dpi(72.0)
        canvas = FigureCanvasSVG(figure)
        if engine is not None:
            # The solver of the layout rounds as objects lie in memory, and the picture names its clips by every digit.
            engine.execute(figure)
            figure.set_layout_engine("none")
            for axes in figure.axes:
                axes.set_position(np.round(axes.get_position(original=True).bounds, 6))
        canvas.print_svg(buffer, metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


@contextmanager
def _any_script() -> Iterator[None]:
    """Draw names in scripts that the font lacks without a warning: the page spells them, the figure may show a box."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        yield


def literal(text: str, longest: int = 60) -> str:
    """Return a name that is never read as mathematics, shortened in the middle where it is long."""
    if len(text) > longest:
        half = (longest - 1) // 2
        text = f"{text[:half]}…{text[-half:]}"
    return text.replace("$", r"\$")


def log_axis(axes: Axes, which: str = "x") -> None:
    """Make an axis logarithmic, with plain numbers: ``0.1, 1, 10``, and 1.2, 1.4 within a decade."""
    axis = axes.xaxis if which == "x" else axes.yaxis
    axes.set(**{f"{which}scale": "log"})
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(LogFormatter(minor_thresholds=(1.0, 0.4)))


def quiet_grid(axes: Axes) -> None:
    """A faint grid behind the data."""
    axes.grid(True, which="major")


def finish(axes: Axes, x_label: str, y_label: str, legend: Corner = "best", room: float = 0.0, **style: Any) -> None:
    """Label axes and draw grid and legend.

    Args:
        legend: where it stands; None for no legend.
        room: for the legend above the data, as a share of their height.
        style: of the legend, such as ``ncols``.
    """
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + room * (high - low))
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    if legend is not None:
        axes.legend(loc=legend, **style)
    quiet_grid(axes)
