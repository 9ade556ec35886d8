"""The recordings among the files of a folder, and their readers."""

from __future__ import annotations

import math
import os
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from phnn.errors import InputRefused
from phnn.intake.files import Source, list_folder, named_file
from phnn.intake.limits import LIMITS
from phnn.recordings import checks
from phnn.recordings.array_files import read_hdf5, read_mat, read_npy, read_npz
from phnn.recordings.json_files import NoRecording, read_json
from phnn.recordings.manifest import Entry, Manifest
from phnn.recordings.memory import given_frame
from phnn.recordings.sampling import merged
from phnn.recordings.table import Table, Where
from phnn.recordings.text_files import Lines, looks_like_numbers, read_text, table_of_lines
from phnn.recordings.units import parse_name
from phnn.results import printable

# Characters of a path in a message.
_SHOWN = 200
# Bytes before the content of a segment, and the flag of its first byte order.
_LEAD_IN, _BIG_ENDIAN, _UNCLOSED = 28, 1 << 6, b"\xff" * 8
_INTERVAL, _START, _OFFSET, _UNIT = "wf_increment", "wf_start_time", "wf_start_offset", "unit_string"


def read_tdms(source: Source) -> Table:
    """The numeric channels as ``group.channel``, with their units; waveforms of one interval bring their time."""
    with _by_package(source, "npTDMS", "'phnn[tdms]'", "export it again"):
        from nptdms import TdmsFile

        closed = _closed(source)
        with source.open() as file, TdmsFile.open(file) as content:
            numeric = _numeric(source, content)
        clocks = {names: _clock(of) for names, (_, of) in numeric.items()}
    if not numeric:
        raise InputRefused(f"{source.name}: no numeric channels in it: record it again or remove it")
    notes: tuple[str, ...] = ()
    if not closed:
        # What was not written of a channel is missing in all.
        whole = min(values.size for values, _ in numeric.values())
        numeric = {names: (values[:whole], of) for names, (values, of) in numeric.items()}
        notes = ("the file was not closed, its channels are as long as the shortest",)
    several = len({group for group, _ in numeric}) > 1
    columns: dict[str, np.ndarray] = {}
    for (group, name), (values, of) in numeric.items():
        unit = str(of.get(_UNIT, "")).strip()
        shown = f"{name} [{unit}]" if unit and not name.endswith(("]", ")")) else name
        columns[printable(f"{group}.{shown}" if several else shown)] = values
    own: dict[str, np.ndarray] = {}
    kinds = set(clocks.values())
    if len(kinds) == 1 and (interval := kinds.pop().interval) > 0.0:
        longest = max(values.size for values in columns.values())
        columns.setdefault("time_s", interval * np.arange(longest))
    elif kinds and all(clock.interval > 0.0 for clock in kinds):
        where = Where(source.name)
        every = dict(zip(columns, clocks.values(), strict=True))
        if not all(clock.dated for clock in kinds):
            said = "; ".join(f"{name}: every {clock.interval:g} s" for name, clock in every.items())
            raise InputRefused(
                f"{where}: channels with clocks of their own, and not all say when they began ({said}): write "
                f"{_START} with each waveform, or export them with one time"
            )
        first = min(clock.start for clock in kinds)
        stamps = {n: 1e-9 * (c.start - first) + c.interval * np.arange(columns[n].size) for n, c in every.items()}
        t, columns, own = merged({n: (stamps[n], columns[n]) for n in columns}, where)
        own = {n: rows for n, rows in own.items() if not rows.all()}
        said = "; ".join(
            f"{n} from {1e-9 * (c.start - first):.6g} s on, every {c.interval:g} s" for n, c in every.items()
        )
        notes = (*notes, f"channels with clocks of their own ({said}): aligned by their absolute times")
        columns["time_s"] = t - t[0]
    return Table(Where(source.name), tuple(columns), tuple(columns.values()), by_name=True, notes=notes, own=own)


class _Clock(NamedTuple):
    """When a waveform began, ns after 1970 where it is dated, and seconds between its samples, 0 if nothing is said."""

    start: int
    interval: float
    dated: bool


