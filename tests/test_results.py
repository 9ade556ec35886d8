"""Results of a command: a folder for one run, whole files, names inside it, strangers' files left alone."""

from __future__ import annotations

import json
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import time
from pathlib import Path, PurePosixPath

import pytest
from hypothesis import given
from hypothesis import strategies as st

from phnn.errors import InputRefused, OutputFailed, SolverFailed
from phnn.results import (
    INCOMPLETE,
    NOTES,
    PROGRESS,
    Origin,
    Place,
    claim,
    file_name,
    finished,
    printable,
    unique_names,
    watched,
)

RESULTS = ("report.html", "figures", "next.csv")


def seen(folder: Path) -> dict[str, bytes]:
    """Return the files of a folder but for phnn's notes."""
    files = (p for p in folder.rglob("*") if p.is_file() and NOTES not in p.parts)
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in files}


def run(out: Path, command: str = "diagnose", overwrite: bool | None = None, **files: bytes) -> None:
    """One run that writes these files."""
    with claim(out, command, (), RESULTS, overwrite=overwrite) as place:
        assert INCOMPLETE in seen(out)
        for name, content in files.items():
            (place / name).write(content)


def edit(path: Path, text: str) -> None:
    """Change a file by hand, later than the run."""
    path.write_text(text)
    os.utime(path, (time.time() + 10.0,) * 2)


def test_results_of_an_earlier_run_go_and_files_of_others_stay(tmp_path: Path) -> None:
    with claim(tmp_path, "diagnose", (), RESULTS) as place:
        (place / "figures" / "a.png").write(b"1")
        (place / "next.csv").write(b"1")
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "figures" / "mine.png").write_text("mine")
    run(tmp_path, "identify", other=b"1")
    run(tmp_path, report=b"2")
    assert seen(tmp_path) == {"report": b"2", "other": b"1", "notes.txt": b"mine", "figures/mine.png": b"mine"}


def test_a_result_that_was_changed_is_replaced_on_request_only(tmp_path: Path) -> None:
    with claim(tmp_path, "diagnose", (), RESULTS) as place:
        (place / "figures" / "a.png").write(b"1")
    edit(tmp_path / "figures" / "a.png", "annotated")
    with pytest.raises(InputRefused, match=r"a\.png: was changed after phnn wrote it.*--overwrite"):
        run(tmp_path, overwrite=False)
    # Where there is no such option none is advised.
    with pytest.raises(InputRefused, match=r"was changed after phnn wrote it: move it away, [^-]*--out$"):
        run(tmp_path)
    assert seen(tmp_path) == {"figures/a.png": b"annotated"}
    run(tmp_path, overwrite=True, report=b"2")
    assert seen(tmp_path) == {"report": b"2"}


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_file_that_phnn_did_not_write_is_never_replaced(tmp_path: Path, overwrite: bool) -> None:
    (tmp_path / "next.csv").write_text("mine")
    with pytest.raises(InputRefused, match=r"next\.csv: was not written by phnn"):
        run(tmp_path, overwrite=overwrite)
    with claim(tmp_path, "diagnose", (), ("report.html",), overwrite=overwrite) as place:
        for act in (lambda: (place / "next.csv").write(b"x"), lambda: (place / "next.csv").own_folder()):
            with pytest.raises(InputRefused, match=r"next\.csv: was not written by phnn"):
                act()
        (place / "next.csv").remove()
    assert seen(tmp_path) == {"next.csv": b"mine"}


def test_folders_that_are_read_are_not_written_to(tmp_path: Path) -> None:
    recordings = tmp_path / "rec"
    recordings.mkdir()
    (recordings / "a.csv").write_text("x")
    (tmp_path / "link").symlink_to(recordings)
    for out, words in (
        (recordings, "is"), (tmp_path, "contains"), (recordings / "deep" / "er", "lies in"), (tmp_path / "link", "is"),
        (tmp_path / "link" / "o", "lies in"), (recordings / ".." / "rec", "is"),
    ):  # fmt: skip
        with pytest.raises(InputRefused, match=f"{words} .*rec, from which this command reads"):
            claim(out, "predict", [recordings]).__enter__()
    with pytest.raises(InputRefused, match="from which this command reads"):
        claim(recordings, "predict", [recordings / "a.csv"]).__enter__()
    assert seen(tmp_path) == {"rec/a.csv": b"x"} and not (recordings / NOTES).exists()


