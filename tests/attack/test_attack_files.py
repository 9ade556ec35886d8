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
from attack_tools import HEADER, NETWORK, ROOT, Attack, csv, often, put, quick, rows
from hypothesis import given
from hypothesis import strategies as st

from phnn.intake import LIMITS, available_memory
from phnn.results import printable

ALLOWED = "--allow-outside"
NAMES = [
    "\x1b[31mred", "\x07", "two\nlines", "over\rwritten", "a\tb", "a\x7f", "a\x9b31m", os.fsdecode(b"\xff\xfe"),
    os.fsdecode("\u00e9".encode()[:1]), "\u202egnp", "a\u200bb", "\ufeffa", " ", "-rf", "--out", "...", "'", '"',
    "a\\b", "[red]a", "[link=file]a", "<script>", "{{ 7*7 }}", "{0.__class__}", "${oc.env:HOME}", "*", "$HOME", "a|b",
    "\U0001f600", "x" * 240, "con", "007", "2001-12-14", "true", "a\u0301" * 40,
]  # fmt: skip
# Text, and beside those what is no name of a file.
LABELS = [name for name in NAMES if not any(0xD800 <= ord(c) < 0xE000 for c in name)] + [
    "../small/a", "/tmp/phnn_attack", "..", ".", "a/b/c", "nul.csv", "a\x00b", "~/a", "x" * 400, "é" * 300,
    "${oc.env:PHNN_SECRET}", ".phnn", "INCOMPLETE.txt", "a;b", "|x",
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES, ids=range(len(NAMES)))
def test_names_of_files_and_folders(name: str, attack: Attack) -> None:
    folder = attack.root / f"d{name}"
    folder.mkdir()
    put(folder / f"{name}.csv", csv())
    for command in ("check", "predict"):
        attack(command, folder=folder)
    attack(folder=attack.root / f"absent{name}", words="there is no such folder")


@pytest.mark.parametrize("name", LABELS, ids=range(len(LABELS)))
def test_names_in_manifests(name: str, attack: Attack) -> None:
    put(attack.data / "b.csv", csv())
    quoted = '"' + name.encode("unicode_escape").decode().replace('"', '\\"') + '"'
    for entry in (
        "{file: %s}", "{file: a.csv, columns: {voltage: {column: %s, unit: V}}}",
        "{file: a.csv, ports: {%s: {column: voltage_V, unit: V}}}", "{file: a.csv, name: %s}, {file: b.csv, name: b}",
    ):  # fmt: skip
        attack(said=f"recordings: [{entry % quoted}]\n")
    # A name is a label: what is predicted lies in --out, side by side.
    outcome = attack("predict")
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
    "is a pipe, a socket or a device": {"a pipe": os.mkfifo, "a socket": bound, "zeros": link("/dev/zero")},
    "is a folder": {"a folder": Path.mkdir, "a link to a folder": link("/etc"), "a link upwards": link("..")},
    "no such file": {"a link to nothing": link("nowhere.csv")},
    "cannot be reached": {"a link to itself": lambda path: path.symlink_to(path.name)},
    "leads out of": {
        "memory": link("/proc/self/mem"), "passwords": link("/etc/passwd"), "a link outside": link("../outside.csv")},
    "may have at most": {"20 GB of nothing": sparse(20 * 10**9), "an exabyte": sparse(2**43)},
    "phnn: ": {
        "1 GB of nothing": sparse(10**9), "no permission": lambda path: (put(path, csv()), path.chmod(0)),
    },
}  # fmt: skip
OTHERS = {"network": "data/net.yaml", "model": "model/model.json", "manifest": "data/recordings.yaml",
          "--manifest": "model/m.yaml"}  # fmt: skip
SLOW = (".txt", ".npy", ".npz", ".mat", ".tdms", "manifest", "--manifest")


@pytest.mark.parametrize("what", quick([".csv", ".h5", "network", "model"], *SLOW))
@pytest.mark.parametrize(("words", "kind"), rows(KINDS))
def test_kinds_of_files(words: str, kind: str, what: str, attack: Attack) -> None:
    recording, path = what not in OTHERS, attack.root / OTHERS.get(what, f"data/a{what}")
    path.parent.mkdir(exist_ok=True)
    if recording:
        (attack.data / "a.csv").unlink()
    KINDS[words][kind](path)
    said = "setup: {network: net.yaml}" if what == "network" else None
    # Rights do not bind some users; a manifest that the user names may lie anywhere, and is quoted where it is wrong.
    unbound = recording and kind == "no permission" and os.geteuid() == 0
    named = path if what == "--manifest" else None
    attack("predict" if what == "model" else "check", said=said, manifest=named, words=None if unbound else "phnn: ")
    if recording:
        attack(said=f"recordings: [a{what}]\n", words=None if unbound else words)


@pytest.mark.parametrize("how", ["b.csv", "recordings: [a.csv, ../outside.csv]", "recordings: [a.csv, sub/b.csv]",
                                 "setup: {network: ../net.yaml}"])  # fmt: skip
