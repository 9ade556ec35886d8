"""The page on effects of one's own: its code runs as it stands, and prints what the page says."""

from __future__ import annotations

import re
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import pytest
from guided_rig import write_rig

from phnn.effects import catalogue, unregister

PAGE = Path(__file__).parents[2] / "docs" / "write-your-own-effect.md"
BLOCKS = re.findall(r"```python\n(.*?)```(?:\n\n```text\n(.*?)```)?", PAGE.read_text(encoding="utf-8"), re.DOTALL)
LAST = next(i for i, (code, _) in enumerate(BLOCKS) if "diagnose(" in code)


def run(blocks: list[tuple[str, str]]) -> None:
    """Execute code in one namespace and compare what it prints."""
    names: dict[str, object] = {"__name__": "page"}
    try:
        for code, printed in blocks:
            with redirect_stdout(StringIO()) as out:
                exec(compile(code, str(PAGE), "exec"), names)
            assert out.getvalue() == printed
    finally:
        if "guide_damping" in catalogue():
            unregister("guide_damping")


def test_the_page_builds_and_registers_an_effect() -> None:
    assert len(BLOCKS) - 1 == LAST
    assert sum(bool(printed) for _, printed in BLOCKS) >= 4
    run(BLOCKS[:LAST])


@pytest.mark.slow
def test_a_diagnosis_finds_the_effect_of_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "recordings").mkdir()
    write_rig(tmp_path / "recordings", power=2.0)
    monkeypatch.chdir(tmp_path)
    run(BLOCKS)
