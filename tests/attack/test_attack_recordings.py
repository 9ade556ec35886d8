"""Hostile recordings: texts no instrument writes, and files built to mislead a parser or to lead elsewhere."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
from attack_tools import HEADER, Attack, csv, put, quick, rows, table, zipped

ROWS = csv().splitlines()
T, U, Y = table().T
COLUMNS = {"time_s": T, "voltage_V": U, "displacement_m": Y}
SIZE = T.size


def scaled(*factors: float, plus: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> str:
    """Return a recording whose columns are multiplied and shifted."""
    return csv(table() * np.array(factors or 1.0) + np.array(plus))


# Texts by the words of the refusal; none where they are read.
TEXTS: dict[str, list[str | bytes]] = {
    "": [
        csv().encode() + b"\xff\xfe", "# a\n" * 50_000 + csv(), "word " * 10_000 + "\n" + csv(),
        scaled(plus=(-1e3, 0, 0)),
        *(csv(np.column_stack([T, u, 1e-6 * u])) for u in (np.arange(120) >= 60, (-1.0) ** np.arange(120))),
    ],
    "the file is empty": [""],
    "not a text file": [
        np.random.default_rng(0).bytes(10_000), csv().encode("utf-16")[:-1], csv(header="\x1b[31m" + HEADER)],
    "no rows of numbers": [HEADER + "\n" * 500_000, "import os\nos.system('touch ran')\n"],
    "characters: write one row per sample": ["1," * 10**6],
    "columns, at most 1024": ["\n".join([",".join("1" * 50_000)] * 5)],
    "no voltage column": ["1\n" * 500_000, csv(header=",".join(["x" * 30_000] * 3))],
    "no displacement column": [csv(header="time_s,voltage_V,\u202edisplacement_m")],
    "voltage_0_V, voltage_1_V": [",".join(f"voltage_{i}_V" for i in range(500)) + ("\n" + ",".join("1" * 500)) * 60],
    "cells": [
        "\n".join(",".join("1" * i) for i in range(1, 300)), csv().replace(",", ',"', 1),
        csv(header=HEADER + ",\x9b31m").encode("latin-1").replace(b"\n", b",1\n")[:-2],
    ],
    "cannot be parsed": [csv().replace(",", '","')],
    "two rows with one time": [csv(np.ones((120, 3))), scaled(plus=(1e15, 0, 0))],
    "apart, between": [scaled(1e-320, 1, 1), scaled(1e25, 1, 1)],
    "constant at": [scaled(1, 1e-310, 1), scaled(1, 1, 1e-300), scaled(plus=(0, 0, 1e12))],
    "a piezo actuator's lies between": [
        csv(header="time_s,voltage_V,displacement_\xb5m").encode("latin-1"), scaled(1, 1e27, 1), scaled(1, 1, 1e33),
        scaled(plus=(0, 1e15, 0)), csv(table() * np.array([1, 0, 0]) + np.eye(120, 3)[::-1] * 1e-6),
    ],
}  # fmt: skip
NUMBERS = [
    "nan", "inf", "9" * 400, "1e999999999", "1e-999999999", "1e-320", "1e308", "0x1p3", "1_000", "1/2", "2001-12-14",
    "__import__('os').system('touch ran')", "=cmd|'/c calc'!A0", '"', '""', "", " ", "50%", "\u0661\u0662", "\uff11",
    "\u22125", "1j", "True", "\0", "\x1b[31m5", "1\r2", "1\f2", "1\u20282", "x" * 90_000, "\ud800",
]  # fmt: skip


@pytest.mark.parametrize(("words", "text"), rows(TEXTS))
@pytest.mark.parametrize("suffix", quick([".csv"], ".txt"))
def test_any_text(words: str, text: str | bytes, suffix: str, attack: Attack) -> None:
    attack.only(f"a{suffix}", text)
    # What is no table and is not called .csv is no recording.
    attack(words=words if suffix == ".csv" else None)


@pytest.mark.parametrize("row", [0, 119])
@pytest.mark.parametrize("column", [0, 1, 2])
def test_any_cell(column: int, row: int, attack: Attack) -> None:
    for number in NUMBERS:
        cells = ROWS[row + 1].split(",")
        cells[column] = number
        put(attack.data / "a.csv", "\n".join([*ROWS[: row + 1], ",".join(cells), *ROWS[row + 2 :]]) + "\n")
        attack()


EXTREMES = [
    *((f, "setup: {model: linear}") for f in (1e-300, 1e-150, 1e-30, 1e30)),
    *((1.0, said) for said in (
        "sample_rate_hz: 1e-150", "sample_rate_hz: 1e150", "columns: {voltage: {column: 1, scale: 1e150}}",
        "columns: {voltage: {column: 1, scale: 1e-150}}", "columns: {displacement: {column: 2, scale: -1}}",
        "start: {state: rest, input_before: 1e150}", "segments: 1", "segments: 119", "segments: 60",
        "recordings: [{file: a.csv, slice: [0, 1]}]", "start: periodic", "periodic: true", "input: zero_order",
    )),
]  # fmt: skip


@pytest.mark.parametrize(("factor", "said"), EXTREMES)
@pytest.mark.parametrize("named", [True, False])
def test_extreme_statements(factor: float, said: str, named: bool, attack: Attack) -> None:
    values = table() * np.array([1.0, factor, factor])
    attack.only("a.csv", csv(values) if named else csv(values[:, 1:], header="voltage_V,displacement_m"))
    attack(said=said)


def made(write: Callable[..., object], *given: Any, **more: Any) -> bytes:
    """Return the file that a library writes."""
    write(file := io.BytesIO(), *given, **more)
    return file.getvalue()


npy, npz = partial(made, np.save), partial(made, np.savez_compressed, **COLUMNS)
mat = partial(made, scipy.io.savemat, do_compression=True)


def head(shape: str, data: bytes = b"", descr: str = "<f8") -> bytes:
    """Return a .npy file that states this shape, or has this head."""
    text = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n" if shape[0] == "(" else shape
    return b"\x93NUMPY\x02\0" + struct.pack("<I", len(text)) + text.encode() + data


def packed(data: bytes) -> bytes:
    """Return a .mat file of version 5 with these compressed bytes."""
    return MAT + struct.pack("<II", 15, len(data)) + data


def zeros(size: int) -> bytes:
    """Return so many compressed zeros: one block again and again, never an end."""
    packer, block = zlib.compressobj(1), bytes(10**6)
    first, other = (packer.compress(block) + packer.flush(zlib.Z_FULL_FLUSH) for _ in range(2))
    return first + other * (size // len(block) - 1)


def hdf5(members: Mapping[Any, Any], **more: Any) -> bytes:
    """Return a file of arrays, links, settings of datasets, parts of others, or what is made of the file itself."""
    with h5py.File(file := io.BytesIO(), "w") as f:
        for name, value in {**members, **more}.items():
            if isinstance(value, dict):
                f.create_dataset(name, **value)
            elif isinstance(value, h5py.VirtualLayout):
                f.create_virtual_dataset(name, value)
            else:
                f[name] = value(f) if callable(value) else value
    return file.getvalue()


MAT, LINK = b"MATLAB 5.0".ljust(124) + b"\x00\x01IM", h5py.SoftLink
VOLTAGE, NONSENSE = "voltage_V.npy", b"\x0e\0\0\0\xff\xff\xff\x7f" + bytes(64)
HUGE = {"shape": (10**14,), "dtype": "f8"}
PACKED = {"shape": (10**9,), "dtype": "f8", "chunks": (10**6,), "compression": "gzip"}
# The flag of encryption of the only member, where it stands and in the directory.
ENCRYPTED = zipped((VOLTAGE, b"1")).replace(b"\x03\x04\x14\0\0", b"\x03\x04\x14\0\1")
ENCRYPTED = ENCRYPTED.replace(b"\x01\x02\x14\x03\x14\0\0", b"\x01\x02\x14\x03\x14\0\1")
# Files by the words of the refusal, none where they are read; what takes long to make is made when it is asked for.
FILES: dict[str, dict[str, bytes | Callable[[], bytes]]] = {
    "": {
        "unused.npz": lambda: npz(e=np.zeros(5 * 10**7, "i1")), "scalars.npz": npz(note=np.array("a"), n=np.array(3)),
        "null.h5": hdf5(COLUMNS, empty=h5py.Empty("f8")), "unused petabyte.h5": hdf5(COLUMNS, spare=HUGE),
        "references.h5": hdf5(COLUMNS, r={"shape": (3,), "dtype": h5py.ref_dtype}),
        "enums.h5": hdf5(COLUMNS, e={"shape": (3,), "dtype": h5py.enum_dtype({"A": 1})}),
        "circle.h5": hdf5(COLUMNS | {"g/again": lambda f: f["/"]}), "dangling.h5": hdf5(COLUMNS, a=LINK("/nowhere")),
        "link inside.h5": hdf5(COLUMNS, voltage_2=LINK("/time_s")),
    },
    "numbers that nothing describes": {
        "texts.npy": npy([["a", "b"]] * 60), "flags.npy": npy(np.zeros((120, 3), bool)),
        "halves.npy": npy(table().astype("f2")), "big endian.npy": npy(table().astype(">f8")),
        "escape.npy": npy(np.zeros(120, [("\x1b[31mvoltage_V", "f8")])),
        "pickle.npz": zipped((VOLTAGE, npy([print])), ("displacement_m.npy", npy(U))),
        "out of it.npz": zipped(("../../../../tmp/phnn_ran.npy", npy(U)), ("/etc/x.npy", npy(U))),
        "escape.npz": zipped(("\x1b[2J" + VOLTAGE, npy(U))), "64 columns.mat": mat({"data": np.zeros((120, 64))}),
        "structs.mat": mat({"s": COLUMNS}), "many.h5": lambda: hdf5({f"d{i}": 1.0 for i in range(1000)}),
        "escape.h5": hdf5({"\x1b[31mvoltage_V": U}),
    },
    "no numeric variables": {
        "no arrays.npz": zipped(("a.txt", b"1")), "texts.mat": mat({"voltage_V": "none"}),
        "rows.mat": mat({"data": table().T}), "cells.mat": mat({"data": np.array([[U], [Y]], dtype=object)}),
        "no datasets.h5": hdf5({"g": lambda f: f.create_group("h")}),
    },
    "its numbers take": {
        "terabyte.npz": zipped((VOLTAGE, head("(125000000000,)"))), "zeros.mat": lambda: packed(zeros(3 * 10**8)),
        "petabyte.h5": hdf5(dict.fromkeys(COLUMNS, HUGE)), "packed.h5": hdf5(dict.fromkeys(COLUMNS, PACKED)),
    },
    "its head states": {
        "terabyte.npy": head("(125000000000, 1)"), "400 digits.npy": head("(" + "9" * 400 + ",)"),
        "object.npy": head("(3,)", b"cos\nsystem\n", "|O"),
    },
    "not a readable": {
        "negative shape.npy": head("(-1, 3)", bytes(240)), "code.npy": head("__import__('os').system('touch ran')\n"),
        "deep.npy": head("{" + "(" * 5000 + ")" * 5000 + "\n"), "long head.npy": head("{" + " " * 10**6 + "}\n"),
        "none.npz": zipped((VOLTAGE, b"1")), "many.npz": lambda: zipped(*((f"a{i}.npy", b"") for i in range(10_001))),
        "encrypted.npz": ENCRYPTED, "zeros.mat": bytes(500), "unknown elements.mat": MAT + b"\xff" * 64,
        "nonsense.mat": packed(zlib.compress(NONSENSE)), "4.mat": struct.pack("<5i", 0, 10**9, 10**9, 0, 2) + b"x\0",
        "deep groups.h5": hdf5({"/".join("g" * 400): lambda f: f.create_group("h")}),
        "circle.h5": hdf5(COLUMNS, a=LINK("/b"), b=LINK("/a")), "not UTF-8.h5": hdf5({b"voltage_\xff": U}),
    },
    "not one number for every sample": {"V0 fields.npy": npy(np.zeros(120, [("voltage_V", "V0")]))},
    "what its axes are": {"no fields.npy": npy(np.zeros(120, []))},
    "is no table of samples": {"wide.npy": npy(np.zeros((120, 100)))},
    "no time column": {"twice.npz": zipped(*((f"{n}.npy", npy(Y)) for n in ("voltage_V", "displacement_m") * 2))},
    "0 samples": {"empty.mat": mat({"voltage_V": np.zeros((0, 0)), "displacement_m": np.zeros((0, 1))})},
    "holds complex numbers": {"complex.h5": hdf5({"voltage_V": U + 1j})},
}  # fmt: skip


@pytest.mark.parametrize(("words", "kind"), rows(FILES))
def test_a_hostile_file(words: str, kind: str, attack: Attack) -> None:
    content = FILES[words][kind]
    attack.only(f"a{Path(kind).suffix}", content() if callable(content) else content)
    attack(words=words)
    # Columns are asked for, whatever the file calls them.
    columns = "{voltage: {column: 0, unit: V}, displacement: {column: 1, unit: um}}"
    attack(said=f"sample_rate_hz: 1000\ncolumns: {columns}")


INCREMENTS = {
    "not seconds": ["soon", -1.0, float("nan"), float("inf"), True],
    "numbers that nothing describes": [0.0, 1e-320, 1e300, 1, 1e-3],
}  # fmt: skip


@pytest.mark.parametrize(("words", "increment"), rows(INCREMENTS))
@pytest.mark.parametrize("unit", ["V", "\x1b[31m"])
def test_properties_of_a_waveform(words: str, increment: object, unit: str, attack: Attack) -> None:
    tdms = pytest.importorskip("nptdms")
    properties = {"wf_increment": increment, "unit_string": unit}
    with tdms.TdmsWriter(file := io.BytesIO()) as writer:
        writer.write_segment([tdms.ChannelObject("g", n, COLUMNS[n], properties) for n in list(COLUMNS)[1:]])
    attack.only("a.tdms", file.getvalue())
    attack(words=words)


def part(file: str, name: str) -> h5py.VirtualLayout:
    """Return a dataset whose numbers are those of another."""
    layout = h5py.VirtualLayout((SIZE,), "f8")
    layout[:] = h5py.VirtualSource(file, name, (SIZE,))
    return layout


OTHER = h5py.ExternalLink
# What leads to the numbers of another file, given its path.
OUTSIDE: dict[str, Callable[[str], dict[str, Any]]] = {
    "link": lambda s: {"voltage_V": OTHER(s, "/voltage_V")}, "group": lambda s: {"g": OTHER(s, "/")},
    "soft link through it": lambda s: {"o": OTHER(s, "/"), "voltage_V": LINK("/o/voltage_V")},
    "soft link to a link": lambda s: {"g/o": OTHER(s, "/"), "g/a": LINK("o/voltage_V"), "voltage_V": LINK("/g/a")},
    "storage": lambda s: {"voltage_V": {"shape": (SIZE,), "dtype": "f8", "external": [(s + ".raw", 0, U.nbytes)]}},
    "virtual": lambda s: {"voltage_V": part(s, "voltage_V")},
    # Nothing outside, but no promise of h5py's that it is.
    "virtual within": lambda _: {"raw": U, "voltage_V": part(".", "raw")},
}  # fmt: skip


@pytest.mark.parametrize("suffix", [".h5", ".mat"])
@pytest.mark.parametrize("form", OUTSIDE)
def test_numbers_in_other_files_are_refused_unless_allowed(form: str, suffix: str, attack: Attack) -> None:
    secret = attack.root / "secret.h5"
    put(secret, hdf5(COLUMNS))
    put(attack.root / "secret.h5.raw", U.tobytes())
    attack.only(f"a{suffix}", hdf5({"time_s": T, "displacement_m": Y} | OUTSIDE[form](str(secret))))
    said = "columns: {voltage: {column: g.voltage_V, unit: V}}\n" if form == "group" else None
    refused = attack(said=said, words="--allow-outside")
    assert ("virtual" in refused.err) == form.startswith("virtual")
    attack("check", "--allow-outside", words="")
