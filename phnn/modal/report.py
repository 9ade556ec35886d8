"""Results of ``phnn modes``: files, page and the table in the terminal."""

from __future__ import annotations

from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table as Listing

from phnn.modal.store import model_document
from phnn.modal.study import LINEAR, SLOW, Result
from phnn.models.store import FILE
from phnn.report.formatting import DASH, display_unit, plain, short
from phnn.report.page import Section, Table, page
from phnn.results import Place

# What stands in the folder of a result.
RESULTS = ("modes.json", "report.html", "model", "models")
_SHOWN = {LINEAR: "one linear model", SLOW: "one model with slow ports", "": "linear, a model for each amplitude"}


def write_modes(result: Result, document: dict[str, Any], folder: str, place: Place) -> None:
    """Write ``modes.json``, a page, and all models.

    Args:
        document: of the result; folder: of the recordings.
    """
    (place / "modes.json").write_json(document)
    (place / "model" / FILE).write_json(model_document(result.models[result.final]))
    alone = {f"linear_at_level_{i}": fit for i, fit in enumerate(result.alone, start=1)}
    for name, fit in {**alone, **result.models}.items():
        (place / "models" / f"{name}.json").write_json(model_document(fit))
    left_out = _left_out(result)
    sections = [
        Section(None, [_told(result), folder, _errors(result, document)]),
        Section(f"Modes of {_SHOWN[result.final]}", [_modes(result)], open=True),
        *([Section("Left out", left_out)] if left_out else []),
    ]
    (place / "report.html").write(page(f"Modes: {folder}", "Modes of a structure", sections))


def show(result: Result, document: dict[str, Any], out: Console) -> None:
    """Print the errors of all models, and what they say."""
    errors = _errors(result, document)
    listing = Listing(*errors.head)
    for row in errors.rows:
        listing.add_row(*row)
    out.print(listing)
    for sentence in [*(f"left out: {text}" for text in _left_out(result)), _told(result)]:
        out.print(escape(sentence))


def _left_out(result: Result) -> list[str]:
    return [f"{name}: {reason}" for name, reason in result.study.left_out.items()]


def _errors(result: Result, document: dict[str, Any]) -> Table:
    """Return the errors of all models at each amplitude: to choose by, and held out, averaged over the outputs."""
    alone = [level["linear_alone"] for level in document["levels"]]
    rows = {name: (m["choosing_error"], m["held_out"], m["held_out_levels"]) for name, m in document["models"].items()}
    # Each of these models knows one amplitude alone.
    nothing = [None] * len(result.study.apart)
    rows[""] = [a["choosing_error"] for a in alone], [a["held_out"] for a in alone], nothing
    largest = max((max(s["rmse"]) for _, *scores in rows.values() for held in scores for s in held if s), default=1e-6)
    unit = display_unit(largest, result.study.units.output)
    levels, apart = (
        [f"{short(level[0].amplitude)} {result.study.units.input}" for level in some]
        for some in (result.study.levels, result.study.apart)
    )
    head = [cell for level in levels for cell in (f"left, {level} (%)", f"held out, {level} ({unit.name})")]
    head += [f"amplitude held out, {level} ({unit.name})" for level in apart]

    def error(score: dict[str, Any] | None) -> str:
        return plain(float(np.mean(score["rmse"])) / unit.scale) if score else DASH

    table = []
    for name, (left, held, further) in rows.items():
        pairs = [(plain(100.0 * share), error(score)) for share, score in zip(left, held, strict=True)]
        table.append([_SHOWN[name], *(cell for pair in pairs for cell in pair), *map(error, further)])
    return Table(["model", *head], table)


def _modes(result: Result) -> Table:
    """Return frequency, damping, the ratio to every input and the shape at every output of the final model's modes."""
    study, fit = result.study, result.models[result.final]
    model = fit.model
    head = ["mode", "Hz", "damping, %"]
    head += [f"{name} (J½/{study.units.input})" for name in study.inputs]
    head += [f"{name} ({study.units.output}/J½)" for name in study.outputs]
    rows = [
        [
            str(number),
            *(plain(x, 4) for x in (model.omega[i] / (2.0 * np.pi), 100.0 * model.zeta[i])),
            *(plain(x) for x in (*model.b[i], *fit.shapes[:, i])),
        ]
        for number, i in enumerate(np.argsort(model.omega), start=1)
    ]
    return Table(head, rows, 0)


def _told(result: Result) -> str:
    count = result.models[result.final].model.omega.size
    found = f"{count} mode{'s' if count > 1 else ''}"
    if len(result.study.levels) == 1:
        return f"{found} at one amplitude. Record at a second amplitude to see what changes with it."
    if result.linear_serves:
        return f"{found}, and one linear model serves at every amplitude: these recordings show no change with it."
    if result.final == LINEAR:
        return f"{found} that move with amplitude; slow springs at the ports do not describe how."
    return (
        f"{found} that move with amplitude; springs at the ports that soften with the mean square of their "
        f"motion describe it. This proves no cause."
    )
