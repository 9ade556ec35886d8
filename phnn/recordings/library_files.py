"""Reading what a library of its own reads: HDF5, TDMS, workbooks and parquet.

Of HDF5, external storage, external links and virtual datasets are refused, unless the user allows them: a file must not
make the program read another one.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from phnn.errors import InputRefused
from phnn.intake import LIMITS, OUTSIDE, Source
from phnn.recordings.channels import merged
from phnn.recordings.memory import given_frame
from phnn.recordings.table import Stored, Table, Where, table_of
from phnn.recordings.text_files import Lines, table_of_lines
from phnn.recordings.units import split_unit
from phnn.results import listed, printable

# Rows of a sheet in which names are looked for.
_HEAD = 60
# Bytes of an HDF5 superblock up to the length of the file, whatever its version; bytes that are looked at together.
_SUPERBLOCK, _BLOCK = 52, 2**20
# Attributes of the CF conventions: of a unit, of numbers that are packed, of values that are missing.
_UNITS, _MISSING = ("units", "unit"), ("_FillValue", "missing_value")
_PACKED = (("scale_factor", 1.0), ("add_offset", 0.0))
_CLASS, _EMPTY, _OBJECT = "MATLAB_class", "MATLAB_empty", "MATLAB_object_decode"


@contextmanager
def readable(source: Source, kind: str, remedy: str, package: str = "", typed: bool = False) -> Iterator[None]:
    """Refuse a damaged file, on which libraries raise errors of any kind, and one whose package is not there.

    Args:
        kind: what the file is not; remedy: what to do then; package: that reads it.
        typed: say the type of the error too, where its text alone says little.
    """
    try:
        yield
    except InputRefused:
        raise
    except Exception as error:
        if package and isinstance(error, ImportError):
            extra = "'phnn[tdms]'" if package == "npTDMS" else package
            cause = f"{source.suffix} files need the package {package}: pip install {extra}"
            raise InputRefused(f"{source.name}: {cause}") from error
        # Of an error that a library has lost on its way, Python tells the place in memory.
        first = (isinstance(error, SystemError) and error.__cause__) or error
        cause = printable((f"{type(first).__name__}: {first}" if typed else str(first)).rstrip(": "))
        raise InputRefused(f"{source.name}: {kind} ({cause}): {remedy}") from error


def read_hdf5(source: Source) -> Table:
    """Return the columns of all datasets of numbers, those of a group as ``group.dataset``, as `read_mat` does."""
    with _opened(source) as file:
        arrays = (stored for path, item in _walk(file, source) for stored in _stored(source, path, item))
        return table_of(Where(source.name), arrays)


def matlab_content(source: Source) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """Return the variables of a MATLAB file of version 7.3, and paths and classes of the objects in it.

    Structures are mappings, arrays of structures and cells are lists, texts are texts, numbers are `Stored`.
    """
    with _opened(source, matlab=True) as file:
        top = dict.fromkeys(name.partition("/")[0] for name, _ in _walk(file, source))
        objects: dict[str, str] = {}
        content = {n: _decoded(source, file, n, file[n], objects) for n in top}
        return {n: v for n, v in content.items() if n not in objects}, list(objects.items())


@contextmanager
def _opened(source: Source, matlab: bool = False) -> Iterator[Any]:
    import h5py

    kind = "damaged .mat v7.3 file" if matlab else "not a readable HDF5 file"
    remedy = "save it again from MATLAB" if matlab else "export it again"
    with readable(source, kind, remedy), h5py.File(source.path, "r") as file:
        _check_length(source, file.userblock_size)
        yield file


def _outside(source: Source, cause: str) -> InputRefused:
    """Return the refusal of a part of the content that lies in another file."""
    remedy = f"copy everything into one file, or give the option {OUTSIDE} if you trust who made it"
    return InputRefused(f"{source.name}: {cause}: {remedy}")


def _walk(file: Any, source: Source) -> Iterator[tuple[str, Any]]:
    """Yield path and dataset of everything in a file, in the order of the names, every link once.

    Without leave, no link and no dataset may lead to another file.
    """
    import h5py

    links: dict[str, Any] = {}

    def visit(name: str, link: Any) -> Exception | None:
        # What is returned ends the walk; what is raised would be lost within the library.
        if name.count("/") >= LIMITS.depth:
            return ValueError(f"groups more than {LIMITS.depth} levels deep")
        if isinstance(link, h5py.ExternalLink) and not source.outside:
            return _outside(source, f"/{name} is a link to the file {printable(str(link.filename))!r}")
        links[name] = link
        return None

    if (stopped := file.visititems_links(visit)) is not None:
        raise stopped
    count = 0
    for name, link in links.items():
        if any(part.startswith("#") for part in name.split("/")):
            continue
        # A link without a target, or round in a circle, has no item.
        item = file.get(name)
        several = [(name, item)]
        if not isinstance(link, h5py.HardLink) and isinstance(item, h5py.Group):
            several = []
            item.visititems(lambda inner, x, outer=name, into=several: into.append((f"{outer}/{inner}", x)))
        for path, one in several:
            if not isinstance(one, h5py.Dataset) or one.shape is None:
                continue
            _check_dataset(source, one)
            count += 1
            if count > LIMITS.variables:
                raise ValueError(f"more than {LIMITS.variables} datasets")
            yield path, one


def _check_dataset(source: Source, dataset: Any) -> None:
    """Refuse numbers that may lie in other files."""
    if source.outside:
        return
    if dataset.external:
        raise _outside(source, f"{dataset.name} has its numbers in the file {printable(str(dataset.external[0][0]))!r}")
    if dataset.is_virtual:
        parts = ", ".join(printable(str(part.file_name)) for part in dataset.virtual_sources()[:3])
        raise _outside(source, f"{dataset.name} is a virtual dataset, made of parts of {parts!r}")


def _stored(source: Source, path: str, item: Any, matlab: bool = False) -> Iterator[Stored]:
    """Yield a dataset, or the fields of a table; MATLAB stores every array transposed."""
    name = path.strip("/").replace("/", ".")
    attributes = {} if matlab else dict(item.attrs)
    unit = next((printable(_text(attributes[key])) for key in _UNITS if key in attributes), "")
    # Numbers that are packed, or were never written, take less room in the file.
    packed = item.id.get_storage_size() < item.nbytes
    for field in item.dtype.names or (None,):
        dtype = item.dtype if field is None else item.dtype[field]
        shape = item.shape[::-1] if matlab else item.shape
        size = math.prod(shape) * dtype.itemsize

        def load(field: str | None = field, size: int = size) -> np.ndarray:
            source.check_memory(size, packed)
            with _opened(source, matlab) as file:
                array = np.asarray(file[path][field] if field is not None else file[path][()])
            return array.T if matlab else _unpacked(array, attributes)

        yield Stored(name if field is None else f"{name}.{field}", shape, dtype, load, unit)


def _unpacked(array: np.ndarray, attributes: dict[str, Any]) -> np.ndarray:
    """Return the numbers that an array stands for by its attributes, missing ones as NaN."""
    if array.dtype.kind not in "iuf":
        return array
    missing = [float(v) for key in _MISSING if key in attributes for v in np.atleast_1d(attributes[key])]
    scale, offset = (float(np.ravel(attributes.get(key, usual))[0]) for key, usual in _PACKED)
    hidden = np.isin(array, missing) if missing else np.zeros(0, dtype=bool)
    if scale == 1.0 and offset == 0.0 and not hidden.any():
        return array
    values = array * scale + offset
    return np.where(hidden, np.nan, values) if hidden.any() else values


def _decoded(source: Source, file: Any, path: str, item: Any, objects: dict[str, str], depth: int = 0) -> Any:
    """Return a variable of MATLAB as `matlab_content` says; None where it is an object or of no known kind."""
    import h5py

    if depth > LIMITS.depth:
        return None
    if _OBJECT in item.attrs:
        # It holds a number by which MATLAB finds the content.
        objects[path.strip("/").replace("/", ".")] = _class(item)
        return None
    if isinstance(item, h5py.Group):
        fields = {n: item[n] for n in item}
        content = {n: _decoded(source, file, f"{path}/{n}", x, objects, depth + 1) for n, x in fields.items()}
        datasets = [x for x in fields.values() if isinstance(x, h5py.Dataset)]
        # The fields of an array of structures are references that are no cells.
        arrays = [x for x in datasets if h5py.check_ref_dtype(x.dtype) and _class(x) != "cell"]
        if not content or len(arrays) < len(content) or len({len(v) for v in content.values()}) != 1:
            return content
        return [dict(zip(content, values, strict=True)) for values in zip(*content.values(), strict=True)]
    if not isinstance(item, h5py.Dataset) or item.shape is None:
        return None
    _check_dataset(source, item)
    if _EMPTY in item.attrs:
        return np.empty((0, 0))
    if h5py.check_ref_dtype(item.dtype):
        if item.size > LIMITS.variables:
            raise ValueError(f"{item.name} has more than {LIMITS.variables} cells")
        cells = (file[ref] for ref in item[()].T.ravel())
        return [_decoded(source, file, cell.name, cell, objects, depth + 1) for cell in cells]
    if _class(item) == "char":
        source.check_memory(item.nbytes, True)
        return "".join(map(chr, np.asarray(item[()]).T.ravel()))
    parts = {s.name.rpartition(".")[2]: s for s in _stored(source, path, item, matlab=True)}
    return next(iter(parts.values())) if item.dtype.names is None else parts


def _class(item: Any) -> str:
    return _text(item.attrs.get(_CLASS, b""))


def _text(value: Any) -> str:
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return str(np.ravel(value)[0] if np.ndim(value) else value)


def _check_length(source: Source, superblock: int) -> None:
    """Refuse another length than the superblock states; bytes that slipped in have moved what lies behind them.

    Zeros at the end, which fill a block, have not. Raises ValueError.
    """
    with source.open() as file:
        file.seek(superblock)
        head = file.read(_SUPERBLOCK)
        end = 28 if head[8] > 1 else 40 + 4 * head[8]
        stated = int.from_bytes(head[end : end + 8], "little")
        file.seek(min(stated, source.size))
        while not any(block := file.read(_BLOCK)) and block:
            pass
        if stated > source.size or block:
            raise ValueError(f"{source.size} bytes long, and says that it has {stated}")


# Bytes before the content of a segment, and the flag of its first byte order.
_LEAD_IN, _BIG_ENDIAN, _UNCLOSED = 28, 1 << 6, b"\xff" * 8
_INTERVAL, _START, _OFFSET, _UNIT = "wf_increment", "wf_start_time", "wf_start_offset", "unit_string"


def read_tdms(source: Source) -> Table:
    """Return the numeric channels as ``group.channel``, with units; waveforms of one interval bring their time."""
    where = Where(source.name)
    columns: dict[str, np.ndarray] = {}
    clocks: dict[str, _Clock] = {}
    with readable(source, "not a readable .tdms file", "export it again", "npTDMS"):
        from nptdms import TdmsFile

        closed = _closed(source)
        with source.open() as file, TdmsFile.open(file) as content:
            channels = [c for group in content.groups() for c in group.channels()]
            if len(channels) > LIMITS.variables:
                raise ValueError(f"{len(channels)} channels, at most {LIMITS.variables} are accepted")
            channels = [c for c in channels if c.dtype is not None and c.dtype.kind in "iuf" and len(c)]
            # Nothing in such a file is packed: what it states beyond its size is not there.
            source.check_memory(sum(len(c) * c.dtype.itemsize for c in channels), unpacked=True)
            several = len({c.group_name for c in channels}) > 1
            for c in channels:
                unit = str(c.properties.get(_UNIT, "")).strip()
                shown = f"{c.name} [{unit}]" if unit and not c.name.endswith(("]", ")")) else c.name
                shown = printable(f"{c.group_name}.{shown}" if several else shown)
                if shown in columns:
                    raise InputRefused(f"{where}: two channels are called {shown}: rename one of them, or remove it")
                columns[shown], clocks[shown] = np.asarray(c[:]), _clock(c.properties)
    if not columns:
        raise InputRefused(f"{where}: no numeric channels in it: record it again or remove it")
    notes: tuple[str, ...] = ()
    if not closed:
        # What was not written of a channel is missing in all.
        whole = min(values.size for values in columns.values())
        columns = {name: values[:whole] for name, values in columns.items()}
        notes = ("the file was not closed, its channels are as long as the shortest",)
    sampled: dict[str, np.ndarray] = {}
    one, *others = set(clocks.values())
    if one.interval > 0.0 and not others:
        columns.setdefault("time_s", one.interval * np.arange(max(values.size for values in columns.values())))
    elif all(clock.interval > 0.0 for clock in (one, *others)):
        first = min(clock.start for clock in clocks.values())
        begun = {n: 1e-9 * (c.start - first) for n, c in clocks.items()}
        if not all(clock.dated for clock in clocks.values()):
            timing = "; ".join(f"{name}: every {clock.interval:g} s" for name, clock in clocks.items())
            cause = f"channels with clocks of their own, and not all say when they began ({timing})"
            raise InputRefused(f"{where}: {cause}: write {_START} with each waveform, or export them with one time")
        stamps = {n: (begun[n] + c.interval * np.arange(columns[n].size), columns[n]) for n, c in clocks.items()}
        t, columns, sampled = merged(stamps, where)
        timing = "; ".join(f"{n} from {begun[n]:.6g} s on, every {c.interval:g} s" for n, c in clocks.items())
        notes = (*notes, f"channels with clocks of their own ({timing}): aligned by their absolute times")
        columns["time_s"] = t - t[0]
        sampled = {n: rows for n, rows in sampled.items() if not rows.all()}
    return Table(where, tuple(columns), tuple(columns.values()), by_name=True, notes=notes, sampled=sampled)


class _Clock(NamedTuple):
    """When a waveform began, ns after 1970 where it is dated, and seconds between its samples, 0 if nothing is said."""

    start: int
    interval: float
    dated: bool


def _clock(properties: Mapping[str, Any]) -> _Clock:
    """Return the clock of a waveform. Raises ValueError where what is said is no interval."""
    step = properties.get(_INTERVAL, 0.0)
    if isinstance(step, bool) or not isinstance(step, int | float | np.number) or not 0.0 <= step < math.inf:
        raise ValueError(f"its property {_INTERVAL} is {step!r:.60}, not seconds")
    start, offset = properties.get(_START), properties.get(_OFFSET, 0.0)
    dated = isinstance(start, np.datetime64) and not bool(np.isnat(start))
    # Whole nanoseconds: a second since 1970 has not many digits left.
    begun = int(start.astype("datetime64[ns]").astype(np.int64)) if dated and start is not None else 0
    more = float(offset) if isinstance(offset, int | float | np.number) and math.isfinite(offset) else 0.0
    return _Clock(begun + round(1e9 * more), float(step), dated)


def _closed(source: Source) -> bool:
    """Return whether the last segment was closed: one that a crash has left says that it reaches to the file's end.

    Every other one states where the next begins, and the last ends with the file, unless bytes were lost or slipped in:
    then ValueError is raised.
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


