"""The full tier: the whole command on a folder, its answer read from ``diagnosis.json``."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from phnn.models.store import load
from phnn.report.files import finite


def diagnose_folder(
    folder: Path, out: Path, without: Sequence[str], settings: dict[str, Any], keep: bool
) -> dict[str, Any]:
    """``diagnosis.json`` of a folder, with the base parameters before and after beside it, and the final model's
    estimates with their standard errors and intervals.

    Args:
        without: catalogue entries that the diagnosis must not use.
        settings: of ``phnn diagnose``.
        keep: keep report and models.
    """
    from phnn.commands import diagnose_quietly

    diagnosis = diagnose_quietly(folder, out, settings | {"without": list(without), "workers": 1})
    content: dict[str, Any] = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    content["models"] = {name: load(out / name)[0].values() for name in ("base", "model")}
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
        shutil.rmtree(out)
    return content