def test_links_lead_nowhere(tmp_path: Path) -> None:
    out, kept = tmp_path / "o", tmp_path / "kept"
    (tmp_path / "precious").write_text("x")
    with claim(out, "diagnose", (), RESULTS) as place:
        (place / "figures" / "a.png").write(b"1")
    (out / "figures").rename(kept)
    (out / "figures").symlink_to(kept)
    with claim(out, "diagnose", (), RESULTS) as place:
        (out / "report.html").symlink_to(tmp_path / "precious")
        with pytest.raises(InputRefused, match="is a link that leads to"):
            (place / "figures" / "b.png").write(b"1")
        with pytest.raises(InputRefused, match="is a link, where a result must be written"):
            (place / "report.html").write(b"1")
    assert seen(kept) == {"a.png": b"1"} and (tmp_path / "precious").read_text() == "x"
    (tmp_path / "p").mkdir()
    (tmp_path / "p" / NOTES).symlink_to(kept)
    with pytest.raises(InputRefused, match="is a link that leads to"):
        run(tmp_path / "p")


def test_two_runs_do_not_share_a_folder(tmp_path: Path) -> None:
    with claim(tmp_path, "diagnose"), pytest.raises(InputRefused, match="another run of phnn writes there"):
        run(tmp_path, "identify")
    run(tmp_path, "identify")
    (tmp_path / "file").touch()
    with pytest.raises(InputRefused, match="is a file: name a folder"):
        run(tmp_path / "file")


def test_an_interrupted_run_leaves_its_mark_and_what_it_finished(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), claim(tmp_path, "diagnose", (), RESULTS) as place:
        (place / "figures" / "a.png").write(b"1")
        (tmp_path / "figures" / f".{'0b' * 8}.phnn.part").write_bytes(b"half")
        raise KeyboardInterrupt
    assert "phnn diagnose has begun here" in (tmp_path / INCOMPLETE).read_text()
    assert (tmp_path / "figures" / "a.png").exists() and not finished(tmp_path, "diagnose", Origin())
    run(tmp_path, report=b"1")
    assert seen(tmp_path) == {"report": b"1"} and finished(tmp_path, "diagnose", Origin())


def test_a_run_resumes_only_with_the_same_data_and_settings(tmp_path: Path) -> None:
    made = {"recordings": "abc", "seed": 1}
    with claim(tmp_path, "train", origin=Origin(made, resume=True)) as place:
        (place / "kept").write(b"1")
    with claim(tmp_path, "train", (), ("kept",), Origin(made, resume=True)):
        pass
    assert seen(tmp_path) == {"kept": b"1"}
    for command, other, words in (
        ("train", {"recordings": "abd", "seed": 1}, "other recordings: take"),
        ("train", {"recordings": "abc", "seed": 2}, "seed: 1 before, 2 now"),
        ("prove", made, "holds results of phnn train"),
    ):  # fmt: skip
        with pytest.raises(InputRefused, match=words):
            claim(tmp_path, command, origin=Origin(other, resume=True), overwrite=True).__enter__()


def test_a_full_disk_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    with claim(tmp_path, "diagnose", (), RESULTS) as place, monkeypatch.context() as m:
        (place / "report.html").write(b"1")
        m.setattr(os, "fsync", full)
        with pytest.raises(OutputFailed, match=r"report\.html: the disk is full") as caught:
            (place / "report.html").write(b"2")
        with watched(place, "diagnose", print) as progress:
            progress("a full disk stops no run here")
    assert caught.value.exit_status == 1 and seen(tmp_path) == {"report.html": b"1"}


def test_a_refused_run_leaves_a_folder_as_it_was(tmp_path: Path) -> None:
    def refused(out: Path) -> None:
        with (
            pytest.raises(InputRefused, match="no"),
            claim(out, "check", (), RESULTS) as place,
            watched(place, "check", print) as progress,
        ):
            progress("look")
            raise InputRefused("no")

    refused(tmp_path / "new")
    assert not (tmp_path / "new").exists()
    run(tmp_path / "old", "train", report=b"1")
    refused(tmp_path / "old")
    assert seen(tmp_path / "old") == {"report": b"1"} and finished(tmp_path / "old", "train", Origin())


@given(st.text(max_size=300))
def test_any_label_is_one_name_inside_the_folder(label: str) -> None:
    name = file_name(label)
    assert name == Path(name).name and name not in (".", "..") and not name.startswith(".")
    assert len(name.encode()) <= 180 and name.isprintable() and file_name(name) == name


@given(st.text(max_size=12) | st.binary(max_size=12).map(os.fsdecode))
def test_a_printed_name_is_one_line_of_utf8(name: str) -> None:
    shown = printable(name)
    assert printable(shown) == shown == shown.encode("utf-8").decode()
    assert len(shown.splitlines()) <= 1
    assert not any(ord(c) < 32 or 127 <= ord(c) < 160 for c in shown)
    assert name.isprintable() <= (shown == name)


