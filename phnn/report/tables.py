"""The tables of a page as csv, in SI units and with all digits, as links that hold their content."""

from __future__ import annotations

import base64
import csv
import io
from collections.abc import Iterable, Mapping, Sequence

from phnn.report.document import Document, FitRow, Score
from phnn.report.evidence import CandidateRow, Evidence, ModelRow, ParameterRow, RuleRow
from phnn.report.formatting import finite
from phnn.report.shares import Shares

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


def data_link(text: str) -> str:
    """A link that holds a csv text; the mark at its beginning tells a spreadsheet that it is UTF-8."""
    return "data:text/csv;charset=utf-8;base64," + base64.b64encode(text.encode("utf-8-sig")).decode("ascii")


def table_links(document: Document, evidence: Evidence, shares: Sequence[Shares]) -> Mapping[str, str]:
    """A link for each table that has rows, by its name."""
    tables = {
        "fit": _fit(document.fits, document.output_unit),
        "parameters": _parameters(evidence.parameters),
        "energy": _energy(shares),
        "models": _models(evidence.models),
        "tried": _tried(evidence.candidates),
        "rules": _rules(evidence.rules),
        "noise": (
            ["recording", f"noise floor ({document.output_unit})"], [list(row) for row in document.noise_floor]
        ),
    }  # fmt: skip
    return {name: data_link(csv_text(head, rows)) for name, (head, rows) in tables.items() if rows}


_Table = tuple[list[str], list[list[Cell]]]


def _fit(rows: Sequence[FitRow], unit: str) -> _Table:
    scores = ("fit (%)", f"RMSE ({unit})", "residual over noise")
    head = ["recording", "held out", *(f"{which}: {score}" for which in ("before", "after") for score in scores)]
    return head, [[row.name, row.held_out, *_score(row.before), *_score(row.after)] for row in rows]


def _score(score: Score) -> list[Cell]:
    return [score.fit_percent, score.rmse, score.residual_over_noise]


def _parameters(rows: Sequence[ParameterRow]) -> _Table:
    head = ["parameter", "meaning", "unit", "before", "after", "standard error", "95 % from", "95 % to", "remark"]
    return head, [
        [r.name, r.description, r.unit, r.before, r.after, r.std, *(r.interval_95 or (None, None)), r.note]
        for r in rows
    ]


def _energy(rows: Sequence[Shares]) -> _Table:
    kinds = rows[0].kinds if rows else ()
    return ["recording", "share of", *kinds], [[r.recording, r.base, *(r.parts[k] for k in kinds)] for r in rows]


def _models(rows: Sequence[ModelRow]) -> _Table:
    head = ["model", "chi2/N fitted", "chi2/N held out", "parameters", "probability", "converged", "final model"]
    return head, [
        [r.elements, r.left, r.left_held_out, r.parameters, r.probability, r.converged, r.chosen] for r in rows
    ]


def _tried(rows: Sequence[CandidateRow]) -> _Table:
    head = ["effect", "location", "score", "predicted fall of chi2/N", "outcome"]
    return head, [[r.effect, r.location, r.score, r.fall, r.outcome] for r in rows]


def _rules(rows: Sequence[RuleRow]) -> _Table:
    def numbers(row: RuleRow) -> str:
        return "; ".join(f"{name} {value}" for name, value in row.numbers.items())

    return ["rule", "numbers", "applies", "outcome"], [[r.rule, numbers(r), r.applies, r.outcome] for r in rows]