def _numeric(source: Source, content: Any) -> dict[tuple[str, str], tuple[np.ndarray, dict[str, Any]]]:
    """Numbers and properties of the channels that hold some, by group and name."""
    channels = [c for group in content.groups() for c in group.channels()]
    if len(channels) > LIMITS.variables:
        raise ValueError(f"{len(channels)} channels, at most {LIMITS.variables} are accepted")
    channels = [c for c in channels if c.dtype is not None and c.dtype.kind in "iuf" and len(c)]
    # Nothing in such a file is packed: what it states beyond its size is not there.
    stated = sum(len(c) * c.dtype.itemsize for c in channels)
    source.check_memory(stated, unpacked=True)
    found = {(c.group_name, c.name): (np.asarray(c[:]), dict(c.properties)) for c in channels}
    return {names: (values, of) for names, (values, of) in found.items() if values.ndim == 1 and values.size}


def _clock(properties: Mapping[str, Any]) -> _Clock:
    """Return the clock of a waveform.

    Raises:
        ValueError: what is said is no interval.
    """
    said = properties.get(_INTERVAL, 0.0)
    if isinstance(said, bool) or not isinstance(said, int | float | np.number) or not 0.0 <= said < math.inf:
        raise ValueError(f"its property {_INTERVAL} is {said!r:.60}, not seconds")
    start, offset = properties.get(_START), properties.get(_OFFSET, 0.0)
    dated = isinstance(start, np.datetime64) and not bool(np.isnat(start))
    # Whole nanoseconds: a second since 1970 has not many digits left.
    begun = int(start.astype("datetime64[ns]").astype(np.int64)) if dated and start is not None else 0
    more = float(offset) if isinstance(offset, int | float | np.number) and math.isfinite(offset) else 0.0
    return _Clock(begun + round(1e9 * more), float(said), dated)


def _closed(source: Source) -> bool:
    """Whether the last segment was closed: one that a crash has left says that it reaches to the end of the file.

    Every other one states where the next begins, and the last ends with the file, unless bytes were lost or slipped in.

    Raises:
        ValueError: it does not.
    """
    size, first = source.size, 0
    with source.open() as file:
        while first < size:
            file.seek(first)
            head = file.read(_LEAD_IN)
            if not head.startswith(b"TDSm") or len(head) < _LEAD_IN:
                raise ValueError(f"no segment begins at byte {first}")
            if head[12:20] == _UNCLOSED:
                return False
            first += _LEAD_IN + int.from_bytes(head[12:20], "big" if head[4] & _BIG_ENDIAN else "little")
    if first > size:
        raise ValueError(f"{size} bytes long, its last segment ends at {first}")
    return True


def read_sheet(source: Source) -> Table:
    """Return the columns of the first sheet of a workbook, whose rows are read as those of a text are."""
    with _by_package(source, "openpyxl"):
        import pandas as pd

        with source.open() as file, zipfile.ZipFile(file) as archive:
            source.check_memory(sum(member.file_size for member in archive.infolist()), unpacked=True)
            frame = pd.read_excel(file, header=None, dtype=object)
        text = str(frame.to_csv(sep="\t", header=False, index=False))
    return table_of_lines(source.name, Lines(text))


def read_parquet(source: Source) -> Table:
    """Return the columns of a parquet file, with its index where that is a time."""
    with _by_package(source, "pyarrow"):
        import pandas as pd

        parquet = import_module("pyarrow.parquet")
        with source.open() as file:
            said = parquet.ParquetFile(file).metadata
            source.check_memory(8 * said.num_rows * said.num_columns, unpacked=True)
            return replace(given_frame(pd.read_parquet(file))[1], where=Where(source.name))


@contextmanager
def _by_package(
    source: Source, package: str, install: str = "", remedy: str = "export it again, or as .csv"
) -> Iterator[None]:
    """Refuse a file whose package is not there, and one that the package stumbles over."""
    try:
        yield
    except InputRefused:
        raise
    except ImportError as error:
        raise InputRefused(
            f"{source.name}: {source.suffix} files need the package {package}: pip install {install or package}"
        ) from error
    except Exception as error:  # on damaged bytes the packages raise errors of many kinds
        raise InputRefused(
            f"{source.name}: not a readable {source.suffix} file ({printable(str(error))}): {remedy}"
        ) from error


Reader = Callable[[Source], Table]
READERS: Mapping[str, Reader] = {
    **dict.fromkeys((".csv", ".tsv", ".dat", ".txt", ".asc", ".lvm"), read_text),
    ".mat": read_mat,
    **dict.fromkeys((".h5", ".hdf5"), read_hdf5),
    ".npy": read_npy,
    ".npz": read_npz,
    ".tdms": read_tdms,
    ".json": read_json,
    ".xlsx": read_sheet,
    ".parquet": read_parquet,
}


