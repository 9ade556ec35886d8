"""The result of one model, kept on disk so that a comparison that was stopped need not fit it again."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from phnn.errors import InputRefused
from phnn.identification.evaluate import Evaluation, PartScore
from phnn.results import Place, finite, same

SCHEMA = "phnn.compared/1"
FILE, OUTPUTS = "result.json", "outputs.npz"


@dataclass(frozen=True)
class Result:
    """One model on all recordings.

    Attributes:
        name: of the model.
        evaluation: its outputs and scores.
        facts: what else there is to say of it, see `phnn.comparison.facts`.
        substeps: steps a sample interval by recording, of a model that others begin from.
    """

    name: str
    evaluation: Evaluation
    facts: Mapping[str, Any]
    substeps: Mapping[str, int]


def keep(result: Result, place: Place, made_with: Mapping[str, Any], recordings: str) -> None:
    """Write a result into the folder of its model; the outputs first, so that a result is whole once it is there."""
    names = list(result.evaluation.outputs)
    buffer = io.BytesIO()
    np.savez(buffer, *result.evaluation.outputs.values())
    (place / OUTPUTS).write(buffer.getvalue())
    content = {
        "schema": SCHEMA,
        "model": result.name,
        "made_with": made_with,
        "recordings": recordings,
        "outputs": names,
        "parts": [asdict(p) for p in result.evaluation.parts],
        "facts": result.facts,
        "substeps": dict(result.substeps),
    }
    (place / FILE).write_json(content)


def kept(name: str, folder: Path, made_with: Mapping[str, Any], recordings: str) -> Result | None:
    """The result that `keep` wrote, None where there is none.

    Raises:
        InputRefused: it was made with other settings or of other recordings, or is damaged.
    """
    path = folder / FILE
    if not path.exists():
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        with np.load(folder / OUTPUTS) as stored:
            values = [stored[f"arr_{k}"] for k in range(len(content["outputs"]))]
        found = Result(
            content["model"],
            Evaluation(
                dict(zip(content["outputs"], values, strict=True)), tuple(PartScore(**p) for p in content["parts"])
            ),
            content["facts"],
            content["substeps"],
        )
        before = {**content["made_with"], "recordings": content["recordings"], "schema": content["schema"]}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputRefused(f"{path}: cannot be read ({type(error).__name__}): delete {folder}") from error
    now = {**json.loads(json.dumps(finite(made_with))), "recordings": recordings, "schema": SCHEMA}
    same(path, before, now, "take another --out, or resume=false to fit it anew")
    return found
