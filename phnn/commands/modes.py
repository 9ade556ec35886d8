"""``phnn modes``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from phnn.commands.terminal import Config, console, status
from phnn.modal.experiment import study_of
from phnn.modal.store import model_document
from phnn.modal.study import LINEAR, SLOW, Result, Settings, study_modes
from phnn.models.store import FILE
from phnn.recordings import read
from phnn.report.formatting import DASH, display_unit, plain, short
from phnn.results import claim

# What stands in the folder of a result.
_RESULTS = ("modes.json", "model", "models")
_SHOWN = {LINEAR: "one linear model", SLOW: "one model with slow ports", "": "linear, a model for each amplitude"}


def modes(
    folder: Path, out: Path, manifest: Path | None, config: Config, outside: bool = False, overwrite: bool = False
) -> None:
    """Find the modes of a structure and what moves with amplitude; writes ``modes.json``, ``model/``, ``models/``."""
    settings = Settings.from_config(config)
    study = study_of(read(folder, manifest, allow_outside=outside))
    with claim(out, "modes", [folder], _RESULTS, overwrite=overwrite) as place, status() as progress:
        result = study_modes(study, settings, progress)
        document = result.document()
        (place / "modes.json").write_json(document)
        (place / "model" / FILE).write_json(model_document(result.models[result.final]))
        alone = {f"linear_at_level_{i}": fit for i, fit in enumerate(result.alone, start=1)}
        for name, fit in {**alone, **result.models}.items():
            (place / "models" / f"{name}.json").write_json(model_document(fit))
    _show(result, document, console())


def _show(result: Result, document: dict[str, Any], out: Console) -> None:
    """Print the errors of all models at each amplitude, to choose by and held out, and what they say."""
    study = result.study
    alone = [level["linear_alone"] for level in document["levels"]]
    rows = {name: (m["choosing_error"], m["held_out"]) for name, m in document["models"].items()}
    rows[""] = [a["choosing_error"] for a in alone], [a["held_out"] for a in alone]
    largest = max((max(s["rmse"]) for _, held in rows.values() for s in held if s), default=1e-6)
    unit = display_unit(largest, study.units.output)
    table = Table("model")
    for level in study.levels:
        name = f"{short(level[0].amplitude)} {study.units.input}"
        table.add_column(f"left, {name} (%)")
        table.add_column(f"held out, {name} ({unit.name})")
    for name, (left, held) in rows.items():
        cells = [
            cell
            for share, score in zip(left, held, strict=True)
            for cell in (plain(100.0 * share), plain(float(np.mean(score["rmse"])) / unit.scale) if score else DASH)
        ]
        table.add_row(_SHOWN[name], *cells)
    out.print(table)
    for name, reason in study.left_out.items():
        out.print(escape(f"left out: {name}: {reason}"))
    out.print(_told(result))


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
