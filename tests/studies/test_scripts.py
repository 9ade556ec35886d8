"""The scripts of the studies: what they cannot use is refused in one line, with status 2."""

from __future__ import annotations

from pathlib import Path

import pytest
from scripts_example import script


@pytest.mark.parametrize(
    ("name", "settings", "needle"),
    [
        ("experiment", "recordings.effect=gravity", "gravity"), ("experiment", "recordings.noise_um=much", "noise_um"),
        ("experiment", "folder=nowhere", "nowhere"), ("experiment", "fit.starts=0", "starts"),
        ("compare", "folder=nowhere", "nowhere"), ("compare", "folder=null", "folder=DIR"),
        ("rivals", "sets=[gravity]", "gravity"), ("rivals", "noise_um=much", "noise_um"),
        ("rivals", "compare.starts=0", "starts"), ("rivals", "compare.models=[phs,transformer]", "transformer"),
        ("trainers", "only=[gravity]", "no case 'gravity'"),
        ("trainers", "only=[slow] cases.slow.ways=[magic]", "no trainer 'magic'"),
    ],
)  # fmt: skip
def test_what_does_not_exist_is_refused_in_one_line(
    name: str, settings: str, needle: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        script(name, f"out={tmp_path / 'out'}", *settings.split())
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert needle in error
    assert error.count("\n") == 1