@dataclass(frozen=True)
class Files:
    """The files of a folder.

    Attributes:
        home: the folder; said: its manifest; outside: files may lie outside.
    """

    home: Path
    said: Manifest
    outside: bool

    def source(self, file: str) -> Source:
        """A file of a recording. Raises InputRefused as `phnn.intake.named_file`."""
        return named_file(self.home / file, (self.home,), outside=self.outside)

    def entries(self) -> tuple[list[Entry], list[str]]:
        """The entries to read, and the files left alone, each with its reason where that is not plain."""
        said, present = self.said, self._present()
        if said.path is not None:
            present = [p for p in present if os.path.realpath(p) != os.path.realpath(said.path)]
        if said.entries is not None:
            where = said.path.name if said.path is not None else "recordings.yaml"
            paths = [(i, self.home / file) for i, entry in enumerate(said.entries) for file in entry.files]
            for i, path in paths:
                if not os.path.lexists(path):
                    name, home = printable(path.name)[:_SHOWN], printable(str(path.parent))[:_SHOWN]
                    raise InputRefused(
                        f"{where}: recordings[{i}]: file {name!r} is not in {home}: correct its name or remove the "
                        f"entry"
                    )
                reader_of(path)
            listed = {os.path.realpath(path) for _, path in paths}
            return list(said.entries), [_shown(p) for p in present if os.path.realpath(p) not in listed]
        chosen, left = [], []
        for path in present:
            reason = self._no_recording(path)
            if reason is None:
                chosen.append(path)
                checks.not_too_many(len(chosen), 0, self.home)
            else:
                left.append(_shown(path) + reason)
        checks.any_recordings(chosen, left, self.home)
        return [replace(said.common, file=path.name) for path in chosen], left

    def possible(self) -> tuple[list[Path], list[str]]:
        """The files that may be recordings, whatever describes them, and what else lies there, in words."""
        present = self._present()
        chosen = [p for p in present if self._numbers(p)]
        checks.not_too_many(len(chosen), 0, self.home)
        return chosen, [_shown(p) for p in present if p not in chosen]

    def _present(self) -> list[Path]:
        """What lies in the folder, without its manifest and hidden files."""
        return [p for p in list_folder(self.home) if not p.name.startswith(".") and p.name != "recordings.yaml"]

    def _numbers(self, path: Path) -> bool:
        """Whether a file has a known format and, where that is text, columns of numbers; a csv is meant to have."""
        kind = path.suffix.lower()
        if kind not in READERS or not os.path.isfile(path):
            return False
        if kind == ".csv" or READERS[kind] is not read_text:
            return True
        try:
            return looks_like_numbers(self.source(path.name))
        except InputRefused:
            return True

    def _no_recording(self, path: Path) -> str | None:
        """Why a file found in the folder is no recording, in words to follow its name; ``None`` if it is one."""
        kind = path.suffix.lower()
        if kind not in READERS or os.path.isdir(path):
            return ""
        if not os.path.isfile(path):
            return " (no regular file)"
        reader, stated = READERS[kind], {c.place for c in self.said.common.columns.values() if c.place is not None}
        if kind == ".csv" or (stated and reader not in (read_text, read_json)):
            return None
        source = self.source(path.name)
        if reader is read_text and not looks_like_numbers(source):
            return ""
        if reader is read_text and stated:
            return None
        try:
            names = reader(source).names
        except NoRecording:
            return " (json without arrays of numbers)"
        # Settings and results in json may lie beside recordings.
        stated = {place for place in stated if isinstance(place, str)}
        described = {p[0] for name in names if name and (p := parse_name(name)) is not None}
        if (stated and stated <= set(names)) or described & {"voltage", "input", "force"}:
            return None
        return " (numbers that nothing describes: to use it, say in recordings.yaml which columns are what)"


def _shown(path: Path) -> str:
    return printable(path.name) + ("/" if os.path.isdir(path) else "")


def reader_of(path: Path) -> Reader:
    """What reads a file of this suffix. Raises InputRefused where nothing does."""
    kind = path.suffix.lower()
    if kind not in READERS:
        raise InputRefused(f"{printable(path.name)}: unknown format {kind!r}: accepted are {', '.join(READERS)}")
    return READERS[kind]
