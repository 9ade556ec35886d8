"""The record of what phnn wrote: damaged, or kept in a folder above."""

from __future__ import annotations

from pathlib import Path

import pytest

from phnn.errors import InputRefused
from phnn.output import claim
from phnn.output.record import Record

RESULTS = ("report.html", "figures", "next.csv")


def seen(folder: Path) -> dict[str, bytes]:
    """Files of a folder but for phnn's own notes."""
    found = (p for p in folder.rglob("*") if p.is_file() and ".phnn" not in p.parts)
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in found}


def test_lines_that_others_add_are_read_on(tmp_path: Path) -> None:
    first, second = Record(tmp_path), Record(tmp_path)
    assert first.digests() == {}
    for k in range(3):
        second.add(Path(f"{k}"), "a")  # type: ignore[arg-type]
        assert set(first.digests()) == {str(j) for j in range(k + 1)}
    # Half a line counts once it is whole; a file that was written anew is read from its beginning.
    with first.path.open("a") as file:
        file.write('{"file": "3", "sha')
    assert "3" not in first.digests()
    with first.path.open("a") as file:
        file.write('256": "b"}\n')
    assert first.digests()["3"] == {"b"}
    second.compact()
    assert first.digests() == {}


@pytest.mark.parametrize("content", [b"\xff\xfe\n{", b"[[[[", b'{"file": 3}\n', b"\n\n"])
def test_a_damaged_record_counts_for_nothing(tmp_path: Path, content: bytes) -> None:
    (tmp_path / ".phnn").mkdir()
    (tmp_path / ".phnn" / "written.jsonl").write_bytes(content)
    with claim(tmp_path, "diagnose", (), RESULTS) as place:
        (place / "report.html").write(b"1")
    with claim(tmp_path, "diagnose", (), RESULTS) as place:
        (place / "report.html").write(b"2")
    assert seen(tmp_path) == {"report.html": b"2"}
    (tmp_path / ".phnn" / "written.jsonl").unlink()
    (tmp_path / ".phnn" / "written.jsonl").mkdir()
    with pytest.raises(InputRefused, match="is no file"):
        claim(tmp_path, "diagnose", (), RESULTS).__enter__()


def test_what_a_run_in_a_folder_above_has_written_is_phnns(tmp_path: Path) -> None:
    with claim(tmp_path, "demo", (), ("diagnosis",)) as place:
        (place / "diagnosis" / "report.html").write(b"1")
        (place / "diagnosis" / "next.csv").write(b"1")
    with claim(tmp_path / "diagnosis", "diagnose", (), RESULTS) as place:
        (place / "report.html").write(b"2")
        (place / "next.csv").write(b"2")
    assert seen(tmp_path) == {"diagnosis/report.html": b"2", "diagnosis/next.csv": b"2"}
    with pytest.raises(InputRefused, match=r"report\.html: was changed.*--overwrite"):
        claim(tmp_path, "demo", (), ("diagnosis",), overwrite=False).__enter__()
    # What was changed by hand, or is of somebody else, stays.
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "report.html").write_text("mine")
    with pytest.raises(InputRefused, match="was not written by phnn"):
        claim(tmp_path / "other", "diagnose", (), RESULTS).__enter__()
