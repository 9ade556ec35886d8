"""Public recordings, where they are present: in the folder PHNN_RECORDINGS, else beside the project."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from phnn.configuration import config_folder
from phnn.diagnose import Diagnosis

_BESIDE = Path(__file__).resolve().parents[3] / "shared" / "recordings"
_UNSCORED = 100


def folder(name: str, file: str) -> Path:
    """The folder of a public data set; skips the test where its file is absent."""
    found = Path(os.environ.get("PHNN_RECORDINGS", _BESIDE)) / name
    if not (found / file).is_file():
        pytest.skip(f"{found / file} is not there: get it from the source named in configs/recordings/{name}")
    return found


def manifest(name: str, target: Path, old: str, new: str) -> Path:
    """The manifest of the worked study with some of its text replaced, and its networks, copied to a folder."""
    for path in (config_folder() / "recordings" / name).glob("*.yaml"):
        (target / path.name).write_text(path.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    assert new in (target / "recordings.yaml").read_text(encoding="utf-8")
    return target / "recordings.yaml"


def named(diagnosis: Diagnosis) -> list[str]:
    """Effects in the order in which they were found."""
    return [f.trial.candidate.effect.name for f in diagnosis.judgement.findings]


def benchmark_errors(diagnosis: Diagnosis) -> dict[str, float]:
    """Root mean square errors by recording as the benchmark counts them: without the mean, not the first samples."""
    measured: dict[str, NDArray[np.float64]] = {r.name: r.y for r in diagnosis.campaign.recordings}
    return {n: float(np.std((measured[n] - y)[_UNSCORED:])) for n, y in diagnosis.after.outputs.items()}
