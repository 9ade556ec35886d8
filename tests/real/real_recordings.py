"""Public recordings, where they are present: in the folder PHNN_RECORDINGS, else beside the project."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

_BESIDE = Path(__file__).resolve().parents[3] / "shared" / "recordings"


def folder(name: str, file: str) -> Path:
    """The folder of a public data set; skips the test where its file is absent."""
    found = Path(os.environ.get("PHNN_RECORDINGS", _BESIDE)) / name
    if not (found / file).is_file():
        pytest.skip(f"{found / file} is not there: get it from the source named in configs/recordings/{name}")
    return found
