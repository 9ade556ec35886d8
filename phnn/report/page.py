"""One offline page from a finished diagnosis: everything inlined, nothing fetched, only scripts of its own run."""

from __future__ import annotations

import base64
import csv
import hashlib
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from html.entities import html5
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np
from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup, escape
from matplotlib.font_manager import FontProperties
from matplotlib.path import Path
from matplotlib.textpath import TextPath

from phnn.report import formatting, verdicts
from phnn.report.document import Document, FitRow
from phnn.report.evidence import CandidateRow, Evidence, Shares, Trace, base_note
from phnn.report.formatting import display_unit, finite
from phnn.report.gallery import Gallery

if TYPE_CHECKING:
    from phnn.report.figures.style import Drawing

Cell = str | float | bool | None
# A spreadsheet takes a text that begins so for a formula.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def csv_text(head: Sequence[str], rows: Iterable[Sequence[Cell]]) -> str:
    """A table as csv. Names of strangers that a spreadsheet would run begin with an apostrophe; None is empty."""
    buffer = io.StringIO()
    writer = csv.writer(buffer)
    writer.writerow([_cell(h) for h in head])
    writer.writerows([_cell(c) for c in row] for row in rows)
    return buffer.getvalue()


def literal_text(text: str) -> str:
    """A text that no spreadsheet runs as a formula: one that looks like it begins with an apostrophe."""
    return f"'{text}" if text.startswith(_FORMULA) else text


def _cell(value: Cell) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return literal_text(value)
    number = finite(value)
    return "" if number is None else repr(number)


def table_links(document: Document, evidence: Evidence, shares: Sequence[Shares]) -> Mapping[str, str]:
    """A link for each table that has rows, by its name."""
    fit = [
        [r.name, r.held_out, *(v for s in (r.before, r.after) for v in (s.fit_percent, s.rmse, s.residual_over_noise))]
        for r in document.fits
    ]
    scores = ("fit (%)", f"RMSE ({document.output_unit})", "residual over noise")
    kinds = shares[0].kinds if shares else ()
    tables: dict[str, tuple[Sequence[str], Sequence[Sequence[Cell]]]] = {
        "fit": (["recording", "held out", *(f"{which}: {x}" for which in ("before", "after") for x in scores)], fit),
        "parameters": (
            ["parameter", "meaning", "unit", "before", "after", "standard error", "95 % from", "95 % to", "remark"],
            [
                [r.name, r.description, r.unit, r.before, r.after, r.std, *(r.interval_95 or (None, None)), r.note]
                for r in evidence.parameters
            ],
        ),
        "energy": (
            ["recording", "share of", *kinds],
            [[r.recording, r.base, *(r.parts[k] for k in kinds)] for r in shares],
        ),
        "models": (
            ["model", "chi2/N fitted", "chi2/N held out", "parameters", "probability", "converged", "final model"],
            [
                [r.elements, r.left, r.left_held_out, r.parameters, r.probability, r.converged, r.chosen]
                for r in evidence.models
            ],
        ),
        "tried": (
            ["effect", "location", "score", "predicted fall of chi2/N", "outcome"],
            [[r.effect, r.location, r.score, r.fall, r.outcome] for r in evidence.candidates],
        ),
        "rules": (
            ["rule", "numbers", "applies", "outcome"],
            [
                [r.rule, "; ".join(f"{n} {v}" for n, v in r.numbers.items()), r.applies, r.outcome]
                for r in evidence.rules
            ],
        ),
        "noise": (["recording", f"noise floor ({document.output_unit})"], document.noise_floor),
    }
    # The mark at the beginning tells a spreadsheet that the text is UTF-8.
    texts = {name: csv_text(head, rows).encode("utf-8-sig") for name, (head, rows) in tables.items() if rows}
    return {n: f"data:text/csv;charset=utf-8;base64,{base64.b64encode(x).decode('ascii')}" for n, x in texts.items()}


# What the example simulates where no recording says anything.
_PERIODS, _SAMPLES = 3.0, 2000


def content(name: str) -> str:
    """A file of the package `phnn.report`."""
    return files("phnn.report").joinpath(name).read_text("utf-8")


