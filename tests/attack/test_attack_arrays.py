"""Hostile binary recordings: what claims more than it holds, leads elsewhere, or was built to mislead a parser."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from attack_tools import Attack, encrypted, packed_zeros, put, table, zipped

T, U, Y = table().T
COLUMNS = {"time_s": T, "voltage_V": U, "displacement_m": Y}
SIZE = T.size


def npy(array: np.ndarray, **kwargs: bool) -> bytes:
    file = io.BytesIO()
    np.save(file, array, **kwargs)
    return file.getvalue()


def npz(**arrays: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def mat(**arrays: object) -> bytes:
    file = io.BytesIO()
    scipy.io.savemat(file, arrays, do_compression=True)
    return file.getvalue()


def head(text: str, data: bytes = b"", version: int = 1) -> bytes:
    """A .npy file with this header."""
    content = text.encode("latin-1")
    length = struct.pack("<H" if version == 1 else "<I", len(content))
    return b"\x93NUMPY" + bytes([version, 0]) + length + content + data


def mat_of(packed: bytes) -> bytes:
    """A .mat file of version 5 with these compressed bytes."""
    return b"MATLAB 5.0".ljust(124) + b"\x00\x01IM" + struct.pack("<II", 15, len(packed)) + packed


def hdf5(fill: Callable[[h5py.File], object]) -> bytes:
    file = io.BytesIO()
    with h5py.File(file, "w") as f:
        fill(f)
    return file.getvalue()


def columns(f: h5py.File) -> None:
    for name, values in COLUMNS.items():
        f[name] = values


TABLES = {
    "V0 fields.npy": lambda: npy(np.zeros(120, [("voltage_V", "V0")])),
    "no fields.npy": lambda: npy(np.zeros(120, [])),
    "texts.npy": lambda: npy(np.array([["a", "b"]] * 60)),
    "flags.npy": lambda: npy(np.zeros((120, 3), bool)),
    "halves.npy": lambda: npy(np.column_stack([T, U, Y]).astype("f2")),
    "escape.npy": lambda: npy(np.zeros(120, [("\x1b[31mvoltage_V", "f8")])),
    "a terabyte.npy": lambda: head("{'descr': '<f8', 'fortran_order': False, 'shape': (125000000000, 1), }\n"),
    "a negative shape.npy": lambda: head("{'descr': '<f8', 'fortran_order': False, 'shape': (-1, 3), }\n", bytes(240)),
    "400 digits.npy": lambda: head("{'descr': '<f8', 'fortran_order': False, 'shape': (" + "9" * 400 + ",), }\n"),
    "code.npy": lambda: head("__import__('os').system('touch ran')\n"),
    "deep.npy": lambda: head("(" * 5000 + ")" * 5000 + "\n"),
    "an object.npy": lambda: head("{'descr': '|O', 'fortran_order': False, 'shape': (3,), }\n", b"cos\nsystem\n"),
    "a very long head.npy": lambda: head("{" + " " * 10**6 + "}\n", version=2),
    "wide.npy": lambda: npy(np.zeros((120, 100))),
    "big endian.npy": lambda: npy(np.column_stack([T, U, Y]).astype(">f8")),
    "no arrays.npz": lambda: zipped({"a.txt": b"1"}),
    "not arrays.npz": lambda: zipped({"voltage_V.npy": b"1"}),
    "a pickle.npz": lambda: zipped(
        {"voltage_V.npy": npy(np.array([print], dtype=object)), "displacement_m.npy": npy(U)}
    ),
    "out of it.npz": lambda: zipped({"../../../../tmp/phnn_ran.npy": npy(U), "/etc/x.npy": npy(U)}),
    "escape.npz": lambda: zipped({"\x1b[2Jvoltage_V.npy": npy(U)}),
    "a name twice.npz": lambda: zipped(
        [("voltage_V.npy", npy(U)), ("voltage_V.npy", npy(U)), ("displacement_m.npy", npy(Y))]
    ),
    "a terabyte.npz": lambda: zipped(
        {"voltage_V.npy": head("{'descr': '<f8', 'fortran_order': False, 'shape': (125000000000,), }\n")}
    ),
    "an unused array.npz": lambda: npz(**COLUMNS, spare=np.zeros(5 * 10**7, "i1")),
    "scalars.npz": lambda: npz(**COLUMNS, note=np.array("text"), n=np.array(3)),
    "many.npz": lambda: zipped({f"a{i}.npy": b"" for i in range(20_000)}),
    "encrypted.npz": lambda: encrypted({"voltage_V.npy": npy(U)}),
    "64 columns.mat": lambda: mat(data=np.zeros((120, 64))),
    "rows.mat": lambda: mat(data=np.vstack([T, U, Y])),
    "cells.mat": lambda: mat(data=np.array([[U], [Y]], dtype=object)),
    "structs.mat": lambda: mat(s={"voltage_V": U, "displacement_m": Y, "time_s": T}),
    "texts.mat": lambda: mat(voltage_V="none"),
    "empty arrays.mat": lambda: mat(voltage_V=np.zeros((0, 0)), displacement_m=np.zeros((0, 1))),
    "zeros.mat": lambda: bytes(500),
    "unknown elements.mat": lambda: b"MATLAB 5.0".ljust(124) + b"\x00\x01IM" + b"\xff" * 64,
    "packed nonsense.mat": lambda: mat_of(zlib.compress(b"\x0e\0\0\0\xff\xff\xff\x7f" + bytes(64))),
    "packed zeros.mat": lambda: mat_of(packed_zeros(3 * 10**8)),
    "version 4.mat": lambda: struct.pack("<5i", 0, 10**9, 10**9, 0, 2) + b"x\0",
    "no datasets.h5": lambda: hdf5(lambda f: f.create_group("g")),
    "null datasets.h5": lambda: hdf5(lambda f: (columns(f), f.__setitem__("empty", h5py.Empty("f8")))),
    "references.h5": lambda: hdf5(lambda f: (columns(f), f.create_dataset("r", (3,), h5py.ref_dtype))),
    "a petabyte.h5": lambda: hdf5(
        lambda f: (f.create_dataset("voltage_V", (10**14,), "f8"), f.create_dataset("displacement_m", (10**14,), "f8"))
    ),
    "packed gigabytes.h5": lambda: hdf5(
        lambda f: [f.create_dataset(n, (10**9,), "f8", chunks=(10**6,), compression="gzip") for n in COLUMNS]
    ),
    "an unused petabyte.h5": lambda: hdf5(lambda f: (columns(f), f.create_dataset("spare", (10**14,), "f8"))),
    "deep groups.h5": lambda: hdf5(lambda f: f.create_group("/".join("g" * 1 for _ in range(400)))),
    "many datasets.h5": lambda: hdf5(lambda f: [f.__setitem__(f"d{i}", 1.0) for i in range(1000)]),
    "a circle.h5": lambda: hdf5(lambda f: (columns(f), f.__setitem__("g/again", f["/"]))),
    "a soft circle.h5": lambda: hdf5(
        lambda f: (columns(f), f.__setitem__("a", h5py.SoftLink("/b")), f.__setitem__("b", h5py.SoftLink("/a")))
    ),
    "a dangling link.h5": lambda: hdf5(lambda f: (columns(f), f.__setitem__("a", h5py.SoftLink("/nowhere")))),
    "escape.h5": lambda: hdf5(lambda f: f.__setitem__("\x1b[31mvoltage_V", U)),
    "not UTF-8.h5": lambda: hdf5(lambda f: f.__setitem__(b"voltage_\xff", U)),
    "complex.h5": lambda: hdf5(lambda f: f.__setitem__("voltage_V", U + 1j)),
    "enums.h5": lambda: hdf5(lambda f: (columns(f), f.create_dataset("e", (3,), h5py.enum_dtype({"A": 1})))),
    "a soft link inside.h5": lambda: hdf5(lambda f: (columns(f), f.__setitem__("voltage_2", h5py.SoftLink("/time_s")))),
}
GOOD = (
    "an unused array.npz", "scalars.npz", "null datasets.h5", "references.h5", "enums.h5", "an unused petabyte.h5",
    "a circle.h5", "a dangling link.h5", "a soft link inside.h5",
)  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "data").mkdir()
    return tmp_path / "data"


@pytest.mark.parametrize("case", TABLES)
def test_a_hostile_array(case: str, attack: Attack, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder.parent)
    put(folder / f"a{Path(case).suffix}", TABLES[case]())
    outcome = attack(folder)
    assert outcome.refused == (case not in GOOD), outcome
    # Named columns are asked for, whatever the file calls them.
    put(
        folder / "recordings.yaml",
        "sample_rate_hz: 1000\ncolumns: {voltage: {column: 0, unit: V}, displacement: {column: 1, unit: um}}",
    )
    attack(folder)


tdms = pytest.importorskip("nptdms")


def waveform(**properties: object) -> bytes:
    file = io.BytesIO()
    with tdms.TdmsWriter(file) as writer:
        writer.write_segment([tdms.ChannelObject("g", n, v, properties) for n, v in COLUMNS.items() if n != "time_s"])
    return file.getvalue()


PROPERTIES = {
    "a text": "soon", "negative": -1.0, "NaN": float("nan"), "infinite": float("inf"), "zero": 0.0, "tiny": 1e-320,
    "huge": 1e300, "a flag": True, "a whole number": 1, "right": 1e-3,
}  # fmt: skip


@pytest.mark.parametrize("case", PROPERTIES)
@pytest.mark.parametrize("unit", ["V", "\x1b[31m"])
def test_properties_of_a_waveform(case: str, unit: object, attack: Attack, folder: Path) -> None:
    put(folder / "a.tdms", waveform(wf_increment=PROPERTIES[case], unit_string=unit))
    attack(folder)


def external(folder: Path, form: str) -> None:
    """An HDF5 file whose numbers lie in a file beside the folder."""
    secret = folder.parent / "secret.h5"
    with h5py.File(secret, "w") as f:
        columns(f)
    raw = folder.parent / "secret.bin"
    raw.write_bytes(U.tobytes())
    with h5py.File(folder / "a.h5", "w") as f:
        f["time_s"], f["displacement_m"] = T, Y
        if form == "link":
            f["voltage_V"] = h5py.ExternalLink(str(secret), "/voltage_V")
        elif form == "soft link through it":
            f["other"] = h5py.ExternalLink(str(secret), "/")
            f["voltage_V"] = h5py.SoftLink("/other/voltage_V")
        elif form == "soft link to a link":
            f["g/other"] = h5py.ExternalLink(str(secret), "/")
            f["g/near"] = h5py.SoftLink("other/voltage_V")
            f["voltage_V"] = h5py.SoftLink("/g/near")
        elif form == "group":
            f["g"] = h5py.ExternalLink(str(secret), "/")
        elif form == "storage":
            f.create_dataset("voltage_V", (SIZE,), "f8", external=[(str(raw), 0, U.nbytes)])
        else:
            layout = h5py.VirtualLayout((SIZE,), "f8")
            layout[:] = h5py.VirtualSource(str(secret), "voltage_V", (SIZE,))
            f.create_virtual_dataset("voltage_V", layout)


@pytest.mark.parametrize("suffix", [".h5", ".mat"])
@pytest.mark.parametrize("form", ["link", "soft link through it", "soft link to a link", "group", "storage", "virtual"])
def test_numbers_in_other_files_are_refused_unless_allowed(
    form: str, suffix: str, attack: Attack, folder: Path
) -> None:
    external(folder, form)
    (folder / "a.h5").rename(folder / f"a{suffix}")
    if form == "group":
        put(folder / "recordings.yaml", "columns: {voltage: {column: g.voltage_V, unit: V}}\n")
    outcome = attack(folder)
    assert outcome.refused
    assert "--allow-outside" in outcome.err
    assert attack(folder, more=("--allow-outside",)).status == 0


def test_a_virtual_dataset_is_read_where_that_is_allowed(attack: Attack, folder: Path) -> None:
    with h5py.File(folder / "a.h5", "w") as f:
        f["time_s"], f["displacement_m"], f["raw"] = T, Y, U
        layout = h5py.VirtualLayout((SIZE,), "f8")
        layout[:] = h5py.VirtualSource(f["raw"])
        f.create_virtual_dataset("voltage_V", layout)
    assert "virtual" in attack(folder).err
    assert attack(folder, more=("--allow-outside",)).status == 0
