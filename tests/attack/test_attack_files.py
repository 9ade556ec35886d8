"""Hostile names, kinds of files and settings: nothing outside is opened or written, nothing runs without bound."""

from __future__ import annotations

import contextlib
import os
import socket
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import campaigns
import pytest
from attack_tools import HEADER, NETWORK, REFUSED, Attack, Outcome, check_printed, csv, often, put, quick, rows
from hypothesis import given
from hypothesis import strategies as st

from phnn.cli import main
from phnn.intake import LIMITS, available_memory
from phnn.models.store import FILE
from phnn.results import printable

ROOT = Path(__file__).resolve().parents[2]
ALLOWED = "--allow-outside"
NAMES = [
    "\x1b[31mred", "\x07", "two\nlines", "over\rwritten", "a\tb", "a\x7f", "a\x9b31m", os.fsdecode(b"\xff\xfe"),
    os.fsdecode("\u00e9".encode()[:1]), "\u202egnp", "a\u200bb", "\ufeffa", " ", "-rf", "--out", "...", "'", '"',
    "a\\b", "[red]a", "[link=file]a", "<script>", "{{ 7*7 }}", "{0.__class__}", "${oc.env:HOME}", "*", "$HOME", "a|b",
    "\U0001f600", "x" * 240, "con", "007", "2001-12-14", "true", "a\u0301" * 40,
]  # fmt: skip
# Beside those: what is no name of a file.
LABELS = [
    "../small/a", "/tmp/phnn_attack", "..", ".", "a/b/c", "nul.csv", "a\x00b", "~/a", "x" * 400, "é" * 300,
    "${oc.env:PHNN_SECRET}", ".phnn", "INCOMPLETE.txt", "a;b", "|x",
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES, ids=range(len(NAMES)))
def test_names_of_files_and_folders(name: str, attack: Attack, tmp_path: Path, model: Path) -> None:
    folder = tmp_path / f"d{name}"
    folder.mkdir()
    put(folder / f"{name}.csv", csv())
    for command in ("check", "predict"):
        attack(folder, command)
    attack(tmp_path / f"absent{name}", words="there is no such folder")


@pytest.mark.parametrize("name", [*NAMES, *LABELS], ids=range(len([*NAMES, *LABELS])))
def test_names_in_manifests(name: str, attack: Attack, good: Path, model: Path) -> None:
    if any(0xD800 <= ord(c) < 0xE000 for c in name):
        pytest.skip("yaml holds text")
    put(good / "b.csv", csv())
    for entry in (
        "{file: %s}",
        "{file: a.csv, columns: {voltage: {column: %s, unit: V}}}",
        "{file: a.csv, ports: {%s: {column: voltage_V, unit: V}}}",
        "{file: a.csv, name: %s}, {file: b.csv, name: b}",
    ):
        quoted = '"' + name.encode("unicode_escape").decode().replace('"', '\\"') + '"'
        put(good / "recordings.yaml", f"recordings: [{entry % quoted}]\n")
        attack(good)
    # A name is a label: what is predicted lies in --out, side by side.
    outcome = attack(good, "predict")
    written = [n for n in outcome.written if not n.startswith(".phnn") and n != "predict.json"]
    assert len(written) == (2 if outcome.status == 0 else 0)
    assert all(n.count("/") == 0 and n.endswith(".csv") for n in written)


def link(target: str) -> Callable[[Path], object]:
    """Return what makes a link to this."""
    return lambda path: path.symlink_to(target)


def sparse(size: int) -> Callable[[Path], object]:
    """Return what makes a file of this size, nothing of which takes room."""
    return lambda path: (put(path, HEADER + "\n"), os.truncate(path, size))