def test_what_lies_outside_is_read_where_it_is_allowed(how: str, attack: Attack) -> None:
    (attack.root / "elsewhere").mkdir()
    put(attack.root / "elsewhere" / "b.csv", csv())
    put(attack.root / "net.yaml", NETWORK)
    linked, target = (how, "outside.csv") if how == "b.csv" else ("sub", "elsewhere")
    (attack.data / linked).symlink_to(attack.root / target)
    said = None if how == "b.csv" else how
    attack(said=said, words=ALLOWED)
    attack("check", ALLOWED, said=said, words="")


def test_a_link_to_the_folder_and_links_within_it_are_read(attack: Attack) -> None:
    (attack.data / "sub").mkdir()
    put(attack.data / "sub" / "real.csv", csv())
    (attack.data / "b.csv").symlink_to("sub/real.csv")
    (attack.root / "way").symlink_to(attack.data)
    attack(folder=attack.root / "way", words="")


DEVICES = ["/dev/null", "/dev/zero", "/proc/self/mem", "/etc/passwd", "/proc/self/fd"]


@pytest.mark.parametrize("folder", [*DEVICES, "/nowhere", "x" * 5000, "a\0b", ""])
@pytest.mark.parametrize("command", quick(["check", "predict"], "identify"))
def test_folders_that_are_none(command: str, folder: str, attack: Attack, monkeypatch: pytest.MonkeyPatch) -> None:
    (attack.root / "empty").mkdir()
    monkeypatch.chdir(attack.root / "empty")
    attack(command, folder=folder, words="phnn: ")
    if command == "predict":
        attack(command, model=folder or ".", words="phnn: ")


@often(100)
@given(name=st.text(max_size=12) | st.binary(max_size=12).map(os.fsdecode))
def test_a_printed_name_is_one_line_of_utf8(name: str) -> None:
    shown = printable(name)
    assert printable(shown) == shown == shown.encode("utf-8").decode()
    assert len(shown.splitlines()) <= 1
    assert not any(ord(c) < 32 or 127 <= ord(c) < 160 for c in shown)
    assert name.isprintable() <= (shown == name)


# By the command that takes them; those that count something are named in the refusal.
SETTINGS = {
    "identify": ("starts=1001", "workers=0", "starts=1e9", "starts=" + "9" * 400, "seed=-1"),
    "train": ("substeps=1025", "model.hysterons=21", "model.width=[1]", "stride=0", "folder=/dev/zero",
              "manifest=/dev/zero", "manifest=/etc/passwd", "base=/dev/zero", "base=/etc/passwd"),
}  # fmt: skip


@pytest.mark.parametrize(("command", "setting"), rows(SETTINGS))
def test_settings_beyond_the_limits(command: str, setting: str, attack: Attack) -> None:
    attack(command, setting, words=f"setting {setting.split('=')[0]}" if command == "identify" else "phnn: ")


def test_limits_are_documented_and_a_file_may_take_less_than_the_memory_that_is_available() -> None:
    text = (ROOT / "docs" / "limits.md").read_text(encoding="utf-8")
    for name, value in asdict(LIMITS).items():
        assert f"| `{name}` | {value:,} |" in text
    assert 0.0 < LIMITS.memory_share < 1.0 and available_memory() > 0


def test_a_folder_of_results_loses_nothing(attack: Attack) -> None:
    # A folder that is read stays as it is.
    (attack.root / "link").symlink_to(attack.data)
    for out in ("data", "link/new"):
        attack("predict", "--overwrite", out=attack.root / out, words="--out")
    # A changed result is replaced on request only.
    attack("predict", words="")
    first = (result := attack.root / "out" / "a.csv").read_bytes()
    put(result, "annotated")
    os.utime(result, (time.time() + 10.0,) * 2)
    attack("predict", words="--overwrite", kept=True)
    attack("predict", "--overwrite", words="", kept=True)
    assert result.read_bytes() == first
    # Predictions of other recordings stay.
    (attack.data / "a.csv").rename(attack.data / "c.csv")
    attack("predict", words="", kept=True)
    assert {p.name for p in result.parent.glob("[!.]*")} == {"a.csv", "c.csv", "predict.json"}


def test_a_proposal_of_somebody_else_stops_a_diagnosis_before_the_fit(attack: Attack) -> None:
    put(attack.root / "next_experiment.csv", "mine")
    attack("diagnose", folder=campaigns.concealed()[0], out=attack.root, words="phnn: ")
    assert (attack.root / "next_experiment.csv").read_text() == "mine"


@pytest.mark.skipif(not hasattr(os, "getuid") or os.getuid() == 0, reason="rights do not bind this user")
def test_a_folder_without_rights_is_met_before_the_work(attack: Attack) -> None:
    (attack.root / "out").mkdir(mode=0o500)
    attack("predict", out=attack.root / "out" / "new", kept=True, words="choose another folder")


@pytest.mark.parametrize("options", ["size=1m", "size=4m", "size=64m ro"])
def test_a_disk_that_does_not_take_it_is_met_before_the_work(
    options: str, attack: Attack, disk: Callable[[str], Path]
) -> None:
    folder = [disk(option) for option in options.split()][-1]
    attack("predict", out=folder, words="choose another folder" if "ro" in options else "MiB of disk are free")
