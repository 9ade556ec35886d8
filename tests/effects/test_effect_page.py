"""The page on effects of one's own up to its diagnosis; tests/docs runs the whole page."""

from __future__ import annotations

import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

from phnn.effects import catalogue, unregister

DOCS = Path(__file__).parents[2] / "docs"
sys.path.insert(0, str(DOCS / "_ext"))

from blocks import blocks_of  # noqa: E402

BLOCKS = blocks_of((DOCS / "write-your-own-effect.md").read_text(encoding="utf-8"))
LAST = next(i for i, block in enumerate(BLOCKS) if "diagnose(" in block.code)


def test_the_page_builds_and_registers_an_effect() -> None:
    assert len(BLOCKS) - 1 == LAST
    assert sum(bool(block.printed) for block in BLOCKS) >= 4
    names: dict[str, object] = {"__name__": "page"}
    try:
        for block in BLOCKS[:LAST]:
            with redirect_stdout(StringIO()) as out:
                exec(compile(block.code, "page", "exec"), names)
            assert out.getvalue() == (block.printed or "")
    finally:
        if "guide_damping" in catalogue():
            unregister("guide_damping")
