"""The script that compares all models, on recordings that it makes itself."""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[3] / "scripts" / "compare.py"


def script(monkeypatch: pytest.MonkeyPatch, *overrides: str) -> None:
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), *overrides])
    runpy.run_path(str(SCRIPT), run_name="__main__")


@pytest.mark.parametrize(
    ("override", "needle"),
    [
        ("recordings.effect=gravity", "gravity"),
        ("recordings.noise_um=much", "noise_um"),
        ("compare.starts=0", "starts"),
        ("inputs=0", "inputs"),
        ("compare.models=[phs,transformer]", "transformer"),
        ("folder=nowhere", "nowhere"),
    ],
)
def test_bad_input_is_refused_in_one_line(
    override: str, needle: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        script(monkeypatch, f"out={tmp_path / 'out'}", override)
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert needle in error
    assert error.count("\n") == 1


@pytest.mark.slow
def test_recordings_beyond_the_identified_range_tell_models_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    script(monkeypatch, f"out={tmp_path}", "inputs=50", "compare.models=[phs,bouc_wen,linear]")
    assert "held out" in capsys.readouterr().out
    found = json.loads((tmp_path / "models" / "compare.json").read_text())
    page = (tmp_path / "comparison.md").read_text()
    outside = [line.split("|")[1].strip() for line in page.splitlines() if "| held out, outside | 9" in line]
    assert len(found["phs"]) == 12
    assert len(outside) == 5
    for name in outside:
        assert found["phs"][name]["residual_over_noise"] < 1.2
        assert all(found[m][name]["residual_over_noise"] > 15.0 for m in ("bouc_wen", "linear"))
    cycles = page.partition("## Steady cycles")[2].partition("## Models")[0]
    assert sum(line.startswith("| sine_") for line in cycles.splitlines()) == 12
    assert "Table 1" in page
    # Passive by construction, and a block that has no energy.
    kinds = {
        line.split("|")[1].strip(): line.split("|")[5:7] for line in page.partition("## Models")[2].splitlines()[4:7]
    }
    assert [c.strip() for c in kinds["PHS"]] == ["0 of 10000", "0 of 50"]
    assert kinds["Bouc–Wen"][0].strip() == "no energy"
