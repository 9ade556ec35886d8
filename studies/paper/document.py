"""The files of an experiment: Table 3 as text and csv, parameters beside the published ones, all results as json."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from phnn.identification.evaluate import PartScore
from phnn.models.actuator import from_paper
from phnn.models.bouc_wen import bouc_wen
from phnn.report.figures import Drawing
from phnn.report.formatting import markdown_table, number, percent, with_error
from phnn.setup import Setup
from studies.paper.table import REFITTED, Comparison, Row
from studies.recordings import Made
from studies.results import figure_lines

SCHEMA = "phnn.experiment/1"
HEADS = {
    "phs": "PHS",
    "bouc_wen": "Bouc–Wen",
    "phs_published": "PHS, Table 1",
    "bouc_wen_published": "Bouc–Wen, Table 2",
}
_USES = {"identification": "identified", "confirmation": "held out"}
_COLUMNS = (
    *("recording", "use", "paper_line", "model", "fit_percent", "rmse_m", "residual_over_noise"),
    *("paper_fit_percent", "paper_rmse_m"),
)
_PUBLISHED = {"phs": Setup(from_paper()), "bouc_wen": bouc_wen()}


def heads(rows: Sequence[Row]) -> list[str]:
    """Column titles of Table 3; the paper's own columns where a recording repeats one of its lines."""
    models = [HEADS[m] for m in rows[0].scores]
    paper = [f"{HEADS[m]}, paper" for m in REFITTED] if any(r.printed for r in rows) else []
    return ["recording", "use", *models, *paper]


def cells(row: Row, columns: int) -> list[str]:
    """One line of Table 3: fit percentage and root mean square error in µm, model by model."""
    found = [row.name, _USES.get(row.use, row.use)]
    found += [_cell(score.fit_percent, score.rmse) for score in row.scores.values()]
    if row.printed is not None:
        found += [_cell(row.printed.fit(m), row.printed.rmse(m)) for m in REFITTED]
    return found + [""] * (columns - len(found))


def _cell(fit_percent: float, rmse: float) -> str:
    return f"{percent(fit_percent, 2)}  ({number(rmse * 1e6)})"


def table_csv(rows: Sequence[Row]) -> str:
    """Table 3 with one line for each recording and model, SI."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for row in rows:
        for model, score in row.scores.items():
            paper: list[Any] = ["", ""]
            if row.printed is not None and model in REFITTED:
                paper = [row.printed.fit(model), row.printed.rmse(model)]
            values = [score.fit_percent, score.rmse, score.residual_over_noise]
            writer.writerow([row.name, row.use, row.line or "", model, *values, *paper])
    return out.getvalue()


def parameters(comparison: Comparison) -> dict[str, dict[str, Any]]:
    """Refitted parameters by model and name: value, standard error, interval, unit, why held, published value; SI."""
    found = {}
    for model in REFITTED:
        fitted = comparison.models[model].fit
        std, published = fitted.std(), _PUBLISHED[model].values()
        found[model] = {
            n: {
                "value": p.value,
                "std": std.get(n),
                "interval_95": fitted.interval(n),
                "unit": p.unit,
                "held": fitted.held.get(n),
                "published": published.get(n),
            }
            for n, p in fitted.setup.parameters.items()
        }
    return found


def document(comparison: Comparison, made: Made | None, folder: str, seed: int, seconds: float) -> dict[str, Any]:
    """Everything as a mapping for ``experiment.json``; numbers may be infinite."""
    rows = comparison.rows()
    return {
        "schema": SCHEMA,
        "folder": folder,
        "made": None if made is None else vars(made) | {"conditions": vars(made.conditions)},
        "table": {
            row.name: {
                "use": row.use,
                "paper_line": row.line,
                "paper": None if row.printed is None else vars(row.printed),
                "models": {m: _numbers(s) for m, s in row.scores.items()},
            }
            for row in rows
        },
        "parameters": parameters(comparison),
        "noise_floor": {r.name: r.noise for r in comparison.campaign.recordings},
        "numerical_error_sigma": comparison.numerical_error,
        "seed": seed,
        "seconds": seconds,
    }


def _numbers(score: PartScore) -> dict[str, float]:
    return {n: getattr(score, n) for n in ("fit_percent", "rmse", "residual_over_noise")}


def markdown(comparison: Comparison, made: Made | None, folder: str, drawings: Sequence[Drawing]) -> str:
    """The experiment for a person: what was recorded, Table 3, parameters, figures."""
    rows = comparison.rows()
    head = heads(rows)
    table = markdown_table(head, [cells(row, len(head)) for row in rows])
    lines = [f"# Both models on {folder}", "", _origin(made), "", "## Table 3", ""]
    lines += ["Fit in percent as MATLAB's `compare`, and the root mean square error in µm in brackets.", "", *table]
    lines += ["", _held_out(comparison), ""]
    for model, values in parameters(comparison).items():
        lines += [f"## Parameters: {HEADS[model]}", ""]
        body = [
            [n, f"{_value(v['value'], v['std'])} {v['unit']}", number(v["published"], 5), v["held"] or ""]
            for n, v in values.items()
        ]
        lines += [*markdown_table(["parameter", "refitted", "published", "note"], body), ""]
    return "\n".join([*lines, *figure_lines(drawings)])


def _value(value: float, std: float | None) -> str:
    return number(value, 5) if std is None else with_error(value, std)


def _origin(made: Made | None) -> str:
    """Where the recordings come from."""
    if made is None:
        return "Recordings of the folder named above, both models refitted on its identification part."
    unknown = "" if made.conditions.effect == "none" else " The published parameters do not know of it."
    return made.words("75 V sines, a step and a chirp") + unknown


def _held_out(comparison: Comparison) -> str:
    """How well the held-out recordings are reached."""
    said = [
        f"{HEADS[m]} {number(over)} × noise"
        for m in REFITTED
        if np.isfinite(over := comparison.models[m].evaluation.over_noise("confirmation"))
    ]
    return f"Held-out recordings: {', '.join(said)}." if said else "Nothing was held out."
