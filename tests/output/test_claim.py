"""A folder of results: claimed for one run, marked until it is whole, never a stranger's file in its way."""

from __future__ import annotations

import json
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from phnn.errors import InputRefused, OutputFailed
from phnn.output import Origin, Place, claim, file_name, finished, unique_names
from phnn.output.claim import INCOMPLETE

RESULTS = ("report.html", "figures", "next.csv")


def seen(folder: Path) -> dict[str, bytes]:
    """Files of a folder but for phnn's own notes."""
    found = (p for p in folder.rglob("*") if p.is_file() and ".phnn" not in p.parts)
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in found}


def test_results_of_an_earlier_run_go_and_files_of_others_stay(tmp_path: Path) -> None:
    with claim(tmp_path / "o", "diagnose", (), RESULTS) as place:
        (place / "report.html").write(b"1")
        (place / "next.csv").write(b"1")
        (place / "figures" / "a.png").write(b"1")
        assert INCOMPLETE in seen(tmp_path / "o")
    (tmp_path / "o" / "notes.txt").write_text("mine")
    (tmp_path / "o" / "figures" / "mine.png").write_text("mine")
    with claim(tmp_path / "o", "diagnose", (), RESULTS) as place:
        (place / "report.html").write(b"2")
    assert seen(tmp_path / "o") == {"report.html": b"2", "notes.txt": b"mine", "figures/mine.png": b"mine"}


def test_half_a_file_of_a_worker_that_was_killed_goes_at_the_end(tmp_path: Path) -> None:
    with claim(tmp_path, "prove", (), RESULTS) as place:
        (place / "figures" / "a.png").write(b"1")
        (tmp_path / "figures" / f".{'0b' * 8}.part").write_bytes(b"half")
    assert seen(tmp_path) == {"figures/a.png": b"1"}


def test_a_result_that_was_changed_is_kept_and_not_removed(tmp_path: Path) -> None:
    with claim(tmp_path, "diagnose", (), RESULTS) as place:
        (place / "report.html").write(b"1")
        (place / "next.csv").write(b"1")
    (tmp_path / "report.html").write_text("annotated")
    with pytest.raises(InputRefused, match=r"report\.html: was changed after phnn wrote it.*--overwrite"):
        claim(tmp_path, "diagnose", (), RESULTS, overwrite=False).__enter__()
    # Where there is no such option none is advised.
    with pytest.raises(InputRefused, match=r"was changed after phnn wrote it: move it away, [^-]*--out$"):
        claim(tmp_path, "diagnose", (), RESULTS).__enter__()
    with claim(tmp_path, "diagnose", (), RESULTS, overwrite=True) as place:
        (place / "report.html").write(b"2")
    assert seen(tmp_path) == {"report.html": b"2"}


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_file_that_phnn_did_not_write_is_never_replaced(tmp_path: Path, overwrite: bool) -> None:
    (tmp_path / "next.csv").write_text("mine")
    with pytest.raises(InputRefused, match=r"next\.csv: was not written by phnn"):
        claim(tmp_path, "diagnose", (), RESULTS, overwrite=overwrite).__enter__()
    with claim(tmp_path, "diagnose", (), ("report.html",), overwrite=overwrite) as place:
        with pytest.raises(InputRefused, match=r"next\.csv: was not written by phnn"):
            (place / "next.csv").write(b"x")
        with pytest.raises(InputRefused, match="is not of phnn's making"):
            (place / "next.csv").own_folder()
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
    assert seen(tmp_path) == {"rec/a.csv": b"x"} and not (recordings / ".phnn").exists()


def test_links_lead_nowhere(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "precious").write_text("x")
    with claim(tmp_path / "o", "diagnose") as place:
        (tmp_path / "o" / "figures").symlink_to(tmp_path / "elsewhere")
        (tmp_path / "o" / "report.html").symlink_to(tmp_path / "precious")
        with pytest.raises(InputRefused, match="is a link that leads to"):
            (place / "figures" / "a.png").write(b"1")
        with pytest.raises(InputRefused, match="is a link, where a result must be written"):
            (place / "report.html").write(b"1")
    assert not list((tmp_path / "elsewhere").iterdir())
    assert (tmp_path / "precious").read_text() == "x"


