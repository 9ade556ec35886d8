"""LaTeX to inline SVG with matplotlib's mathtext: no browser script, no font file, no LaTeX installation."""

from __future__ import annotations

import re
from html.entities import html5

import numpy as np
from markupsafe import Markup, escape
from matplotlib.font_manager import FontProperties
from matplotlib.path import Path
from matplotlib.textpath import TextPath

_SIZE = 20.0  # points, the size in which glyphs are laid out
_WRAPPERS = (("$$", "$$"), (r"\[", r"\]"), (r"\(", r"\)"), ("$", "$"))
_COMMANDS = {
    int(Path.MOVETO): "M",
    int(Path.LINETO): "L",
    int(Path.CURVE3): "Q",
    int(Path.CURVE4): "C",
    int(Path.CLOSEPOLY): "Z",
}
# mathtext lacks these; the right-hand sides mean the same
_SUBSTITUTES = (
    (re.compile(r"\\begin\{[a-z]+\*?\}|\\end\{[a-z]+\*?\}"), ""),
    (re.compile(r"\\tfrac\b"), r"\\frac"),
    (re.compile(r"\\[lr]vert\b"), "|"),
    (re.compile(r"\\[lr]Vert\b"), r"\\Vert "),
    (re.compile(r"\\(?:displaystyle|textstyle|nonumber)\b"), ""),
    (re.compile(r"\\(?:bigl|bigr|Bigl|Bigr|big|Big)\b"), ""),
    (re.compile(r"\\!"), ""),
    (re.compile(r"\\(le|ge|ne)(?![A-Za-z])"), r"\\\g<1>q"),
    (re.compile(r"(?<!\\)&"), ""),
)


def _lines(latex: str) -> list[str]:
    """The formula without its delimiters, split at ``\\\\``."""
    text = latex.strip()
    for start, end in _WRAPPERS:
        if len(text) > len(start) + len(end) and text.startswith(start) and text.endswith(end):
            text = text[len(start) : -len(end)]
            break
    for pattern, replacement in _SUBSTITUTES:
        text = pattern.sub(replacement, text)
    text = text.replace("\n", " ")
    return [line.strip() for line in re.split(r"\\\\(?:\[[^\]]*\])?", text) if line.strip()]


def _display_fractions(line: str) -> str:
    """Fractions at full size where they stand on the line, not inside braces."""
    depth, pieces = 0, []
    for piece in re.split(r"(\\frac\b|\\.|[{}])", line):
        depth += {"{": 1, "}": -1}.get(piece, 0)
        pieces.append(r"\dfrac" if piece == r"\frac" and depth == 0 else piece)
    return "".join(pieces)


def _outline(path: Path) -> str:
    """The path as SVG drawing commands, y downwards."""
    pieces = []
    for vertices, code in path.iter_segments(curves=True, simplify=False):
        points = np.asarray(vertices).reshape(-1, 2)
        if code == Path.CLOSEPOLY:
            pieces.append("Z")
        else:
            pieces.append(_COMMANDS[int(code)] + " ".join(f"{x:.2f} {-y:.2f}" for x, y in points))
    return "".join(pieces)


def _svg(line: str) -> Markup:
    if "$" in line:
        raise ValueError("a dollar sign inside a formula")
    path = TextPath(
        (0.0, 0.0), f"${_display_fractions(line)}$", size=_SIZE, prop=FontProperties(math_fontfamily="stix")
    )
    if not len(path.vertices):
        raise ValueError("nothing to draw")
    box = path.get_extents()
    margin = 0.05 * _SIZE
    left, top = box.x0 - margin, -box.y1 - margin
    width, height = box.width + 2.0 * margin, box.height + 2.0 * margin
    return Markup(
        '<svg class="formula" role="img" aria-label="{label}" viewBox="{x:.2f} {y:.2f} {w:.2f} {h:.2f}" '
        'style="width:{we:.3f}em;height:{he:.3f}em"><path fill="currentColor" d="{d}"/></svg>'
    ).format(
        label=line,
        x=left,
        y=top,
        w=width,
        h=height,
        we=width / _SIZE,
        he=height / _SIZE,
        d=_outline(path),
    )


def symbol(name: str) -> Markup:
    """A parameter's name as it is printed: ``rho_1`` → ρ with a subscript; long names as code."""
    base, _, index = name.partition("_")
    letter = html5.get(f"{'epsilon' if base == 'eps' else base};", "")
    letter = letter if "α" <= letter <= "ω" else base
    if len(letter) <= 2:
        sub = Markup("<sub>{}</sub>").format(index) if index else ""
        return Markup("<i>{}</i>{}").format(letter, sub)
    return Markup("<code>{}</code>").format(name)


def formula(latex: str) -> Markup:
    """A LaTeX formula as inline SVG, one drawing for each line; the text itself where mathtext cannot parse it."""
    lines = _lines(latex)
    if not lines:
        return Markup("")
    try:
        return Markup("\n").join(Markup('<div class="equation">{}</div>').format(_svg(line)) for line in lines)
    except (ValueError, RuntimeError):
        return Markup('<div class="equation"><code>{}</code></div>').format(escape(latex.strip()))
