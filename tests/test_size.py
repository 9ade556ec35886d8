"""The size of the project: ceilings that every change may lower and none may raise."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
# Lines and files of Python. Lower a ceiling with every change that deletes; raise none.
CEILINGS = {"phnn": (48_175, 170), "studies": (10_639, 44), "tests": (29_868, 140)}
# A ceiling this far above the size no longer holds it.
SLACK = 400  # lines


def size(room: str) -> tuple[int, int]:
    """Count lines and files of Python below a folder of the repository."""
    paths = [path for path in (ROOT / room).rglob("*.py") if not any(part.startswith(".") for part in path.parts)]
    return sum(path.read_text(encoding="utf-8").count("\n") for path in paths), len(paths)


@pytest.mark.parametrize("room", CEILINGS)
def test_no_room_grows(room: str) -> None:
    lines, files = size(room)
    most_lines, most_files = CEILINGS[room]
    assert lines <= most_lines and files <= most_files, (
        f"{room}/ has {lines} lines in {files} files; its ceiling is {most_lines} in {most_files}: delete first"
    )
    assert lines > most_lines - SLACK, f"{room}/ has {lines} lines only: lower its ceiling of {most_lines}"
