"""Hostile names, kinds of files, paths and settings: nothing outside is opened, nothing runs without bound."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

import pytest
from attack_tools import Attack, csv, often, put, quick
from hypothesis import given
from hypothesis import strategies as st

from phnn.cli import main
from phnn.intake import LIMITS, available_memory
from phnn.models.actuator import hrc
from phnn.models.store import FILE, save
from phnn.results import printable
from phnn.setup import Setup

NAMES = [
    "\x1b[31mred", "\x07", "two\nlines", "over\rwritten", "a\tb", "a\x7f", "a\x9b31m", os.fsdecode(b"\xff\xfe"),
    os.fsdecode("\u00e9".encode()[:1]), "\u202egnp", "a\u200bb", "\ufeffa", " ", "-rf", "--out", "...", "'", '"',
    "a\\b", "[red]a", "[link=file]a", "<script>", "{{ 7*7 }}", "{0.__class__}", "${oc.env:HOME}", "*", "$HOME", "a|b",
    "\U0001f600", "x" * 240, "con", "007", "2001-12-14", "true", "a\u0301" * 40,
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES, ids=range(len(NAMES)))
def test_names_of_files_and_folders(name: str, attack: Attack, tmp_path: Path) -> None:
    save(Setup(hrc(1)), tmp_path / "model")
    folder = tmp_path / f"d{name}"
    folder.mkdir()
    put(folder / f"{name}.csv", csv())
    for command in ("check", "predict"):
        attack(folder, command, model=tmp_path / "model")
    attack(tmp_path / f"absent{name}")


@pytest.mark.parametrize("name", NAMES, ids=range(len(NAMES)))
def test_names_in_manifests(name: str, attack: Attack, good: Path) -> None:
    if any(0xD800 <= ord(c) < 0xE000 for c in name):
        pytest.skip("yaml holds text")
    for entry in (
        "{file: %s}",
        "{file: a.csv, name: %s}",
        "{file: a.csv, columns: {voltage: {column: %s, unit: V}}}",
        "{file: a.csv, ports: {%s: {column: voltage_V, unit: V}}}",
    ):
        quoted = '"' + name.encode("unicode_escape").decode().replace('"', '\\"') + '"'
        put(good / "recordings.yaml", f"recordings: [{entry % quoted}]\n")
        attack(good)


def link(target: str) -> Callable[[Path], object]:
    return lambda path: path.symlink_to(target)


def fifo(path: Path) -> None:
    os.mkfifo(path)


def bound(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as s, contextlib.chdir(path.parent):
        s.bind(path.name)


def sparse(size: int) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        with path.open("wb") as file:
            file.write(b"time_s,voltage_V,displacement_m\n")
            file.truncate(size)

    return make


def unreadable(path: Path) -> None:
    put(path, csv())
    path.chmod(0)


KINDS: dict[str, Callable[[Path], object]] = {
    "a pipe": fifo, "a socket": bound, "a folder": Path.mkdir, "a link to nothing": link("nowhere.csv"),
    "a link to itself": link("a.csv"), "a link to zeros": link("/dev/zero"), "a link to a terminal": link("/dev/tty"),
    "a link to standard input": link("/dev/stdin"), "a link to memory": link("/proc/self/mem"),
    "a link to the environment": link("/proc/self/environ"), "a link to passwords": link("/etc/passwd"),
    "a link to a folder": link("/etc"), "a link outside": link("../outside.csv"),
    "an absolute link": link("/etc/hostname"), "a link upwards": link(".."), "20 GB of nothing": sparse(20 * 10**9),
    "1 GB of nothing": sparse(10**9), "100 MB of nothing": sparse(10**8), "an exabyte": sparse(2**43),
    "no permission": unreadable,
}  # fmt: skip
SUFFIXES = quick([".csv", ".h5"], ".txt", ".npy", ".npz", ".mat", ".tdms")


@pytest.fixture(autouse=True)
def _restored(tmp_path: Path) -> Iterator[None]:
    put(tmp_path / "outside.csv", csv())
    yield
    for path in tmp_path.rglob("*"):
        if not path.is_symlink():
            path.chmod(0o700)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("kind", KINDS)
def test_kinds_of_files(kind: str, suffix: str, attack: Attack, tmp_path: Path) -> None:
    folder = tmp_path / "data"
    folder.mkdir()
    KINDS[kind](folder / f"a{suffix}")
    outcome = attack(folder)
    if not (kind == "no permission" and os.geteuid() == 0):
        assert outcome.refused
    assert "root:" not in outcome.err
    put(folder / "recordings.yaml", f"recordings: [a{suffix}]\n")
    assert attack(folder).refused or (kind == "no permission" and os.geteuid() == 0)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("what", quick(["network", "model"], "manifest", "--manifest"))
def test_kinds_of_other_files(what: str, kind: str, attack: Attack, good: Path, tmp_path: Path) -> None:
    beside = tmp_path / "beside"
    beside.mkdir()
    if what == "network":
        put(good / "recordings.yaml", "setup: {network: net.yaml}")
    places = {"manifest": good / "recordings.yaml", "network": good / "net.yaml", "model": beside / FILE}
    path = places.get(what, beside / "m.yaml")
    KINDS[kind](path)
    if what == "model":
        outcome = attack(good, "predict", model=beside)
    else:
        outcome = attack(good, manifest=path if what == "--manifest" else None)
    assert outcome.refused
    # A manifest that the user names may lie anywhere, and is quoted where it is wrong.
    assert what == "--manifest" or "root:" not in outcome.err


PATHS = (
    "../outside.csv", "/etc/passwd", "../../../../../../etc/passwd", "sub/../../outside.csv", "./../outside.csv",
    "/dev/zero", "/proc/self/environ", "..", ".", "/", "~/x.csv", "a.csv/../../outside.csv", "nowhere/../a.csv",
    "x" * 300 + ".csv", "y/" * 3000 + "a.csv", "\\\\server\\share.csv", "file:///etc/passwd",
    "http://example.org/a.csv",
)  # fmt: skip


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize(
    "entry",
    ["recordings: [{file: '%s'}]", "recordings: [{file: [a.csv, '%s']}]", "setup: {network: '%s'}", "setup: '%s'"],
)
def test_paths_in_manifests(entry: str, path: str, attack: Attack, good: Path) -> None:
    put(good / "recordings.yaml", entry % path)
    outcome = attack(good)
    assert outcome.refused
    assert "root:" not in outcome.err


@pytest.mark.parametrize("how", ["link", "path", "folder", "network"])
def test_what_lies_outside_is_read_where_it_is_allowed(how: str, attack: Attack, good: Path, tmp_path: Path) -> None:
    if how == "link":
        (good / "b.csv").symlink_to(tmp_path / "outside.csv")
    elif how == "folder":
        (tmp_path / "elsewhere").mkdir()
        put(tmp_path / "elsewhere" / "b.csv", csv())
        (good / "sub").symlink_to(tmp_path / "elsewhere")
        put(good / "recordings.yaml", "recordings: [a.csv, sub/b.csv]")
    elif how == "network":
        put(tmp_path / "net.yaml", NETWORK)
        put(good / "recordings.yaml", "setup: {network: ../net.yaml}")
    else:
        put(good / "recordings.yaml", "recordings: [a.csv, ../outside.csv]")
    outcome = attack(good)
    assert outcome.refused
    assert "--allow-outside" in outcome.err
    assert attack(good, more=("--allow-outside",)).status == 0


NETWORK = """junctions: {mass: 1}
elements:
  q: {type: C, junction: mass, law: spring, parameters: [k], unit: m}
  p: {type: I, junction: mass, parameters: [k]}
  u: {type: Se, junction: mass, unit: V}
