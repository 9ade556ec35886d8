"""One offline page from a list of sections: everything is inlined, nothing is fetched, and no script runs.

A section has a title and blocks. A block is a text, a formula, a table, bars, code or a picture. The template escapes
every text.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from matplotlib.font_manager import FontProperties
from matplotlib.path import Path
from matplotlib.textpath import TextPath

from phnn.report.figures.style import Drawing

# A spreadsheet takes a text that begins so for a formula.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def literal_text(text: str) -> str:
    """Return a text that no spreadsheet runs as a formula: one that looks like it begins with an apostrophe."""
    return f"'{text}" if text.startswith(_FORMULA) else text


@dataclass(frozen=True)
class Table:
    """Attributes:
    head: names of the columns; rows: cells as they are shown.
    words: number of columns from the left that hold words; all others hold numbers and are aligned to the right.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1


@dataclass(frozen=True)
class Bar:
    """A row of bars: its share of the longest possible bar, from 0 to 1, its label, and a remark; the first is bold."""

    name: str
    share: float
    label: str
    remark: str = ""


@dataclass(frozen=True)
class Bars:
    """Bars under a title, the most important one first."""

    title: str
    rows: Sequence[Bar]


@dataclass(frozen=True)
class Formula:
    """An equation in LaTeX."""

    latex: str


@dataclass(frozen=True)
class Code:
    """Text that is copied: code, a command or hashes."""

    text: str


@dataclass(frozen=True)
class Link:
    """A file beside the page, with a sentence before its name."""

    text: str
    file: str


Block = str | Table | Bars | Formula | Code | Link | Drawing


@dataclass(frozen=True)
class Section:
    """A section that folds under its title; None stands for the first screen, which does not fold."""

    title: str | None
    blocks: Sequence[Block]
    open: bool = False


def page(title: str, heading: str, sections: Sequence[Section], badge: str = "") -> bytes:
    """Return a page: a heading, and the sections below it.

    Args:
        title: of the window; badge: a word above the heading.
    """
    filled = _template().render(
        title=title, heading=heading, sections=sections, badge=badge, style=Markup(content("report.css"))
    )
    return filled.encode("utf-8")


def content(name: str) -> str:
    """Return a file of the package `phnn.report`."""
    return files("phnn.report").joinpath(name).read_text("utf-8")


@cache
def _template():  # type: ignore[no-untyped-def]
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters.update(formula=formula, image=image, kind=lambda block: type(block).__name__)
    return environment.from_string(content("page.html"))


# Colours of the figures, and what the page calls them: it has others in the dark.
_COLOURS = {
    "#23282d": "ink", "#4d555c": "soft", "#8f969c": "rule", "#eceef0": "line", "#ffffff": "paper", "#d55e00": "before",
    "#00518f": "after", "#b4babf": "measured", "#c9ced3": "faint", "#6a7278": "soft",
}  # fmt: skip


def image(drawing: Drawing) -> Markup:
    """Return a picture as part of the page: as SVG in the colours of the page, or as PNG where there is no SVG."""
    if not drawing.svg:
        data = base64.b64encode(drawing.png).decode("ascii")
        return Markup('<img src="data:image/png;base64,{}" alt="{}">').format(data, drawing.alt)
    text = drawing.svg.decode("utf-8")
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    # Names that nothing refers to would stand twice on a page of several pictures.
    text = re.sub(r'(<g|<svg[^>]*?) id="[^"]*"', r"\1", text)
    text = re.sub(r' (?:width|height)="[\d.]+pt"', "", text, count=2)
    for colour, name in _COLOURS.items():
        text = text.replace(colour, f"var(--{name})")
    return Markup(text.replace("<svg ", Markup('<svg role="img" aria-label="{}" ').format(drawing.alt), 1))


_SIZE = 20.0  # points, the size in which glyphs are laid out
_FRACTION = re.compile(r"\\frac\b")  # is drawn at full size
_COMMANDS = {Path.MOVETO: "M", Path.LINETO: "L", Path.CURVE3: "Q", Path.CURVE4: "C", Path.CLOSEPOLY: "Z"}


def _outline(path: Path) -> str:
    """Return the path as SVG drawing commands, y downwards."""
    pieces = []
    for vertices, code in path.iter_segments(curves=True, simplify=False):
        points = () if code == Path.CLOSEPOLY else np.asarray(vertices).reshape(-1, 2)
        pieces.append(_COMMANDS[code] + " ".join(f"{x:.2f} {-y:.2f}" for x, y in points))
    return "".join(pieces)


def formula(latex: str) -> Markup:
    """Return an equation as inline SVG; its LaTeX where mathtext cannot parse it."""
    try:
        if "$" in latex:
            raise ValueError("a dollar sign inside a formula")
        font = FontProperties(math_fontfamily="stix")
        shown = _FRACTION.sub(r"\\dfrac", latex)
        path = TextPath((0.0, 0.0), f"${shown}$", size=_SIZE, prop=font)
    except (ValueError, RuntimeError):
        return Markup('<div class="equation"><code>{}</code></div>').format(latex)
    box, margin = path.get_extents(), 0.05 * _SIZE
    x, y = box.x0 - margin, -box.y1 - margin
    width, height = box.width + 2.0 * margin, box.height + 2.0 * margin
    return Markup(
        '<div class="equation"><svg class="formula" role="img" aria-label="{}" viewBox="{:.2f} {:.2f} {:.2f} {:.2f}" '
        'style="width:{:.3f}em;height:{:.3f}em"><path fill="currentColor" d="{}"/></svg></div>'
    ).format(latex, x, y, width, height, width / _SIZE, height / _SIZE, _outline(path))