@given(st.lists(st.sampled_from(["a", "A", "../a", "/a", "a\0", "a_2", "con", "CON", "", " ", "x" * 300]), unique=True))
def test_different_labels_get_different_names(labels: list[str]) -> None:
    names = unique_names(labels)
    assert list(names) == labels and len({n.casefold() for n in names.values()}) == len(labels)


@pytest.mark.parametrize("name", ["../victim/a", "{root}/victim/a", "figures/../../victim/a", ".", "", "../victim/"])
def test_a_planted_list_removes_nothing(tmp_path: Path, name: str) -> None:
    out, victim = tmp_path / "o", tmp_path / "victim"
    victim.mkdir()
    (victim / "a").write_text("x")
    run(out, report=b"1")
    path, name = out / NOTES / "manifest.json", name.format(root=tmp_path)
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {"files": {**content["files"], name: "diagnose"}}))
    Place(out, PurePosixPath(name)).remove()
    run(out, report=b"2")
    assert seen(tmp_path) == {"victim/a": b"x", "o/report": b"2"}


@pytest.mark.parametrize("content", [b"\xff\xfe\n{", b"[[[[", b'{"files": 3}', b"", b"[" * 100_000])
def test_a_damaged_list_counts_for_nothing(tmp_path: Path, content: bytes) -> None:
    run(tmp_path, **{"report.html": b"1"})
    (tmp_path / NOTES / "manifest.json").write_bytes(content)
    with pytest.raises(InputRefused, match=r"report\.html: was not written by phnn"):
        run(tmp_path)
    (tmp_path / "report.html").unlink()
    run(tmp_path, **{"report.html": b"2"})


def _write_many(place: Place, number: int) -> None:
    for index in range(20):
        (place / "figures" / f"{number}-{index}").write(b"1" * 100)


def test_processes_write_side_by_side(tmp_path: Path) -> None:
    with claim(tmp_path, "diagnose", (), RESULTS) as place:
        place = pickle.loads(pickle.dumps(place))
        workers = [multiprocessing.get_context("fork").Process(target=_write_many, args=(place, k)) for k in range(3)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        (place / "recordings").own_folder()
        (tmp_path / "recordings" / "a.csv").touch()
    assert len(seen(tmp_path)) == 61
    run(tmp_path)
    assert set(seen(tmp_path)) == {"recordings/a.csv"}


_KILLED = """
import sys, time
from pathlib import Path
from phnn.results import claim
with claim(Path(sys.argv[1]), "diagnose", (), ("a", "b", "c")) as place:
    print("begun", flush=True)
    for name in ("a", "b", "c"):
        (place / name).write(sys.argv[2].encode() * 100_000)
        time.sleep(0.005)
"""


@pytest.mark.parametrize("delay", [0.0, 0.01, *(pytest.param(d, marks=pytest.mark.slow) for d in (0.005, 0.02))])
def test_a_kill_leaves_whole_files_and_a_mark(tmp_path: Path, delay: float) -> None:
    def begin(word: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-c", _KILLED, str(tmp_path / "o"), word]
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    assert begin("1").wait() == 0
    second = begin("2")
    assert second.stdout is not None and second.stdout.readline() == "begun\n"
    time.sleep(delay)
    second.send_signal(signal.SIGKILL)
    second.wait()
    left = seen(tmp_path / "o")
    mixed = {content[:1] for name, content in left.items() if name in "abc"}
    assert len(mixed) == 1 or INCOMPLETE in left
    assert all(content in (b"1" * 100_000, b"2" * 100_000) for name, content in left.items() if name in "abc")
    assert begin("2").wait() == 0
    assert seen(tmp_path / "o") == dict.fromkeys("abc", b"2" * 100_000)
    assert not list(tmp_path.rglob("*.part"))


def test_progress_is_on_disk_while_a_run_goes_on_and_after_it_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("phnn.results._STEPS", 3)
    told: list[str] = []
    with (
        pytest.raises(SolverFailed),
        claim(tmp_path, "identify") as place,
        watched(place, "identify", told.append) as progress,
    ):
        for number in range(5):
            progress(str(number))
        raise SolverFailed("no solution")
    content = json.loads((tmp_path / PROGRESS).read_text())
    assert (content["schema"], content["command"]) == ("phnn.progress/1", "identify")
    assert [s["text"] for s in content["steps"]] == told[2:] and content["began"] <= content["steps"][0]["at"]
    with claim(tmp_path, "identify") as place, watched(place, "identify", told.append) as progress:
        progress("again")
    assert not (tmp_path / PROGRESS).exists()