parameters: {k: {value: 1.0, positive: true}}
output: q
"""


def test_a_link_to_the_folder_and_links_within_it_are_read(attack: Attack, good: Path, tmp_path: Path) -> None:
    (good / "sub").mkdir()
    put(good / "sub" / "real.csv", csv())
    (good / "b.csv").symlink_to("sub/real.csv")
    (tmp_path / "way").symlink_to(good)
    assert attack(tmp_path / "way").status == 0


@pytest.mark.parametrize(
    "folder",
    ["/dev/null", "/dev/zero", "/proc/self/mem", "/nowhere", "x" * 5000, "a\0b", "", "/etc/passwd", "/proc/self/fd"],
)
@pytest.mark.parametrize("command", quick(["check", "predict"], "identify"))
def test_folders_that_are_none(
    command: str, folder: str, attack: Attack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save(Setup(hrc(1)), tmp_path / "model")
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    assert attack(folder, command, model=tmp_path / "model").refused
    assert attack(tmp_path / "empty", command, model=Path(folder)).refused


@often(100)
@given(name=st.text(max_size=12) | st.binary(max_size=12).map(os.fsdecode))
def test_a_printed_name_is_one_line_of_utf8(name: str) -> None:
    shown = printable(name)
    assert printable(shown) == shown
    assert shown.encode("utf-8").decode() == shown
    assert len(shown.splitlines()) <= 1
    assert not any(ord(c) < 32 or 127 <= ord(c) < 160 for c in shown)
    assert name.isprintable() <= (shown == name)


ROOT = Path(__file__).resolve().parents[2]
HOSTILE = {
    "a path upwards": "recordings: [{file: ../secret.csv}]", "an absolute path": "recordings: [{file: SECRET}]",
    "a link": "recordings: [{file: link.csv}]", "a link among folders": "recordings: [{file: away/secret.csv}]",
    "a network": "setup: {network: ../../secret.yaml}\nrecordings: [{file: a.csv}]",
    "an absolute network": "setup: {network: SECRET}\nrecordings: [{file: a.csv}]",
    "several files": "axes: [time]\nrecordings: [{file: [a.csv, ../secret.csv]}]",
    "an interpolation": "recordings: [{file: '${oc.env:HOME}/secret.csv'}]",
    "a tag": "recordings: [{file: !!python/object/apply:open [SECRET]}]",
    "a home": "recordings: [{file: ~/secret.csv}]", "a list": "files: SECRET",
}  # fmt: skip
# Runs both commands on every folder and prints each file that is opened meanwhile.
WATCHED = """
import json, sys
import phnn.commands, phnn.diagnose.diagnosis, phnn.identification.base, phnn.report.formatting
from phnn.cli import main
seen, case = [], [""]
sys.addaudithook(lambda event, args: seen.append((case[0], str(args[0]))) if event == "open" and case[0] else None)
for folder in json.loads(sys.argv[1]):
    for command in ("check", "identify"):
        case[0] = folder
        main([command, folder, "--out", folder + "-out"])
        case[0] = ""