def test_two_runs_do_not_share_a_folder(tmp_path: Path) -> None:
    with claim(tmp_path, "diagnose"), pytest.raises(InputRefused, match="another run of phnn writes there"):
        claim(tmp_path, "identify").__enter__()
    with claim(tmp_path, "identify"):
        pass


def test_an_interrupted_run_leaves_its_mark_and_what_it_finished(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), claim(tmp_path, "diagnose", (), RESULTS) as place:
        (place / "figures" / "a.png").write(b"1")
        raise KeyboardInterrupt
    told = (tmp_path / INCOMPLETE).read_text()
    assert "phnn diagnose has begun here" in told and "figures/a.png" in told
    assert not finished(tmp_path, "diagnose", Origin({}))
    with claim(tmp_path, "diagnose", (), RESULTS) as place:
        (place / "report.html").write(b"1")
    assert seen(tmp_path) == {"report.html": b"1"}
    assert finished(tmp_path, "diagnose", Origin({}))


def test_a_run_goes_on_only_with_the_same_data_and_settings(tmp_path: Path) -> None:
    made = {"recordings": "abc", "seed": 1}
    with claim(tmp_path, "train", origin=Origin(made, resume=True)) as place:
        (place / "kept").write(b"1")
    with claim(tmp_path, "train", (), ("kept",), Origin(made, resume=True)):
        pass
    assert seen(tmp_path) == {"kept": b"1"}
    for other, words in (
        ({"recordings": "abd", "seed": 1}, "other recordings: take"),
        ({"recordings": "abc", "seed": 2}, "seed: 1 before"),
    ):  # fmt: skip
        with pytest.raises(InputRefused, match=words):
            claim(tmp_path, "train", origin=Origin(other, resume=True)).__enter__()
    with pytest.raises(InputRefused, match="holds results of phnn train"):
        claim(tmp_path, "prove", origin=Origin(made, resume=True)).__enter__()


def test_a_full_disk_is_met_before_the_work_and_named_during_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    with claim(tmp_path, "diagnose", (), RESULTS) as place:
        (place / "figures" / "a.png").write(b"1")
        with monkeypatch.context() as m:
            m.setattr(os, "fsync", full)
            with pytest.raises(OutputFailed, match=r"report\.html: the disk is full") as caught:
                (place / "report.html").write(b"1")
        assert caught.value.exit_status == 1
    assert not list(tmp_path.rglob("*.part"))
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputRefused, match="the disk is full"):
        claim(tmp_path, "diagnose").__enter__()


@given(st.text(max_size=300))
def test_any_label_is_one_name_inside_the_folder(label: str) -> None:
    name = file_name(label)
    assert name == Path(name).name and name not in (".", "..") and not name.startswith(".")
    assert len(name.encode()) <= 180 and name.isprintable()
    assert file_name(name) == name


@given(st.lists(st.sampled_from(["a", "A", "../a", "/a", "a\0", "a_2", "con", "CON", "", " ", "x" * 300]), unique=True))
def test_different_labels_get_different_names(labels: list[str]) -> None:
    names = unique_names(labels)
    assert list(names) == labels
    assert len({n.casefold() for n in names.values()}) == len(labels)


def _write_many(place: Place, number: int) -> None:
    for index in range(50):
        (place / f"{number}-{index}").write(f"{number} {index}".encode() * 100)


