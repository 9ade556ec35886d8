"""Hostile recordings: names, kinds of files, texts no instrument writes, files that mislead or lead elsewhere."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable
from functools import partial
from itertools import chain, product
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
from attack_tools import HEADER, NETWORK, TABLE, Attack, Outcome, csv, each, put
from damaged_files import FILES, agrees, damaged, hdf5, made, seen, tdms, zipped
from hypothesis import strategies as st

from phnn.recordings import read

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
    (folder := attack.root / f"d{name}").mkdir()
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


def sparse(path: Path, size: int) -> None:
    """Make a file of this size, nothing of which takes room."""
    put(path, HEADER + "\n")
    os.truncate(path, size)


# What is no file, by the words of the refusal where it is named: how it is made, or where a link leads.
KINDS: dict[str, dict[str, str | Callable[[Path], object]]] = {
    "is a pipe, a socket or a device": {
        "a pipe": os.mkfifo, "a socket": partial(os.mknod, mode=0o140600), "zeros": "/dev/zero"},
    "is a folder": {"a folder": Path.mkdir, "a link to a folder": "/etc", "a link upwards": ".."},
    "no such file": {"nothing": "nowhere.csv"}, "cannot be reached": {"itself": lambda p: p.symlink_to(p.name)},
    "leads out of": {"memory": "/proc/self/mem", "passwords": "/etc/passwd", "a link outside": "../outside.csv"},
    "may have at most": {"20 GB": partial(sparse, size=20 * 10**9), "an exabyte": partial(sparse, size=2**43)},
    "phnn: ": {"1 GB": partial(sparse, size=10**9), "no rights": lambda path: (put(path, csv()), path.chmod(0))},
}  # fmt: skip


@pytest.mark.parametrize("what", ["a.csv", "a.txt", "a.h5", "a.npy", "a.npz", "a.mat", "a.tdms", "net.yaml",
                                  "recordings.yaml", "../model/model.json", "../m.yaml"])  # fmt: skip
@each(KINDS)
def test_kinds_of_files(words: str, name: str, content: Any, what: str, attack: Attack) -> None:
    recording, path = what[0] == "a", attack.data / what
    path.parent.mkdir(exist_ok=True)
    if recording:
        (attack.data / "a.csv").unlink()
    path.symlink_to(content) if isinstance(content, str) else content(path)
    # Rights do not bind some users; a manifest that the user names may lie anywhere.
    unbound = recording and name == "no rights" and os.geteuid() == 0
    command, said = "predict" if "model" in what else "check", "setup: {network: net.yaml}" if "net" in what else None
    given = ["--manifest", str(path)] * (what == "../m.yaml")
    attack(command, *given, said=said, words=None if unbound else "phnn: ")
    if recording:
        attack(said=f"recordings: [{what}]\n", words=None if unbound else words)


# Arguments of a command: folders that are none; counts of a training beyond the limits, and files that are none.
NOWHERE = ("/dev/null", "/dev/zero", "/proc/self/mem", "/etc/passwd", "/proc/self/fd", "/nowhere", "a\0b", "",
           "x" * 5000)  # fmt: skip
SETTINGS = ("substeps=1025", "model.hysterons=21", "model.width=[1]", "stride=0", "folder=/dev/zero",
            "manifest=/dev/zero", "manifest=/etc/passwd", "base=/dev/zero", "base=/etc/passwd")  # fmt: skip


@pytest.mark.parametrize("command", ["check", "predict", "identify", "model", "train"])
def test_arguments_that_are_none(command: str, attack: Attack, monkeypatch: pytest.MonkeyPatch) -> None:
    (attack.root / "empty").mkdir()
    monkeypatch.chdir(attack.root / "empty")
    for given in SETTINGS if command == "train" else NOWHERE:
        if command == "model":
            attack("predict", model=given or ".", words="phnn: ")
        else:
            attack(command, *[given] * (command == "train"), folder=given, words="phnn: ")


LINK, OTHER, SIZE = h5py.SoftLink, h5py.ExternalLink, TABLE.shape[:1]
T, U, Y = TABLE.T
COLUMNS = {"time_s": T, "voltage_V": U, "displacement_m": Y}
# What leads to the numbers of another file, given its path.
OUTSIDE: dict[str, Callable[[str], dict[str, Any]]] = {
    "link": lambda s: {"voltage_V": OTHER(s, "/voltage_V")}, "group": lambda s: {"g": OTHER(s, "/")},
    "soft link through it": lambda s: {"o": OTHER(s, "/"), "voltage_V": LINK("/o/voltage_V")},
    "soft link to a link": lambda s: {"g/o": OTHER(s, "/"), "g/a": LINK("o/voltage_V"), "voltage_V": LINK("/g/a")},
    "storage": lambda s: {"voltage_V": {"shape": SIZE, "dtype": "f8", "external": [(s + ".raw", 0, U.nbytes)]}},
    "virtual": lambda s: {"voltage_V": (s, "voltage_V", SIZE)},
    # Nothing outside, but no promise of h5py's that it is.
    "virtual within": lambda _: {"raw": U, "voltage_V": (".", "raw", SIZE)},
}  # fmt: skip


@pytest.mark.parametrize("suffix", [".h5", ".mat"])
@pytest.mark.parametrize("form", OUTSIDE)
def test_numbers_in_other_files_are_refused_unless_allowed(form: str, suffix: str, attack: Attack) -> None:
    secret = attack.root / "secret.h5"
    put(secret, hdf5(COLUMNS))
    put(attack.root / "secret.h5.raw", U.tobytes())
    attack.only(f"a{suffix}", hdf5({"time_s": T, "displacement_m": Y} | OUTSIDE[form](str(secret))))
    said = "columns: {voltage: {column: g.voltage_V, unit: V}}\n" if form == "group" else None
    refused = attack(said=said, words=ALLOWED)
    assert ("virtual" in refused.err) == form.startswith("virtual")
    attack("check", ALLOWED, words="")


@pytest.mark.parametrize("said", ["recordings: [a.csv, ../outside.csv]", "recordings: [a.csv, sub/outside.csv]",
                                  "setup: {network: ../net.yaml}", None])  # fmt: skip
def test_files_outside_are_refused_unless_allowed(said: str | None, attack: Attack) -> None:
    put(attack.root / "net.yaml", NETWORK)
    (attack.data / ("sub" if said else "b.csv")).symlink_to(".." if said else "../outside.csv")
    attack(said=said, words=ALLOWED)
    attack("check", ALLOWED, words="")


def test_a_link_to_the_folder_and_links_within_it_are_read(attack: Attack) -> None:
    (attack.data / "sub").mkdir()
    put(attack.data / "sub" / "real.csv", csv())
    (attack.data / "b.csv").symlink_to("sub/real.csv")
    (attack.root / "way").symlink_to(attack.data)
    attack(folder=attack.root / "way", words="")


def scaled(*factors: float, plus: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> str:
    """Return a recording whose columns are multiplied and shifted."""
    return csv(TABLE * np.array(factors or 1.0) + np.array(plus))


# Texts by the words of the refusal; none where they are read.
TEXTS: dict[str, list[str | bytes]] = {
    "": [
        csv().encode() + b"\xff\xfe", "# a\n" * 50_000 + csv(), "word " * 10_000 + "\n" + csv(),
        scaled(plus=(-1e3, 0, 0)),
        *(csv(np.column_stack([T, u, 1e-6 * u])) for u in (np.arange(120) >= 60, (-1.0) ** np.arange(120)))],
    "the file is empty": [""], "cannot be parsed": [csv().replace(",", '","')],
    "not a text file": [
        np.random.default_rng(0).bytes(10_000), csv().encode("utf-16")[:-1], csv(header="\x1b[31m" + HEADER)],
    "no rows of numbers": [HEADER + "\n" * 500_000, "import os\nos.system('touch ran')\n"],
    "characters: write one row per sample": ["1," * 10**6], "columns, at most 1024": [f"{'1,' * 49_999}1\n" * 5],
    "no voltage column": ["1\n" * 500_000, csv(header=",".join(["x" * 30_000] * 3))],
    "no displacement column": [csv(header="time_s,voltage_V,\u202edisplacement")],
    "voltage_0_V, voltage_1_V": [",".join(f"voltage_{i}_V" for i in range(500)) + ("\n" + ",".join("1" * 500)) * 60],
    "cells": [
        "\n".join(",".join("1" * i) for i in range(1, 300)), csv().replace(",", ',"', 1),
        csv(header=HEADER + ",\x9b31m").encode("latin-1").replace(b"\n", b",1\n")[:-2]],
    "two rows with one time": [csv(np.ones((120, 3))), scaled(plus=(1e15, 0, 0))],
    "apart, between": [scaled(1e-320, 1, 1), scaled(1e25, 1, 1)],
    "constant at": [scaled(1, 1e-310, 1), scaled(1, 1, 1e-300), scaled(plus=(0, 0, 1e12))],
    "a piezo actuator's lies between": [
        csv(header="time_s,voltage_V,displacement_\xb5m").encode("latin-1"), scaled(1, 1e27, 1), scaled(1, 1, 1e33),
        scaled(plus=(0, 1e15, 0)), csv(TABLE * np.array([1, 0, 0]) + np.eye(120, 3)[::-1] * 1e-6)],
}  # fmt: skip


def head(shape: str, data: bytes = b"", descr: str = "<f8") -> bytes:
    """Return a .npy file that states this shape, or has this head."""
    text = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n" if shape[0] == "(" else shape
    return b"\x93NUMPY\x02\0" + struct.pack("<I", len(text)) + text.encode() + data


def packed(data: bytes) -> bytes:
    """Return a .mat file of version 5 with these compressed bytes."""
    return MAT + struct.pack("<II", 15, len(data)) + data


UNDESCRIBED = "numbers that nothing describes"
npz = partial(made, np.savez_compressed, **COLUMNS)
mat, npy = partial(made, scipy.io.savemat, do_compression=True), partial(made, np.save)
MAT, VOLTAGE, PACKER = b"MATLAB 5.0".ljust(124) + b"\x00\x01IM", "voltage_V.npy", zlib.compressobj(1)
HUGE = {"shape": (10**14,), "dtype": "f8"}
PACKED = {"shape": (10**9,), "dtype": "f8", "chunks": (10**6,), "compression": "gzip"}
# The flag of encryption of the only member, where it stands and in the directory.
ENCRYPTED = zipped((VOLTAGE, b"1")).replace(b"\x03\x04\x14\0\0", b"\x03\x04\x14\0\1")
ENCRYPTED = ENCRYPTED.replace(b"\x01\x02\x14\x03\x14\0\0", b"\x01\x02\x14\x03\x14\0\1")
# Files by the words of the refusal, none where they are read; what takes long to make is made when it is asked for.
HOSTILE: dict[str, dict[str, bytes | Callable[[], bytes]]] = {
    "": {
        "unused.npz": lambda: npz(e=np.zeros(5 * 10**7, "i1")), "scalars.npz": npz(note=np.array("a"), n=np.array(3)),
        "null.h5": hdf5(COLUMNS, empty=h5py.Empty("f8")), "unused petabyte.h5": hdf5(COLUMNS, spare=HUGE),
        "references.h5": hdf5(COLUMNS, r={"shape": (3,), "dtype": h5py.ref_dtype}),
        "enums.h5": hdf5(COLUMNS, e={"shape": (3,), "dtype": h5py.enum_dtype({"A": 1})}),
        "circle.h5": hdf5(COLUMNS | {"g/again": lambda f: f["/"]}), "dangling.h5": hdf5(COLUMNS, a=LINK("/nowhere")),
        "link inside.h5": hdf5(COLUMNS, voltage_2=LINK("/time_s"))},
    UNDESCRIBED: {
        "texts.npy": npy([["a", "b"]] * 60), "flags.npy": npy(np.zeros((120, 3), bool)),
        "halves.npy": npy(TABLE.astype("f2")), "big endian.npy": npy(TABLE.astype(">f8")),
        "escape.npy": npy(np.zeros(120, [("\x1b[31mvoltage_V", "f8")])),
        "pickle.npz": zipped((VOLTAGE, npy([print])), ("displacement_m.npy", npy(U))),
        "out of it.npz": zipped(("../../../../tmp/phnn_ran.npy", npy(U)), ("/etc/x.npy", npy(U))),
        "escape.npz": zipped(("\x1b[2J" + VOLTAGE, npy(U))), "64 columns.mat": mat({"data": np.zeros((120, 64))}),
        "structs.mat": mat({"s": COLUMNS}), "many.h5": lambda: hdf5({f"d{i}": 1.0 for i in range(1000)}),
        "escape.h5": hdf5({"\x1b[31mvoltage_V": U})},
    "numbers that nothing describes": {"rows.mat": mat({"data": TABLE.T})},
    "no numeric variables": {
        "no arrays.npz": zipped(("a.txt", b"1")), "texts.mat": mat({"voltage_V": "none"}),
        "cells.mat": mat({"data": np.array([[U], [Y]], dtype=object)}),
        "no datasets.h5": hdf5({"g": lambda f: f.create_group("h")})},
    "its numbers take": {
        "terabyte.npz": zipped((VOLTAGE, head("(125000000000,)"))),
        # Compressed zeros without an end.
        "zeros.mat": lambda: packed(b"".join(map(PACKER.compress, [bytes(10**6)] * 300))),
        "petabyte.h5": hdf5(dict.fromkeys(COLUMNS, HUGE)), "packed.h5": hdf5(dict.fromkeys(COLUMNS, PACKED))},
    "its head states": {
        "terabyte.npy": head("(125000000000, 1)"), "400 digits.npy": head("(" + "9" * 400 + ",)"),
        "object.npy": head("(3,)", b"cos\nsystem\n", "|O")},
    "not a readable": {
        "negative shape.npy": head("(-1, 3)", bytes(240)), "code.npy": head("__import__('os').system('touch ran')\n"),
        "deep.npy": head("{" + "(" * 5000 + ")" * 5000 + "\n"), "long head.npy": head("{" + " " * 10**6 + "}\n"),
        "none.npz": zipped((VOLTAGE, b"1")), "many.npz": lambda: zipped(*((f"a{i}.npy", b"") for i in range(10_001))),
        "encrypted.npz": ENCRYPTED, "zeros.mat": bytes(500), "unknown elements.mat": MAT + b"\xff" * 64,
        "nonsense.mat": packed(zlib.compress(b"\x0e\0\0\0\xff\xff\xff\x7f" + bytes(64))),
        "4.mat": struct.pack("<5i", 0, 10**9, 10**9, 0, 2) + b"x\0",
        "deep groups.h5": hdf5({"/".join("g" * 400): lambda f: f.create_group("h")}),
        "circle.h5": hdf5(COLUMNS, a=LINK("/b"), b=LINK("/a")), "not UTF-8.h5": hdf5({b"voltage_\xff": U})},
    "not one number for every sample": {"V0 fields.npy": npy(np.zeros(120, [("voltage_V", "V0")]))},
    "what its axes are": {"none.npy": npy(np.zeros(120, []))}, "no table of": {"wide.npy": npy(np.zeros((120, 100)))},
    "no time column": {"twice.npz": zipped(*((f"{n}.npy", npy(Y)) for n in ("voltage_V", "displacement_m") * 2))},
    "0 samples": {"empty.mat": mat({"voltage_V": np.zeros((0, 0)), "displacement_m": np.zeros((0, 1))})},
    "holds complex numbers": {"complex.h5": hdf5({"voltage_V": U + 1j})},
}  # fmt: skip
# Steps in time of waveforms.
STEPS = {"not seconds": ("soon", -1.0, np.nan, np.inf, True), UNDESCRIBED: (0.0, 1e-320, 1e300, 1, 1e-3)}
wave = partial(tdms, {"voltage_V": U, "displacement_m": Y})
WAVES = {words: {f"{step} s in {unit!r}.tdms": partial(wave, wf_increment=step, unit_string=unit)
                 for step, unit in product(steps, ("V", "\x1b[31m"))} for words, steps in STEPS.items()}  # fmt: skip
# What is no table and is not called .csv is no recording; numbers far from those of any instrument may be one.
LOOSE = {None: {
    **{f"{number}.txt": text for number, text in enumerate(chain.from_iterable(TEXTS.values()))},
    **{f"{f} from {i}.csv": csv((TABLE * [1, f, f])[:, i:], HEADER.split(",", i)[i])
       for f, i in product((1.0, 1e-300, 1e-150, 1e-30, 1e30), (0, 1))},
}}  # fmt: skip


@each(HOSTILE, WAVES, TEXTS, LOOSE)
def test_a_hostile_file(words: str | None, name: str | int, content: Any, attack: Attack) -> None:
    suffix = Path(str(name)).suffix or ".csv"
    if suffix == ".tdms":
        pytest.importorskip("nptdms")
    attack.only(f"a{suffix}", content() if callable(content) else content)
    attack(words=words)
    # Columns are asked for, whatever the file calls them.
    columns = "{voltage: {column: 0, unit: V}, displacement: {column: 1, unit: um}}"
    attack(said=f"setup: {{model: linear}}\nsample_rate_hz: 1000\ncolumns: {columns}")


NUMBERS = [
    "nan", "inf", "9" * 400, "1e999999999", "1e-999999999", "1e-320", "1e308", "0x1p3", "1_000", "1/2", "2001-12-14",
    "__import__('os').system('touch ran')", "=cmd|'/c calc'!A0", '"', '""', "", " ", "50%", "\u0661\u0662", "\uff11",
    "\u22125", "1j", "True", "\0", "\x1b[31m5", "1\r2", "1\f2", "1\u20282", "x" * 90_000, "\ud800",
]  # fmt: skip


@pytest.mark.parametrize("column", [0, 1, 2])
def test_any_cell(column: int, attack: Attack) -> None:
    for row, number in product((0, 119), NUMBERS):
        cells = [line.split(",") for line in csv().splitlines()]
        cells[row + 1][column] = number
        put(attack.data / "a.csv", "\n".join(map(",".join, cells)) + "\n")
        attack()


@pytest.mark.parametrize("most", [200, pytest.param(4500, marks=pytest.mark.slow)])
def test_a_damaged_recording_is_refused_or_read_as_it_stands(most: int, attack: Attack) -> None:
    def mutant(draw: Callable[..., Any]) -> tuple[Outcome, object]:
        name, seed = draw(st.sampled_from(sorted(FILES))), draw(st.integers(0, 2**32))
        touched = damaged(FILES[name], np.random.default_rng(seed))
        attack.only(f"a{name}", touched.raw)
        outcome = attack.run()
        wrong = outcome.status == 0 and not agrees(seen(read(attack.data)), touched)
        return outcome, wrong and f"{name}, seed {seed}: {touched.what}"

    attack.count(most, "recordings", mutant)