print(json.dumps(seen), file=open(sys.argv[2], "w"))
"""


@pytest.mark.slow
def test_nothing_outside_is_opened(tmp_path: Path) -> None:
    folders = []
    (tmp_path / "outside").mkdir()
    for name in ("secret.csv", "outside/secret.csv"):
        (tmp_path / name).write_text(csv())
    (tmp_path / "secret.yaml").write_text("{}")
    for number, manifest in enumerate(HOSTILE.values()):
        folder = tmp_path / "in" / f"{number}"
        folder.mkdir(parents=True)
        (folder / "a.csv").write_text(csv())
        (folder / "link.csv").symlink_to(tmp_path / "secret.csv")
        (folder / "away").symlink_to(tmp_path / "outside")
        (folder / "recordings.yaml").write_text(manifest.replace("SECRET", str(tmp_path / "secret.csv")))
        folders.append(str(folder))
    (tmp_path / "in" / "secret.csv").write_text(csv())
    home = {"HOME": str(tmp_path), "PHNN_CACHE_DIR": os.environ.get("PHNN_CACHE_DIR", str(Path.home() / ".cache"))}
    command = [sys.executable, "-c", WATCHED, json.dumps(folders), str(tmp_path / "seen.json")]
    done = subprocess.run(
        command, env=os.environ | home | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=True
    )
    assert done.stderr.count("phnn: ") >= len(HOSTILE), done.stderr
    opened = json.loads((tmp_path / "seen.json").read_text())
    assert len(opened) > len(HOSTILE)
    # Installed code, what it compiled, and what the system tells of itself.
    allowed = [sys.prefix, sys.base_prefix, str(ROOT), home["PHNN_CACHE_DIR"], "/dev/null", "/proc", "/sys/fs/cgroup"]
    allowed += [str(Path(p).resolve()) for p in sys.path if p]
    strange = []
    for folder, path in opened:
        real = os.path.realpath(path)
        inside = any(real == a or real.startswith(a + os.sep) for a in (*allowed, folder, folder + "-out"))
        if not inside and not path.isdigit():
            strange.append((folder, path))
    assert not strange


DOCUMENT = Path(__file__).parents[2] / "docs" / "limits.md"
COUNTS = (
    "starts=1001", "workers=257", "workers=0", "starts=1e9", "starts=" + "9" * 400, "seed=" + "9" * 400, "seed=-1",
)  # fmt: skip
TRAINING = ("substeps=1025", "model.hysterons=21", "model.hysterons=-1", "model.hysterons=two", "model.width=4097",
            "model.width=[1]", "model.spring_width=1e9", "seed=" + "9" * 30, "stride=0", "folder=/dev/zero",
            "manifest=/dev/zero", "manifest=/etc/passwd", "base=/dev/zero", "base=/etc/passwd")  # fmt: skip


@pytest.mark.parametrize("setting", COUNTS)
def test_counts_beyond_the_limits(setting: str, attack: Attack, good: Path) -> None:
    assert attack(good, "identify", more=(setting,)).refused


@pytest.mark.parametrize("setting", TRAINING)
def test_training_beyond_the_limits(
    setting: str, good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", f"folder={good}", f"out={tmp_path / 'out'}", setting]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "internal error" not in message


def test_every_limit_stands_in_the_documentation() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    for name, value in asdict(LIMITS).items():
        assert f"| `{name}` | {value:,} |" in text


def test_a_file_may_take_less_than_the_memory_that_is_available() -> None:
    assert 0.0 < LIMITS.memory_share < 1.0 and available_memory() > 0
