"""Scripts of the studies, run in this process."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from unittest import mock

FOLDER = Path(__file__).resolve().parents[1] / "scripts"


def script(name: str, *settings: str) -> None:
    """Run a script with settings."""
    path = str(FOLDER / f"{name}.py")
    with mock.patch.object(sys, "argv", [path, *settings]):
        runpy.run_path(path, run_name="__main__")
