"""The measured tables of the documentation say which code made them, and a change of that code is seen."""

from __future__ import annotations

import importlib.util
import re
import subprocess
from pathlib import Path

import pytest

from studies.results import fill, stamped

ROOT = Path(__file__).resolve().parents[2]
# Tables that tell of the code as it is, and are held against it by tests of their own.
GENERATED = {"rules", "criteria"}

_spec = importlib.util.spec_from_file_location("evidence", ROOT / "scripts" / "evidence.py")
assert _spec is not None
assert _spec.loader is not None
evidence = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(evidence)


def test_every_measured_table_has_a_command_and_rooms_that_exist() -> None:
    blocks = {
        (str(page.relative_to(ROOT)), name)
        for page in (ROOT / "docs").glob("*.md")
        for name in re.findall(r"<!-- begin (\w+) -->", page.read_text(encoding="utf-8"))
    }
    stages = evidence.STAGES.values()
    assert {b for b in blocks if b[1] not in GENERATED} == {(s.page, s.block) for s in stages}
    for stage in stages:
        assert all((ROOT / room).exists() for room in stage.rooms)
        assert all((ROOT / command[0]).is_file() for command in stage.commands if command[0] != "-m")


def test_a_table_is_old_when_its_own_code_has_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def git(*words: str) -> str:
        own = ("git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b.c")
        return subprocess.run((*own, *words), check=True, capture_output=True, text=True).stdout.strip()

    for room in ("room", "other"):
        (tmp_path / room).mkdir()
        (tmp_path / room / "a.py").write_text("1\n")
    page = tmp_path / "page.md"
    page.write_text("# A page\n\n<!-- begin table -->\n<!-- end table -->\n")
    git("init", "-q")
    git("add", ".")
    git("commit", "-qm", "one")
    monkeypatch.setattr(evidence, "ROOT", tmp_path)
    stage = evidence.Stage("page.md", "table", ("room",), ())
    assert evidence.changed(stage) is None
    fill(page, "table", stamped("| a |", {git("rev-parse", "--short=8", "HEAD")}))
    (tmp_path / "other" / "a.py").write_text("2\n")
    assert evidence.changed(stage) == []
    (tmp_path / "room" / "a.py").write_text("2\n")
    assert evidence.changed(stage) == ["room/a.py"]


def test_what_is_made_now_names_the_present_commit() -> None:
    assert re.fullmatch(r"\| a \|\n\n\*Made with commit [0-9a-f]{8,}\+? on \d{4}-\d\d-\d\d\.\*", stamped("| a |"))
