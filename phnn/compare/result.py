"""What one model came to, kept on disk so that a comparison that is stopped need not fit it again."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from phnn.errors import InputRefused
from phnn.identify.evaluate import Evaluation, PartScore
from phnn.recordings.recording import Campaign
from phnn.report.files import finite, write_atomic, write_json

SCHEMA = "phnn.compared/1"
FILE, OUTPUTS = "result.json", "outputs.npz"


@dataclass(frozen=True)
class Result:
    """One model on all recordings.

    Attributes:
        name: of the model.
        evaluation: its outputs and scores.
        facts: what else there is to say of it, see `phnn.compare.facts`.
        substeps: steps a sample interval by recording, of a model that others begin from.
    """

    name: str
    evaluation: Evaluation
    facts: Mapping[str, Any]
    substeps: Mapping[str, int]


def digest(campaign: Campaign) -> str:
    """A hash of all that fits and scores see of the recordings."""
    found = hashlib.sha256()
    for r in campaign.recordings:
        found.update(repr((r.name, r.start, r.interpolation, r.parts, r.noise, r.period)).encode())
        for values in (r.t, r.u, r.y, r.noise_correlation):
            found.update(np.ascontiguousarray(values).tobytes())
    found.update(repr((sorted(campaign.setup.items()), sorted(campaign.known.items()))).encode())
    return found.hexdigest()


def keep(result: Result, folder: Path, made_with: Mapping[str, Any], recordings: str) -> None:
    """Write a result into the folder of its model; the outputs first, so that a result is whole once it is there."""
    names = list(result.evaluation.outputs)
    buffer = io.BytesIO()
    np.savez(buffer, *result.evaluation.outputs.values())
    write_atomic(folder / OUTPUTS, buffer.getvalue())
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
    write_json(folder / FILE, content)


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
        before = content["made_with"], content["recordings"], content["schema"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputRefused(f"{path}: cannot be read ({type(error).__name__}): delete {folder}") from error
    _check_same(path, before, (json.loads(json.dumps(finite(made_with))), recordings, SCHEMA))
    return found


def _check_same(path: Path, before: tuple[Any, str, str], now: tuple[Any, str, str]) -> None:
    """Refuse a result that would have come out differently now."""
    remedy = "take another --out, or resume=false to fit it anew"
    if before[1:] != now[1:]:
        raise InputRefused(f"{path}: was made of other recordings or by another version: {remedy}")
    for key in sorted(set(before[0]) | set(now[0])):
        old, new = before[0].get(key), now[0].get(key)
        if old != new:
            raise InputRefused(f"{path}: was made with {key}={old}, now {key}={new}: {remedy}")