def bound(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as s, contextlib.chdir(path.parent):
        s.bind(path.name)


# What is no file, by the words of the refusal where it is named.
KINDS: dict[str, dict[str, Callable[[Path], object]]] = {
    "is a pipe, a socket or a device": {
        "a pipe": os.mkfifo, "a socket": bound,
        "zeros": link("/dev/zero"), "a terminal": link("/dev/tty"), "standard input": link("/dev/stdin"),
    },
    "is a folder": {"a folder": Path.mkdir, "a link to a folder": link("/etc"), "a link upwards": link("..")},
    "no such file": {"a link to nothing": link("nowhere.csv")},
    "cannot be reached": {"a link to itself": lambda path: path.symlink_to(path.name)},
    "leads out of": {
        "memory": link("/proc/self/mem"), "the environment": link("/proc/self/environ"),
        "passwords": link("/etc/passwd"), "a link outside": link("../outside.csv"), "a host": link("/etc/hostname"),
    },
    "may have at most": {"20 GB of nothing": sparse(20 * 10**9), "an exabyte": sparse(2**43)},
    "phnn: ": {
        "1 GB of nothing": sparse(10**9), "100 MB of nothing": sparse(10**8),
        "no permission": lambda path: (put(path, csv()), path.chmod(0)),
    },
}  # fmt: skip


@pytest.mark.parametrize("suffix", quick([".csv", ".h5"], ".txt", ".npy", ".npz", ".mat", ".tdms"))
@pytest.mark.parametrize(("words", "kind"), rows(KINDS))
def test_kinds_of_files(words: str, kind: str, suffix: str, attack: Attack, tmp_path: Path) -> None:
    folder = tmp_path / "data"
    folder.mkdir()
    KINDS[words][kind](folder / f"a{suffix}")
    # Rights do not bind some users.
    bound_by_rights = kind != "no permission" or os.geteuid() != 0
    attack(folder, words="phnn: " if bound_by_rights else None)
    put(folder / "recordings.yaml", f"recordings: [a{suffix}]\n")
    attack(folder, words=words if bound_by_rights else None)


@pytest.mark.parametrize(("words", "kind"), rows(KINDS))
@pytest.mark.parametrize("what", quick(["network", "model"], "manifest", "--manifest"))
def test_kinds_of_other_files(what: str, words: str, kind: str, attack: Attack, good: Path, tmp_path: Path) -> None:
    beside = tmp_path / "model"
    beside.mkdir()
    if what == "network":
        put(good / "recordings.yaml", "setup: {network: net.yaml}")
    places = {"manifest": good / "recordings.yaml", "network": good / "net.yaml", "model": beside / FILE}
    KINDS[words][kind](path := places.get(what, beside / "m.yaml"))
    # A manifest that the user names may lie anywhere, and is quoted where it is wrong.
    named = path if what == "--manifest" else None
    attack(good, "predict" if what == "model" else "check", words="phnn: ", manifest=named)


@pytest.mark.parametrize("how", ["b.csv", "recordings: [a.csv, ../outside.csv]", "recordings: [a.csv, sub/b.csv]",
                                 "setup: {network: ../net.yaml}"])  # fmt: skip
def test_what_lies_outside_is_read_where_it_is_allowed(how: str, attack: Attack, good: Path, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    put(tmp_path / "elsewhere" / "b.csv", csv())
    put(tmp_path / "net.yaml", NETWORK)
    if how == "b.csv":
        (good / how).symlink_to(tmp_path / "outside.csv")
    else:
        (good / "sub").symlink_to(tmp_path / "elsewhere")
        put(good / "recordings.yaml", how)
    attack(good, words=ALLOWED)
    attack(good, "check", ALLOWED, words="")


def test_a_link_to_the_folder_and_links_within_it_are_read(attack: Attack, good: Path, tmp_path: Path) -> None:
    (good / "sub").mkdir()
    put(good / "sub" / "real.csv", csv())
    (good / "b.csv").symlink_to("sub/real.csv")
    (tmp_path / "way").symlink_to(good)
    attack(tmp_path / "way", words="")


@pytest.mark.parametrize(
    "folder",
    ["/dev/null", "/dev/zero", "/proc/self/mem", "/nowhere", "x" * 5000, "a\0b", "", "/etc/passwd", "/proc/self/fd"],
)
@pytest.mark.parametrize("command", quick(["check", "predict"], "identify"))
def test_folders_that_are_none(
    command: str, folder: str, attack: Attack, good: Path, model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (good / "empty").mkdir()
    monkeypatch.chdir(good / "empty")
    attack(folder, command, words="phnn: ")
    if command == "predict":
        attack(good, command, model=folder or ".", words="phnn: ")


@often(100)
@given(name=st.text(max_size=12) | st.binary(max_size=12).map(os.fsdecode))
def test_a_printed_name_is_one_line_of_utf8(name: str) -> None:
    shown = printable(name)
    assert printable(shown) == shown
    assert shown.encode("utf-8").decode() == shown
    assert len(shown.splitlines()) <= 1
    assert not any(ord(c) < 32 or 127 <= ord(c) < 160 for c in shown)
    assert name.isprintable() <= (shown == name)


COUNTS = (
    "starts=1001", "workers=257", "workers=0", "starts=1e9", "starts=" + "9" * 400, "seed=" + "9" * 400, "seed=-1",
)  # fmt: skip
TRAINING = ("substeps=1025", "model.hysterons=21", "model.hysterons=-1", "model.hysterons=two", "model.width=4097",
            "model.width=[1]", "model.spring_width=1e9", "seed=" + "9" * 30, "stride=0", "folder=/dev/zero",
            "manifest=/dev/zero", "manifest=/etc/passwd", "base=/dev/zero", "base=/etc/passwd")  # fmt: skip


@pytest.mark.parametrize("setting", COUNTS)
def test_counts_beyond_the_limits(setting: str, attack: Attack, good: Path) -> None:
    attack(good, "identify", setting, words=f"setting {setting.split('=')[0]}")


@pytest.mark.parametrize("setting", TRAINING)
def test_training_beyond_the_limits(setting: str, good: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", f"folder={good}", f"out={good.parent / 'out'}", setting]) == REFUSED
    check_printed(Outcome(REFUSED, *capsys.readouterr(), ()))


def test_limits_are_documented_and_a_file_may_take_less_than_the_memory_that_is_available() -> None:
    text = (ROOT / "docs" / "limits.md").read_text(encoding="utf-8")
    for name, value in asdict(LIMITS).items():
        assert f"| `{name}` | {value:,} |" in text
    assert 0.0 < LIMITS.memory_share < 1.0 and available_memory() > 0


@pytest.mark.parametrize("out", ["data", "link/new"])
def test_folders_that_are_read_stay_as_they_are(out: str, attack: Attack, good: Path, model: Path) -> None:
    (good.parent / "link").symlink_to(good)
    attack(good, "predict", "--overwrite", out=good.parent / out, words="--out")


def test_a_changed_result_is_replaced_on_request_only(attack: Attack, good: Path, model: Path) -> None:
    attack(good, "predict", words="")
    result = good.parent / "out" / "a.csv"
    first = result.read_bytes()
    put(result, "annotated")
    os.utime(result, (time.time() + 10.0,) * 2)
    attack(good, "predict", words="--overwrite", kept=True)
    attack(good, "predict", "--overwrite", words="", kept=True)
    assert result.read_bytes() == first


def test_predictions_of_another_folder_stay(attack: Attack, good: Path, model: Path) -> None:
    attack(good, "predict", words="")
    (good / "a.csv").rename(good / "c.csv")
    attack(good, "predict", words="", kept=True)
    assert {p.name for p in (good.parent / "out").glob("[!.]*")} == {"a.csv", "c.csv", "predict.json"}


def test_a_proposal_of_somebody_else_stops_a_diagnosis_before_the_fit(attack: Attack, tmp_path: Path) -> None:
    put(tmp_path / "next_experiment.csv", "mine")
    attack(campaigns.concealed()[0], "diagnose", out=tmp_path, words="phnn: ")
    assert (tmp_path / "next_experiment.csv").read_text() == "mine"


@pytest.mark.skipif(not hasattr(os, "getuid") or os.getuid() == 0, reason="rights do not bind this user")
def test_a_folder_without_rights_is_met_before_the_work(attack: Attack, good: Path, model: Path) -> None:
    (good.parent / "out").mkdir(mode=0o500)
    attack(good, "predict", out=good.parent / "out" / "new", kept=True, words="choose another folder")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["size=1m"], "MiB of disk are free"),
        (["size=4m"], "MiB of disk are free"),
        (["size=64m", "ro"], "choose another folder"),
    ],
)
def test_a_disk_that_does_not_take_it_is_met_before_the_work(
    options: list[str], words: str, attack: Attack, good: Path, model: Path, disk: Callable[[str], Path]
) -> None:
    for option in options:
        folder = disk(option)
    attack(good, "predict", out=folder, words=words)