@dataclass(frozen=True)
class Scripts:
    """Attributes:
    texts: the content of every ``script`` element that a browser may run.
    style: the content of the ``style`` element.
    policy: Content-Security-Policy that allows these scripts by their hashes, pictures within the page, and nothing
        from anywhere.
    """

    texts: tuple[Markup, ...]
    style: Markup
    policy: str


@cache
def scripts() -> Scripts:
    """Scripts, style and policy of a report; the plotting library stands unchanged below its licence."""
    library = f"/*\n{content('vendor/uplot/LICENSE')}*/\n{content('vendor/uplot/uPlot.iife.min.js')}"
    texts = (library, content("live.js"))
    style = content("vendor/uplot/uPlot.min.css") + "\n" + content("report.css")
    hashes = (base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii") for text in texts)
    named = (f"'sha256-{one}'" for one in hashes)
    # Styles stand in attributes, too (lengths of bars, colours of plots), which no hash can allow: any style may.
    policy = (
        f"default-src 'none'; script-src {' '.join(named)}; style-src 'unsafe-inline'; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )
    return Scripts(tuple(map(Markup, texts)), Markup(style), policy)


def image(drawing: Drawing) -> Markup:
    """The picture as part of the page, sized so that a point of print is a point on the screen."""
    width, height = (int.from_bytes(drawing.png[start : start + 4], "big") for start in (16, 20))
    data = base64.b64encode(drawing.png).decode("ascii")
    return Markup('<img src="data:image/png;base64,{}" alt="{}" width="{}" height="{}">').format(
        data, drawing.alt, round(width * 96 / 150), round(height * 96 / 150)
    )


def plain_page(package: str, template: str, **values: Any) -> bytes:
    """A template of a package filled in; every name and sentence from outside is escaped."""
    style = Markup(files("phnn.report").joinpath("plain.css").read_text("utf-8"))
    filled = _environment().from_string(files(package).joinpath(template).read_text("utf-8"))
    return filled.render(style=style, **values).encode()


def svg_link(drawing: Drawing) -> str:
    """The picture as SVG, in a link."""
    return "data:image/svg+xml;base64," + base64.b64encode(drawing.svg).decode("ascii")


_SHOWN = 8
# Least probability of a bar.
_LEAST = 0.01


def plots_id(drawing: Drawing) -> str:
    """Name of the element that holds the traces of a drawing: the number of its file."""
    return f"traces-{drawing.file.partition('-')[0]}"


def _first(values: Sequence[float], unit: str) -> str:
    """The first few values, and how many more there are."""
    shown = ", ".join(formatting.short(v) for v in values[:_SHOWN])
    more = f" and {len(values) - _SHOWN} more" if len(values) > _SHOWN else ""
    return f"{shown} {unit}{more}" if values else ""


def _group(rows: Sequence[FitRow], which: str) -> list[float]:
    scores = [getattr(row, which).residual_over_noise for row in rows]
    return [score for score in scores if score is not None]


def _headline_ratio(document: Document) -> tuple[str, str, str] | None:
    """Caption, before and after: the worst residual over noise, on held-out recordings where there are any."""
    held_out = [row for row in document.fits if row.held_out]
    rows = held_out or list(document.fits)
    before, after = _group(rows, "before"), _group(rows, "after")
    if not before:
        return None
    if not rows[1:]:
        caption = "residual over noise, held out" if held_out else "residual over noise"
    else:
        caption = f"worst residual over noise, {len(rows)} {'held-out ' if held_out else ''}recordings"
    return caption, formatting.ratio(max(before)), formatting.ratio(max(after)) if after else ""


def _bar(row: CandidateRow, rows: Sequence[CandidateRow]) -> int:
    """Length of the bar in percent of the largest score."""
    largest = max((finite(r.score) or 0.0 for r in rows), default=0.0)
    return round(100.0 * max(finite(row.score) or 0.0, 0.0) / largest) if largest > 0.0 else 0


def _chances(document: Document) -> list[tuple[str, float, str]]:
    """Return the likeliest effects with length and label of their bars; that nothing is missing comes last."""
    likely = [(formatting.words(n), p) for n, p in document.probability if n != "none" and (p or 0.0) >= _LEAST]
    none = [("nothing is missing", p) for n, p in document.probability if n == "none"]
    return [(name, round(100.0 * (p or 0.0), 1), formatting.likelihood(p)) for name, p in (*likely[:_SHOWN], *none)]


@cache
def _environment() -> Environment:
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, loader=FunctionLoader(content)
    )
    shown = ("number", "interval", "ratio", "percent", "p_value", "likelihood", "words", "listing")
    environment.filters.update({name: getattr(formatting, name) for name in shown})
    environment.filters.update({f.__name__: f for f in (symbol, image, svg_link, plots_id, formula)})
    environment.filters.update(
        equivalence=verdicts.equivalence_sentence,
        passivity=verdicts.passive_sentence,
        heading=verdicts.missing_title,
        gained=verdicts.held_out_sentence,
        lost=verdicts.lost_sentence,
    )
    return environment


def render_page(
    document: Document, evidence: Evidence, gallery: Gallery, shares: Sequence[Shares], unsupplied: Sequence[str]
) -> str:
    """The page as text. Every name and sentence from outside is escaped."""
    location = document.location
    noise_unit = display_unit(max((v for _, v in document.noise_floor if v), default=None), document.output_unit)
    return (
        _environment()
        .get_template("template.html")
        .render(
            scripts=scripts(),
            tables=table_links(document, evidence, shares),
            usage=usage(evidence.traces, document.input_unit, document.output_unit),
            document=document,
            evidence=evidence,
            gallery=gallery,
            shares=shares,
            unsupplied=unsupplied,
            base_note=base_note(shares),
            headline=verdicts.headline(document, evidence.verdict_sentence),
            ended_sentence=verdicts.ended_sentence(document),
            test_sentence=verdicts.test_sentence(document),
            remainder_sentence=verdicts.remainder_sentence(document.remainder, document.immaterial is not None),
            no_proposal=verdicts.no_proposal_sentence(document, evidence.no_proposal),
            headline_ratio=_headline_ratio(document),
            chances=_chances(document),
            frequencies=_first(location.frequencies_Hz, "Hz") if location else "",
            times=_first(location.times_s, "s") if location else "",
            error_unit=document.rmse_unit,
            noise_unit=noise_unit,
            with_error=formatting.with_error,
            change=formatting.change,
            unscored=any(not trace.scored.all() for trace in evidence.traces if trace.held_out),
            bar=_bar,
            unit_of=lambda row: "" if row.unit == "1" else row.unit,
        )
    )


def usage(traces: Sequence[Trace], input_unit: str, output_unit: str) -> str:
    """A short program: a sine as large and as long as the first recording, simulated with the model beside the page."""
    # Largest input and duration of the first recording; 1 and 1 s without one.
    amplitude = seconds = 1.0
    if traces and len(traces[0].t) >= 2:
        first = traces[0]
        amplitude = (finite(np.nanmax(np.abs(first.u))) if np.isfinite(first.u).any() else None) or 1.0
        seconds = finite(first.t[-1] - first.t[0]) or 1.0
    lines = (
        ('model = phnn.load("model")', "the folder model/ beside this page"),
        (f"t = np.linspace(0.0, {seconds:.4g}, {_SAMPLES + 1})", "time [s]"),
        (f"u = {amplitude:.4g} * np.sin(2.0 * np.pi * {_PERIODS / seconds:.4g} * t)", f"input [{input_unit}]"),
        ("y = model.simulate(t, u)", f"output [{output_unit}]"),
    )
    width = max(len(code) for code, _ in lines)
    shown = "".join(f"{code:{width}}  # {remark}\n" for code, remark in lines)
    return f"import numpy as np\nimport phnn\n\n{shown}print(y.min(), y.max())\n"


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
        '<svg class="formula" role="img" aria-label="{}" viewBox="{:.2f} {:.2f} {:.2f} {:.2f}" '
        'style="width:{:.3f}em;height:{:.3f}em"><path fill="currentColor" d="{}"/></svg>'
    ).format(line, left, top, width, height, width / _SIZE, height / _SIZE, _outline(path))


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