def test_processes_write_side_by_side(tmp_path: Path) -> None:
    with claim(tmp_path, "prove") as place:
        place = pickle.loads(pickle.dumps(place))
        workers = [multiprocessing.get_context("fork").Process(target=_write_many, args=(place, k)) for k in range(3)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
    assert len(seen(tmp_path)) == 150
    with claim(tmp_path, "prove", (), [f"{k}-{i}" for k in range(3) for i in range(50)]):
        pass
    assert seen(tmp_path) == {}


_KILLED = """
import sys, time
from pathlib import Path
from phnn.output import claim
out = Path(sys.argv[1])
with claim(out, "diagnose", (), ("a", "b", "c")) as place:
    print("begun", flush=True)
    for name in ("a", "b", "c"):
        (place / name).write(sys.argv[2].encode() * 100_000)
        time.sleep(0.005)
"""


@pytest.mark.parametrize("delay", [0.0, 0.004, 0.008, 0.012])
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
    found = seen(tmp_path / "o")
    mixed = {content[:1] for name, content in found.items() if name in "abc"}
    assert len(mixed) == 1 or INCOMPLETE in found
    assert all(content in (b"1" * 100_000, b"2" * 100_000) for name, content in found.items() if name in "abc")
    assert begin("2").wait() == 0
    assert seen(tmp_path / "o") == dict.fromkeys("abc", b"2" * 100_000)
    assert not list(tmp_path.rglob("*.part"))


@pytest.mark.parametrize("name", ["../victim", "{root}/victim", ".", "", "a/../../victim", ".phnn/lock"])
@pytest.mark.parametrize("digest", ["", "0" * 64])
def test_a_planted_record_removes_nothing(tmp_path: Path, name: str, digest: str) -> None:
    out, victim = tmp_path / "o", tmp_path / "victim"
    victim.mkdir()
    (victim / "a").write_text("x")
    with claim(out, "diagnose", (), RESULTS) as place:
        (place / "report.html").write(b"1")
    (out / "mine").write_text("mine")
    line = json.dumps({"file": name.format(root=tmp_path), "sha256": digest, "by": "diagnose"})
    with (out / ".phnn" / "written.jsonl").open("a") as file:
        file.write(line + "\n")
    with claim(out, "diagnose", (), (*RESULTS, "victim")) as place:
        (place / "report.html").write(b"2")
    assert seen(tmp_path) == {"victim/a": b"x", "o/report.html": b"2", "o/mine": b"mine"}


def test_what_was_moved_away_behind_a_link_stays(tmp_path: Path) -> None:
    with claim(tmp_path / "o", "diagnose", (), RESULTS) as place:
        (place / "figures" / "a.png").write(b"1")
    (tmp_path / "o" / "figures").rename(tmp_path / "kept")
    (tmp_path / "o" / "figures").symlink_to(tmp_path / "kept")
    with claim(tmp_path / "o", "diagnose", (), RESULTS):
        pass
    assert (tmp_path / "kept" / "a.png").read_bytes() == b"1"


def test_commands_in_one_folder_keep_one_anothers_results(tmp_path: Path) -> None:
    for command, result in (("identify", "a"), ("diagnose", "b"), ("diagnose", "b"), ("check", "c"), ("check", "c")):
        with claim(tmp_path, command, (), (result,)) as place:
            (place / result).write(command.encode())
    assert seen(tmp_path) == {"a": b"identify", "b": b"diagnose", "c": b"check"}


def test_a_refused_run_leaves_a_folder_as_it_was(tmp_path: Path) -> None:
    def refused(out: Path, mine: str = "") -> None:
        with pytest.raises(InputRefused, match="no"), claim(out, "check", (), RESULTS):
            if mine:
                (out / mine).write_text("mine")
            raise InputRefused("no")

    refused(tmp_path / "new")
    assert not (tmp_path / "new").exists()
    refused(tmp_path / "new", "notes.txt")
    assert seen(tmp_path / "new") == {"notes.txt": b"mine"}
    with claim(tmp_path / "old", "train", (), RESULTS, Origin({"a": 1})) as place:
        (place / "next.csv").write(b"1")
    refused(tmp_path / "old")
    assert seen(tmp_path / "old") == {"next.csv": b"1"}
    assert finished(tmp_path / "old", "train", Origin({"a": 1}))


def test_beginning_anew_is_never_going_on(tmp_path: Path) -> None:
    with claim(tmp_path, "prove", origin=Origin({"seed": 1}, resume=True)) as place:
        (place / "answer").write(b"1")
    with pytest.raises(InputRefused, match="seed: 1 before, 2 now"):
        claim(tmp_path, "prove", origin=Origin({"seed": 2}, resume=True), overwrite=True).__enter__()


def test_halves_of_files_go_from_folders_of_its_own_too(tmp_path: Path) -> None:
    with claim(tmp_path, "demo", (), ("recordings",)) as place:
        folder = (place / "recordings").own_folder()
        (folder / "a.csv").write_bytes(b"1")
    (folder / f".{'0a' * 8}.part").write_bytes(b"half")
    with claim(tmp_path, "demo", (), ("recordings",)) as place:
        assert [p.name for p in (place / "recordings").own_folder().iterdir()] == ["a.csv"]