def read_sheet(source: Source, named: Collection[str] = ()) -> Table:
    """Return the columns of the sheet of a workbook that has most of some names, of the longest one otherwise.

    Its rows are read as those of a text are.
    """
    with readable(source, "not a readable .xlsx file", "export it again, or as .csv", "openpyxl"):
        import pandas as pd

        with source.open() as file, zipfile.ZipFile(file) as archive:
            source.check_memory(sum(member.file_size for member in archive.infolist()), unpacked=True)
            with pd.ExcelFile(file, engine="openpyxl") as book:
                titles = [sheet.title for sheet in book.book.worksheets]
                sheets = pd.read_excel(book, sheet_name=titles, header=None, dtype=object)
            # A text stands once in the file, however many cells show it.
            lengths = (sheet.map(lambda cell: len(str(cell))).to_numpy().sum() for sheet in sheets.values())
            source.check_memory(int(sum(lengths)), unpacked=True)

        def worth(title: str) -> tuple[int, int]:
            cells = {str(cell).strip() for cell in sheets[title].iloc[:_HEAD].to_numpy().ravel()}
            return len({form for cell in cells for form in (cell, split_unit(cell)[0])} & {*named}), len(sheets[title])

        chosen = max(titles, key=worth)
        text = str(sheets[chosen].to_csv(sep="\t", header=False, index=False))
    table = table_of_lines(source.name, Lines(text, source.name))
    if others := [title for title in titles if title != chosen and sheets[title].size]:
        note = f"of its sheets {printable(chosen)} is read, not {listed(map(printable, others))}"
        table = replace(table, notes=(*table.notes, note))
    return table


def read_parquet(source: Source) -> Table:
    """Return the columns of a parquet file, with its index where that is a time."""
    with readable(source, "not a readable .parquet file", "export it again, or as .csv", "pyarrow"):
        parquet, compute = import_module("pyarrow.parquet"), import_module("pyarrow.compute")
        with source.open() as file:
            content = parquet.ParquetFile(file)
            source.check_memory(8 * content.metadata.num_rows * content.metadata.num_columns, unpacked=True)
            # Lists are no samples; a text stands once here too.
            names = [field.name for field in content.schema_arrow if not field.type.num_fields]
            table = parquet.read_table(file, columns=names, read_dictionary=names, page_checksum_verification=True)
            texts = [part for column in table.columns for part in column.chunks if "string" in str(part.type)]
            sizes = (compute.binary_length(text.dictionary).take(text.indices) for text in texts)
            source.check_memory(sum(compute.sum(size).as_py() or 0 for size in sizes), unpacked=True)
        return given_frame(table.to_pandas(), where=Where(source.name))[1]
