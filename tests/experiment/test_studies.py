"""The script that carries out the worked studies and measures them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pandas as pd

SCRIPT = Path(__file__).parents[2] / "scripts" / "studies.py"


def run(tmp_path: Path, *settings: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(SCRIPT), f"folder={tmp_path}", f"out={tmp_path / 'out'}", *settings]
    return subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)


def test_a_folder_without_studies_is_refused(tmp_path: Path) -> None:
    done = run(tmp_path)
    assert done.returncode == 2 and "no folder of any study" in done.stderr and "Traceback" not in done.stderr
    assert not any(tmp_path.iterdir())


def test_what_a_command_takes_is_written_down_even_where_it_refuses(tmp_path: Path) -> None:
    (tmp_path / "emps").mkdir()
    done = run(tmp_path, "studies.emps=[check]")
    table = pd.read_csv(tmp_path / "out" / "studies.csv")
    assert done.returncode == 2 and table.loc[0, "status"] == 2
    assert table.loc[0, "seconds"] > 0.0 and 0.01 < table.loc[0, "peak_GB"] < 10.0
