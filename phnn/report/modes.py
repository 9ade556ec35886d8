"""The files of `phnn modes`: ``modes.json``, ``report.html``, the figures and the models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import rc_context
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from scipy.optimize import linear_sum_assignment

from phnn.modal.confirm import HeldOut, Score
from phnn.modal.elements import STATEMENTS
from phnn.modal.judge import EQUIVALENT, NAMED, NONE, UNKNOWN
from phnn.modal.store import channels_of, model_document, study_document
from phnn.modal.study import Result
from phnn.models.store import FILE
from phnn.report.figures.modes import draw_left, draw_resonance, resonance_title
from phnn.report.figures.style import RC, Drawing, png
from phnn.report.formatting import DASH, display_unit, plain, short, words
from phnn.report.page import plain_page
from phnn.results import Place

Array = NDArray[np.float64]

# What `phnn modes` writes into its folder.
RESULTS = ("modes.json", "report.html", "figures", "model", "models")
# Frequencies at two amplitudes belong to one mode if they differ by less than this.
_SAME = 0.03


@dataclass(frozen=True)
class Row:
    """A model in the table: errors at each amplitude, to choose by and held out."""

    name: str
    cells: list[str]


def write_modes(result: Result, folder: str, place: Place) -> None:
    """Write document, figures and page into a folder."""
    (place / "modes.json").write_json(study_document(result))
    (place / "model" / FILE).write_json(model_document(result.final.fit, channels_of(result.study)))
    with rc_context(RC):
        drawings = [
            Drawing(
                "resonance.png", resonance_title(result), "the resonance that moves most", png(draw_resonance(result))
            ),
            Drawing(
                "left.png", "Residuals of the models on held-out recordings, by frequency, all outputs together.",
                "spectra of residuals", png(draw_left(result)),
            ),
        ]  # fmt: skip
    for drawing in drawings:
        (place / "figures" / drawing.file).write(drawing.png)
    headline, explanation = sentences(result)
    unit = display_unit(_largest(result), result.study.units[1])
    page = plain_page(
        "phnn.report",
        "modes.html",
        headline=headline,
        explanation=explanation,
        folder=folder,
        levels=level_names(result),
        apart=apart_names(result),
        unit=unit.name,
        models=rows(result, unit.scale),
        modes=_modes(result),
        drawings=drawings,
        left_out=[*result.study.left_out.items(), *((n, "a step had no solution") for n in result.failed)],
        fitted_choose=result.fitted_choose,
    )
    (place / "report.html").write(page)


def show(result: Result, console: Console) -> None:
    """The headline and the table of models on a terminal."""
    headline, explanation = sentences(result)
    unit = display_unit(_largest(result), result.study.units[1])
    columns = [c for level in level_names(result) for c in (f"left, {level} (%)", f"held out, {level} ({unit.name})")]
    columns += [f"amplitude held out, {level} ({unit.name})" for level in apart_names(result)]
    table = Table("at the ports", *columns)
    for row in rows(result, unit.scale):
        table.add_row(row.name, *row.cells)
    console.print(table)
    for name, reason in result.study.left_out.items():
        console.print(escape(f"left out: {name}: {reason}"))
    console.print(escape(f"{headline}. {explanation}".strip()))


def level_names(result: Result) -> list[str]:
    """Amplitudes with their unit."""
    return [f"{short(level[0].amplitude)} {result.study.units[0]}" for level in result.study.levels]


def apart_names(result: Result) -> list[str]:
    """Amplitudes that are held out as a whole, with their unit."""
    return [f"{short(level[0].amplitude)} {result.study.units[0]}" for level in result.study.apart]


def sentences(result: Result) -> tuple[str, str]:
    """The headline and its explanation."""
    names = " or ".join(_names(m.element.names) for m in result.members)
    count = result.final.fit.model.omega.size
    modes = f"{count} mode{'s' if count > 1 else ''}"
    told = {
        NONE: (
            f"{modes}, and one linear model serves at every amplitude",
            "These recordings show no change with amplitude.",
        ),
        NAMED: (f"{modes}; {names} at the ports explains the change with amplitude", ""),
        EQUIVALENT: (
            f"{modes}; {names} at the ports explains the change with amplitude",
            "These recordings cannot tell which of them.",
        ),
        UNKNOWN: (
            f"{modes}; no element here explains the change with amplitude",
            "One linear model for all amplitudes has a larger residual than one for each, and no element at the "
            "ports removes half of the difference.",
        ),
    }
    headline, explanation = told[result.verdict]
    if len(result.study.levels) == 1:
        return f"{modes} at one amplitude", "Record at a second amplitude to see what changes with it."
    if result.verdict == UNKNOWN and result.members:
        explanation += f" The model has {names}, which improves predictions but proves no name."
    if result.verdict in (NAMED, EQUIVALENT):
        told_by = [f"{words(n).capitalize()}: {STATEMENTS[n]}." for n in result.final.element.names]
        explanation = " ".join([*told_by, explanation]).strip()
    return headline, explanation


def _names(names: Sequence[str]) -> str:
    return " and ".join(words(n) for n in names) or "linear"


def _largest(result: Result) -> float:
    known = [max(score.rmse) for c in result.candidates for score in result.held_out[c.fit].all if score]
    return max(known, default=1e-6)


def rows(result: Result, scale: float) -> list[Row]:
    """The table of models."""

    def error(score: Score | None) -> str:
        return plain(float(np.mean(score.rmse)) / scale) if score else DASH

    def cells(left: Array, held: HeldOut) -> list[str]:
        pairs = [(plain(100.0 * float(x)), error(score)) for x, score in zip(left, held.levels, strict=True)]
        return [*(cell for pair in pairs for cell in pair), *(error(score) for score in held.apart)]

    # Each of these models knows one amplitude alone.
    scores = tuple(result.held_out[fit].levels[i] for i, fit in enumerate(result.alone))
    alone = cells(result.alone_by, HeldOut(scores, (None,) * len(result.study.apart)))
    found = [Row("linear, a model for each amplitude", alone)]
    return found + [Row(_names(c.element.names), cells(c.by_level, result.held_out[c.fit])) for c in result.candidates]


def _modes(result: Result) -> list[list[str]]:
    """Frequency and damping at each amplitude alone, mode beside mode, and how far each has moved at the highest."""
    models = [fit.model for fit in result.alone]
    first = models[0].omega
    pairs = []
    for m in models:
        away = np.abs(np.log(m.omega[None, :] / first[:, None]))
        # Pairs that are too far apart are worth nothing, so that they do not push others aside.
        mine, theirs = linear_sum_assignment(np.minimum(away, _SAME))
        pairs.append({int(i): int(j) for i, j in zip(mine, theirs, strict=True) if away[i, j] < _SAME})
    table = []
    for i in np.argsort(first):
        row = []
        for m, pair in zip(models, pairs, strict=True):
            j = pair.get(int(i))
            hz, ratio = (m.omega[j] / (2.0 * np.pi), 100.0 * m.zeta[j]) if j is not None else (None, None)
            row += [plain(hz, 4), plain(ratio)]
        last = pairs[-1].get(int(i)) if len(models) > 1 else None
        row.append(plain(100.0 * float(models[-1].omega[last] / first[i] - 1.0), 2) if last is not None else DASH)
        table.append(row)
    return table
