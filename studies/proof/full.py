"""The full tier: the whole command on a folder, its answer read from ``diagnosis.json``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from phnn.diagnosis.diagnosis import diagnose
from phnn.identification.options import Options
from phnn.models.store import load
from phnn.recordings import read
from phnn.report.result import write_into
from phnn.results import Place, finite


def diagnose_folder(
    folder: Path, place: Place, without: Sequence[str], settings: dict[str, Any], keep: bool
) -> dict[str, Any]:
    """``diagnosis.json`` of a folder, with the base parameters before and after beside it, and the final model's
    estimates with their standard errors and intervals.

    Args:
        without: catalogue entries that the diagnosis must not use.
        settings: of ``phnn diagnose``.
        keep: keep report and models.
    """
    options = Options.from_config(settings | {"without": list(without), "workers": 1})
    place.own_folder()
    diagnosis = diagnose(read(folder), options)
    write_into(diagnosis, place)
    content: dict[str, Any] = json.loads((place / "diagnosis.json").path.read_text(encoding="utf-8"))
    content["models"] = {name: load((place / name).path)[0].values() for name in ("base", "model")}
    final = diagnosis.judgement.final
    content["estimates"] = {
        n: {
            "value": final.setup.parameters[n].value,
            "std": finite(std),
            "interval_95": final.interval(n),
            "interval_95_anchors_exact": final.interval(n, anchored=False),
        }
        for n, std in final.std().items()
    }
    if not keep:
        place.remove()
    return content
