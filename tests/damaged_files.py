"""Recordings as files of every format, what may happen to a file, and whether what is read of it is what it held."""

from __future__ import annotations

import importlib.util
import io
import json
import warnings
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np
import pandas as pd
import scipy.io
from recordings_example import output, sine

from phnn.recordings import Campaign

T, U = sine(10.0, 75.0, samples=120)
# As numbers of a file: s, V and um.
COLUMNS = {"time_s": T, "voltage_V": U, "displacement_um": output(U) * 1e6}
NAMES = list(COLUMNS)
# A short number among long ones.
COLUMNS["displacement_um"][7] = 16.5
# Bytes that a value takes at least, whatever the format.
SHORTEST = 4
# What one damaged place may change beside the rows that it covers: those it begins and ends in.
BESIDE = 2


def table(separator: str, decimal: str, head: str, form: str = "%.17g", end: str = "\n") -> bytes:
    """Return rows of text under a head."""
    samples = np.column_stack([*COLUMNS.values()]).tolist()
    rows = (separator.join(form % v for v in row).replace(".", decimal) for row in samples)
    return end.join([head, *rows, ""]).encode()


def made(write: Callable[..., object], *given: Any, **more: Any) -> bytes:
    """Return what a library writes into a file."""
    write(file := io.BytesIO(), *given, **more)
    return file.getvalue()


def hdf5(members: Mapping[Any, Any], **more: Any) -> bytes:
    """Return a file of arrays, links, settings of datasets, paths and names of others, or what it makes of itself."""
    with h5py.File(file := io.BytesIO(), "w") as f:
        for name, value in {**members, **more}.items():
            if isinstance(value, dict):
                f.create_dataset(name, **value)
            elif isinstance(value, tuple):
                (layout := h5py.VirtualLayout(value[-1], "f8"))[:] = h5py.VirtualSource(*value)
                f.create_virtual_dataset(name, layout)
            else:
                f[name] = value(f) if callable(value) else value
    return file.getvalue()


def tdms(columns: Mapping[str, np.ndarray], **properties: Any) -> bytes:
    """Return a file of waveforms with these properties."""
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(file := io.BytesIO()) as writer:
        writer.write_segment([ChannelObject("g", name, values, properties) for name, values in columns.items()])
    return file.getvalue()


def zipped(*members: tuple[str, bytes]) -> bytes:
    """Return an archive of these members, whose names may be the same."""
    with zipfile.ZipFile(file := io.BytesIO(), "w") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, content in members:
            archive.writestr(name, content)
    return file.getvalue()


STRUCTURED = np.array([tuple(row) for row in np.column_stack([*COLUMNS.values()])], dtype=[(n, "f8") for n in NAMES])
INSTRUMENT = "Oscilloscope 7\nDate: 1 May\n\n" + "\t".join(n.split("_")[0] for n in NAMES) + "\ns\tV\tum"
FILES: dict[str, bytes] = {
    ".csv": table(",", ".", ",".join(NAMES), "%r"), "fixed.csv": table(",", ".", ",".join(NAMES), "%.9e"),
    "comma.csv": table(";", ",", ";".join(NAMES)), ".tsv": table("\t", ".", "\t".join(NAMES)),
    ".dat": table(" ", ".", "# " + " ".join(NAMES)), ".asc": table(";", ".", ";".join(NAMES), end="\r\n"),
    ".lvm": table("\t", ",", "\t".join(NAMES)), ".txt": table("\t", ".", INSTRUMENT),
    ".npy": made(np.save, STRUCTURED), ".npz": made(np.savez, **COLUMNS),
    ".mat": made(scipy.io.savemat, COLUMNS),
    "small.mat": made(scipy.io.savemat, COLUMNS, do_compression=True), ".h5": hdf5(COLUMNS),
    ".hdf5": hdf5(COLUMNS), ".json": json.dumps({name: values.tolist() for name, values in COLUMNS.items()}).encode(),
    "records.json": json.dumps(RECORDS := [dict(zip(NAMES, row, strict=True)) for row in STRUCTURED.tolist()]).encode(),
    ".jsonl": "\n".join(map(json.dumps, RECORDS)).encode(),
}  # fmt: skip
if importlib.util.find_spec("nptdms") is not None:
    FILES[".tdms"] = tdms(COLUMNS)
if importlib.util.find_spec("pyarrow") is not None:
    FILES[".parquet"] = made(pd.DataFrame(COLUMNS).to_parquet, write_page_checksum=True)
if importlib.util.find_spec("openpyxl") is not None:
    FILES[".xlsx"] = made(pd.DataFrame(COLUMNS).to_excel, index=False)


@dataclass(frozen=True)
class Damaged:
    """A file that something happened to.

    Attributes:
        raw: its bytes; what: that, for messages; rows: how many rows may read otherwise at most.
        shorter: rows may be absent at its end.
    """

    raw: bytes
    what: str
    rows: int = 0
    shorter: bool = False


def damaged(raw: bytes, rng: np.random.Generator) -> Damaged:
    """Return a file that ends early, or one with a place that was overwritten, inserted, removed or repeated."""
    first, size = int(rng.integers(len(raw))), 8 * int(rng.integers(1, 9))
    before, piece, behind, noise = raw[:first], raw[first : first + size], raw[first + size :], rng.bytes(size)
    changed = {
        "cut": before, "noise over": before + noise[: len(piece)] + behind, "removed": before + behind,
        "zeros over": before + bytes(len(piece)) + behind, "noise before": before + noise + piece + behind,
        "twice": before + piece + piece + behind, "a byte over": before + noise[:1] + raw[first + 1 :],
    }  # fmt: skip
    kind = str(rng.choice(list(changed)))
    return Damaged(changed[kind], f"{size} bytes at {first}: {kind}", size // SHORTEST + BESIDE, kind == "cut")


@dataclass(frozen=True)
class Seen:
    """Input, output and notes of a recording."""

    t: np.ndarray
    u: np.ndarray
    y: np.ndarray
    notes: str


def seen(campaign: Campaign) -> Seen:
    """Return what was read of the one file of a folder."""
    (r,) = campaign.recordings
    return Seen(r.t, r.u, r.y, " ".join(campaign.notes))


def agrees(found: Seen, damaged: Damaged) -> bool:
    """Whether all rows but those that were touched read as they were written.

    Where a file was cut, its last number may be a part of one if that is said. A repeated place may make a row more,
    between two others in time: uneven instants are read as they stand, and said.
    """
    size, uneven = found.u.size, "jitters" in found.notes
    if not (size == T.size + uneven or 0 <= T.size - size <= (T.size if damaged.shorter else damaged.rows)):
        return False

    def wrong(before: int) -> int:
        """Count rows that read otherwise, where so many are absent at the beginning; others may be absent within."""
        rows = np.minimum(np.rint(found.t / T[1]).astype(int) + before, T.size - 1)
        rows = rows if "row" in found.notes or uneven else np.arange(size)
        away = np.abs(found.y - 1e-6 * COLUMNS["displacement_um"][rows]) > 1e-14
        others = (np.abs(found.u - U[rows]) > 1e-9 * 75.0) | away
        return int((others[:-1] if damaged.shorter and "has no end" in found.notes else others).sum())

    return min(map(wrong, range(damaged.rows + 1))) <= damaged.rows
