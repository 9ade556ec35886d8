"""The script that carries out the worked studies and measures them."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

ROOT = Path(__file__).parents[3]
Script = Callable[..., int]


@pytest.fixture
def script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Script:
    """Runs the script in this process; gives its exit status. Its commands run in processes of their own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))

    def run(*settings: str) -> int:
        path = str(ROOT / "scripts" / "studies.py")
        monkeypatch.setattr(sys, "argv", [path, f"folder={tmp_path}", f"out={tmp_path / 'out'}", *settings])
        try:
            runpy.run_path(path, run_name="__main__")
        except SystemExit as stop:
            return int(stop.code or 0)
        return 0

    return run


def test_a_folder_without_studies_is_refused(
    script: Script, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert script() == 2
    told = capsys.readouterr().err
    assert "no folder of any study" in told and "Traceback" not in told
    assert not any(tmp_path.iterdir())


def test_what_a_command_takes_is_written_down_even_where_it_refuses(script: Script, tmp_path: Path) -> None:
    (tmp_path / "emps").mkdir()
    assert script("studies.emps=[check]") == 2
    table = pd.read_csv(tmp_path / "out" / "studies.csv")
    assert table.loc[0, "status"] == 2
    assert table.loc[0, "seconds"] > 0.0 and 0.01 < table.loc[0, "peak_GB"] < 10.0
