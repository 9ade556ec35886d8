"""Reading arrays: .mat (v5 and v7.3), .h5, .npy and .npz files.

What a file holds is listed first, by name, shape and type; numbers are read when somebody asks for them, after their
size has been held against the memory.
"""

from __future__ import annotations

import math
import mmap
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from phnn.errors import InputRefused
from phnn.intake.files import Source
from phnn.intake.limits import LIMITS
from phnn.recordings.hdf5_files import datasets, is_hdf5, matlab_content
from phnn.recordings.iddata import FIELDS, KIND, iddata_table, is_iddata, refused_object
from phnn.recordings.table import NUMBERS, Column, Stored, Table, Where
from phnn.results import printable

# The layout is that of MathWorks' "MAT-File Format": a header of 128 bytes, then tagged elements, matrices nested.
# The content of a file: read, or mapped into memory.
Raw = bytes | mmap.mmap
HEADER = 128
_MATRIX, _COMPRESSED = 14, 15
_BYTES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}  # numeric element types
_TEXT = frozenset({1, 2, 3, 4, 16, 17, 18})
_CELL, _STRUCT, _IN_OBJECT, _CHAR, _SPARSE, _FIRST_NUMERIC, _LAST_NUMERIC = 1, 2, 3, 4, 5, 6, 15
_COMPLEX = 0x08
_DEEPEST = 50


class BadLayout(ValueError):
    """An element that does not fit; the message says where."""


class _Element(NamedTuple):
    type: int
    first: int  # of its data
    last: int
    next: int  # where the following element begins


def is_v5(raw: Raw) -> bool:
    """Whether the header names version 5; version 4 files have none."""
    return len(raw) >= HEADER and raw[126:128] in (b"IM", b"MI") and 0 not in raw[:4]


def check_layout(raw: Raw, most: int) -> int:
    """Walk all elements of a version 5 file, compressed ones unpacked.

    Args:
        most: bytes that are unpacked at most.

    Returns:
        How many bytes were unpacked; more than ``most`` where the walk ended before all were looked at.

    Raises:
        BadLayout: an element of unknown type, one that reaches beyond its container, or data of another size
            than the dimensions say.
    """
    order = "<" if raw[126:128] == b"IM" else ">"
    position, unpacked = HEADER, 0
    while position < len(raw):
        element = _element(raw, position, len(raw), order)
        if element.type == _MATRIX:
            _matrix(raw, element, order, 0)
        elif element.type == _COMPRESSED:
            stream = zlib.decompressobj()
            with memoryview(raw) as view, view[element.first : element.last] as packed:
                inner = stream.decompress(packed, most - unpacked + 1)
            unpacked += len(inner)
            if unpacked > most:
                return unpacked
            if not stream.eof:
                raise BadLayout(f"the compressed element at byte {element.first} has no end")
            _matrix(inner, _element(inner, 0, len(inner), order, (_MATRIX,)), order, 0)
        else:
            raise BadLayout(f"unknown element type {element.type} at byte {position}")
        # compressed elements are not padded to 8 bytes
        position = element.last if element.type == _COMPRESSED else element.next
    return unpacked


def _element(raw: Raw, position: int, end: int, order: str, accepted: Collection[int] = ()) -> _Element:
    """Return the element at a position, of one of the accepted types where these are given."""
    if position + 8 > end:
        raise BadLayout(f"the file ends within an element at byte {position}")
    kind, count = struct.unpack_from(order + "II", raw, position)
    if kind >> 16:  # a small element: type and size share four bytes, the data takes the other four
        found = _Element(kind & 0xFFFF, position + 4, position + 4 + (kind >> 16), position + 8)
        if found.last > found.next:
            raise BadLayout(f"a small element of {kind >> 16} bytes at byte {position}")
    else:
        last = position + 8 + count
        if last > end:
            raise BadLayout(f"an element of {count} bytes at byte {position} reaches beyond its container")
        found = _Element(kind, position + 8, last, min(last + (-count) % 8, end))
    if accepted and found.type not in accepted:
        raise BadLayout(f"unexpected element type {found.type} at byte {position}")
    return found


def _matrix(raw: Raw, matrix: _Element, order: str, depth: int) -> None:
    if matrix.first == matrix.last:
        return  # an empty cell or field
    if depth > _DEEPEST:
        raise BadLayout(f"nested too deeply at byte {matrix.first}")
    end = matrix.last
    flags = _element(raw, matrix.first, end, order, (6,))
    if flags.last - flags.first != 8:
        raise BadLayout(f"array flags of {flags.last - flags.first} bytes at byte {matrix.first}")
    (word,) = struct.unpack_from(order + "I", raw, flags.first)
    kind, is_complex = word & 0xFF, bool((word >> 8) & _COMPLEX)
    if kind > _LAST_NUMERIC:
        return  # functions and opaque objects hold no samples
    shape = _element(raw, flags.next, end, order, (5, 6))
    dimensions = struct.unpack_from(f"{order}{(shape.last - shape.first) // 4}i", raw, shape.first)
    if len(dimensions) < 2 or min(dimensions) < 0:
        raise BadLayout(f"dimensions {dimensions} at byte {flags.next}")
    position, count = _element(raw, shape.next, end, order, (1, 16)).next, math.prod(dimensions)
    if kind in (_CELL, _STRUCT, _IN_OBJECT):
        _nested(raw, position, end, order, kind, count, depth)
    elif kind == _CHAR:
        _element(raw, position, end, order, _TEXT)
    elif kind == _SPARSE or kind >= _FIRST_NUMERIC:
        # Real and imaginary part of so many numbers; of a sparse array, of None, rows and columns before them.
        stated = None if kind == _SPARSE else count
        for _ in range((3 if stated is None else 1) + is_complex):
            element = _element(raw, position, end, order, _BYTES)
            size = element.last - element.first
            if size % _BYTES[element.type] or (stated is not None and size != stated * _BYTES[element.type]):
                raise BadLayout(f"{size} bytes of numbers at byte {position} where the dimensions say {stated} numbers")
            position = element.next
    else:
        raise BadLayout(f"unknown array class {kind} at byte {matrix.first}")


def _nested(raw: Raw, position: int, end: int, order: str, kind: int, count: int, depth: int) -> None:
    if kind == _IN_OBJECT:
        position = _element(raw, position, end, order, (1,)).next
    if kind != _CELL:
        length = _element(raw, position, end, order, (5,))
        names = _element(raw, length.next, end, order, (1,))
        (width,) = struct.unpack_from(order + "i", raw, length.first)
        if length.last - length.first != 4 or width <= 0 or (names.last - names.first) % width:
            raise BadLayout(f"field names of {width} characters at byte {position}")
        count *= (names.last - names.first) // width
        position = names.next
    for _ in range(count):
        element = _element(raw, position, end, order, (_MATRIX,))
        _matrix(raw, element, order, depth + 1)
        position = element.next


_SHOWN = 5


def read_mat(source: Source) -> Table:
    """Return the numeric variables of a .mat file.

    Vectors are found by name, structure fields as ``name.field``, the columns of a matrix as ``name[0]``, …, signals
    that are structures with a name, data and a unit by that name (ControlDesk, Simulink). A structure with the fields
    of an ``iddata`` brings its time and its channels besides; of an array or cells of experiments, each is a segment.
    """
    where = Where(source.name)
    content, classes = matlab_content(source) if is_hdf5(source) else _load_v5(source)
    objects = [name for name, kind in classes if kind == KIND]
    structures = {n: v for n, v in content.items() if isinstance(v, Mapping) and is_iddata(v)}
    if len(structures) > 1:
        raise InputRefused(f"{where}: several iddata ({', '.join(structures)}): save each into a file of its own")
    experiments = {n: e for n, v in content.items() if (e := _experiments(n, v))}
    found = list(stored_arrays({n: v for n, v in content.items() if n not in experiments}))
    if not any(stored.dtype.kind in NUMBERS for stored in found) and not experiments and objects:
        raise refused_object(where, printable(objects[0]))
    if len(experiments) == 1:
        ((name, columns),) = experiments.items()
        names, values = zip(*columns, strict=True)
        note = f"{name}: {len(values[0])} experiments, each a recording"
        segments = tuple(np.cumsum([v.size for v in values[0]])[:-1].tolist())
        table = Table(where, names, tuple(map(np.concatenate, values)), True, (note,), segments=segments)
    else:
        table = table_of(where, found)
    if objects:
        note = f"{printable(', '.join(objects))}: left alone, objects that only MATLAB can read"
        table = replace(table, notes=(*table.notes, note))
    fields = ({k: _loaded(v) for k, v in one.items() if k in FIELDS} for one in structures.values())
    return table.with_columns_of(iddata_table(where, *fields)) if structures else table


def _loaded(value: Any) -> Any:
    """Return a value of a structure with its numbers read."""
    if isinstance(value, list):
        return [_loaded(v) for v in value]
    return value.load() if isinstance(value, Stored) else value


def _experiments(name: str, value: Any) -> list[tuple[str, list[np.ndarray]]]:
    """Return the columns that the experiments of an array of structures or of a cell array share; empty for others.

    A column is its name, and its (n,) values in each experiment.
    """
    members = _members(value)
    if len(members) < 2:
        return []
    one = members[0]
    if all(isinstance(m, Mapping) for m in members):
        if any(m.keys() != one.keys() or _signal(m) for m in members):
            return []
        keys = [k for k in one if all(_is_vector(m[k]) for m in members)]
        parts = [(printable(k), [np.ravel(_loaded(m[k])) for m in members]) for k in keys]
    else:
        arrays = [_loaded(m) for m in members if isinstance(m, Stored | np.ndarray)]
        if len(arrays) < len(members) or len({a.shape[1:] for a in arrays}) > 1 or arrays[0].ndim != 2:
            return []
        width = min(arrays[0].shape[1], LIMITS.columns)
        parts = [(f"{name}[{i}]", [a[:, i] for a in arrays]) for i in range(width)]
    sizes = {tuple(v.size for v in values) for _, values in parts}
    return parts if len(parts) > 1 and len(sizes) == 1 and min(*sizes.pop(), LIMITS.columns) > 1 else []


def _members(value: Any) -> list[Any]:
    """Return the members of a cell array or an array of structures; empty for anything else."""
    if isinstance(value, np.ndarray) and value.dtype == object:
        return list(value.ravel())
    return list(value) if isinstance(value, list) else []


def _is_vector(value: Any) -> bool:
    if not isinstance(value, Stored | np.ndarray) or value.dtype.kind not in NUMBERS:
        return False
    return max(value.shape, default=1) == math.prod(value.shape) > 1


# Fields of a structure that is a signal: its name, its numbers and its unit.
_NAMES, _DATA = ("Name", "name", "label", "title"), ("Data", "data", "values", "Values")
_UNITS = ("Unit", "unit", "Units", "units")


def _signal(value: Any) -> Stored | None:
    """Return the numbers of a structure that is a signal, with its name and unit; None for any other."""
    if not isinstance(value, Mapping):
        return None
    held = next((value[k] for k in _DATA if k in value), None)
    if not isinstance(held, Stored | np.ndarray) or held.dtype.kind not in NUMBERS or max(held.shape, default=1) < 2:
        return None
    if not any(k in value for k in _NAMES):
        return None
    texts = {k: v.strip() for k, v in value.items() if isinstance(v, str) and v.strip()}
    name, unit = (next((texts[k] for k in keys if k in texts), "") for keys in (_NAMES, _UNITS))
    return Stored(name.strip("<>"), held.shape, held.dtype, held.load if isinstance(held, Stored) else held.view, unit)


def read_hdf5(source: Source) -> Table:
    """Return the numeric datasets of an HDF5 file, those of a group as ``group.dataset``, columns as in `read_mat`."""
    return table_of(Where(source.name), datasets(source))


def read_npz(source: Source) -> Table:
    """The arrays of an archive by name, columns as in `read_mat`; those that nobody asks for are not read."""
    with _readable(source, ".npz", "with numpy.savez"), source.open() as file, zipfile.ZipFile(file) as archive:
        members = [m for m in archive.infolist() if m.filename.endswith(".npy")]
        if len(members) > LIMITS.variables:
            raise ValueError(f"{len(members)} arrays, at most {LIMITS.variables} are accepted")
        found = [_member(source, archive, member) for member in members]
    return table_of(Where(source.name), found)


def _member(source: Source, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> Stored:
    with archive.open(member) as stream:
        shape, dtype = _header(stream)

    def load() -> np.ndarray:
        source.check_memory(math.prod(shape) * dtype.itemsize, member.compress_type != zipfile.ZIP_STORED)
        with _readable(source, ".npz", "with numpy.savez"), source.open() as file, zipfile.ZipFile(file) as archive:
            with archive.open(member) as stream:
                array: np.ndarray = np.lib.format.read_array(stream, allow_pickle=False)
                # The checksum is held against the content at its end.
                if stream.read(1):
                    raise ValueError(f"{member.filename} is longer than it says")
            return array

    return Stored(member.filename[:-4], shape, dtype, load)


@contextmanager
def _readable(source: Source, kind: str, remedy: str) -> Iterator[None]:
    """Refuse a damaged file, on which numpy, scipy and zipfile raise errors of any kind; a refusal stays as it is."""
    try:
        yield
    except InputRefused:
        raise
    except Exception as error:
        cause = f"{type(error).__name__}: {error}" if kind == ".mat" else printable(str(error))
        raise InputRefused(f"{source.name}: not a readable {kind} file ({cause}): save it again {remedy}") from error


def _header(stream: BinaryIO | Any) -> tuple[tuple[int, ...], np.dtype]:
    """Shape and type that the head of a .npy file states."""
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0 if version[0] == 1 else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(stream)
    return shape, dtype


def stored_arrays(content: Mapping[str, Any], prefix: str = "") -> Iterator[Stored]:
    """Yield the values of a mapping as arrays, those of one in it as ``group.name``, signals by their names too."""
    for name, value in content.items():
        full = prefix + name
        members = _members(value)
        if any(isinstance(m, Mapping | Stored) for m in members):
            yield from stored_arrays({f"[{i}]": m for i, m in enumerate(members)}, full)
        elif isinstance(value, Mapping):
            signal = _signal(value)
            if signal is not None:
                time = not signal.name and signal.unit in ("s", "ms", "us")
                yield replace(signal, name=signal.name or ("time" if time else full))
            elif "signals" in value and _is_vector(value.get("time")):
                # A scope of Simulink, "structure with time".
                yield from stored_arrays({"time": {"name": "time", "data": value["time"], "unit": "s"}})
            yield from stored_arrays(value, full + ".")
        elif isinstance(value, Stored):
            yield replace(value, name=full)
        elif hasattr(value, "magnitude") and hasattr(value, "units"):
            # A quantity of pint.
            array = np.asarray(value.magnitude)
            yield Stored(full, array.shape, array.dtype, array.view, f"{value.units:~C}")
        else:
            masked = isinstance(value, np.ma.MaskedArray)
            array = np.ma.filled(value.astype(float), np.nan) if masked else np.asarray(value)
            yield Stored(full, array.shape, array.dtype, array.view)


def table_of(where: Where, found: Iterable[Stored]) -> Table:
    """Return the columns of all arrays of numbers, by name; of several of one name, the first."""
    columns: dict[str, Column] = {}
    units: dict[str, str] = {}
    left: list[str] = []
    for stored in found:
        name = printable(stored.name)
        shape = tuple(n for n in stored.shape if n != 1)
        if stored.dtype.kind not in NUMBERS:
            continue
        load = cache(stored.load)
        if len(shape) <= 1:
            several = {name: _column(load)}
        elif len(shape) == 2 and shape[1] <= LIMITS.columns:
            several = {f"{name}[{i}]": _column(load, i) for i in range(shape[1])}
        else:
            left.append(f"{name}, {' × '.join(map(str, stored.shape))}")
            continue
        columns |= {n: c for n, c in several.items() if n not in columns}
        units |= {n: stored.unit for n in several if stored.unit and n not in units}
    if not columns:
        more = f" (left out, with more than {LIMITS.columns} columns: {'; '.join(left[:_SHOWN])})" if left else ""
        raise InputRefused(f"{where}: no numeric variables in it{more}: save the samples as vectors")
    return Table(where, tuple(columns), tuple(columns.values()), by_name=True, units=units)


def _column(load: Callable[[], np.ndarray], i: int | None = None) -> Column:
    """Return what reads the i-th column of an array; without an index, the array as a vector."""
    return lambda: np.atleast_1d(np.squeeze(load())) if i is None else np.squeeze(load())[:, i]


def read_npy(source: Source) -> Table:
    """A two-dimensional array (samples, columns), or a structured one with named fields."""
    array, most = _load_npy(source), LIMITS.columns
    if array.dtype.names:
        names = array.dtype.names
        return Table(Where(source.name), tuple(map(printable, names)), tuple(array.reshape(-1)[n] for n in names))
    if array.ndim != 2:
        raise InputRefused(
            f"{source.name}: an array of shape {array.shape}: save it as (samples, columns) with voltage and "
            f"displacement among the columns, or say in recordings.yaml what its axes are, such as "
            f"axes: [time, channel, realisation, period]"
        )
    if array.shape[0] < array.shape[1] and array.shape[0] <= most:
        array = array.T  # channels along the first axis: never more channels than samples
    if array.shape[1] > most:
        raise InputRefused(f"{source.name}: shape {array.shape} is no table of samples: save it as (samples, columns)")
    return Table(Where(source.name), ("",) * array.shape[1], tuple(array.T))


# Axes of an array of a periodic experiment, in the order in which it is read.
_AXES = ("realisation", "period", "time", "channel")


def read_axes(source: Source, axes: Sequence[str]) -> Table:
    """An array whose axes are time and any of channel, realisation and period, as of a periodic experiment.

    The periods of a realisation follow one another, and so do the realisations, each a segment.
    """
    if source.suffix != ".npy":
        raise InputRefused(f"{source.name}: `axes` describe a .npy array: leave them out, or save it with numpy.save")
    array = _load_npy(source)
    if array.ndim != len(axes) or array.dtype.kind not in "iuf":
        raise InputRefused(
            f"{source.name}: an array of shape {array.shape} and type {array.dtype}, said to have the axes "
            f"{', '.join(axes)}: name as many, of real numbers"
        )
    absent = [name for name in _AXES if name not in axes]
    ordered = np.expand_dims(array, tuple(range(array.ndim, 4))).transpose([[*axes, *absent].index(n) for n in _AXES])
    channels = ordered.shape[3]
    if channels > LIMITS.columns:
        raise InputRefused(f"{source.name}: {channels} channels: correct the order of `axes`")
    if not array.size:
        raise InputRefused(f"{source.name}: an array of shape {array.shape} holds no samples: save it again")
    columns = ordered.reshape(-1, channels)
    return Table(Where(source.name), ("",) * channels, tuple(columns.T), shape=ordered.shape[:3])


def _load_npy(source: Source) -> np.ndarray:
    with _readable(source, ".npy", "with numpy.save"), source.open() as file:
        shape, dtype = _header(file)
        size, held = math.prod(shape) * dtype.itemsize, source.size - file.tell()
        if size > held:
            raise ValueError(f"its head states {size} bytes of numbers, {held} follow")
        source.check_memory(size)
        file.seek(0)
        array: np.ndarray = np.load(file, allow_pickle=False)
        return array


def _load_v5(source: Source) -> tuple[Mapping[str, Any], Sequence[Sequence[str]]]:
    """Return the variables of a file of version 5 or 4, and names and classes of its objects."""
    import scipy.io

    if source.size == 0:
        raise InputRefused(f"{source.name}: the file is empty: record it again or remove it")
    source.check_memory(source.size)
    with _readable(source, ".mat", "from MATLAB"), source.open() as file:
        # Only what is looked at comes into memory.
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as raw:
            if is_v5(raw):
                source.check_memory(check_layout(raw, LIMITS.unpacked_bytes + source.size), unpacked=True)
        with warnings.catch_warnings():
            warnings.filterwarnings("error", message="We do not support byte ordering")
            content = scipy.io.loadmat(file, simplify_cells=True)
    # Of objects scipy hands on name and class alone.
    opaque = [v for v in content.values() if isinstance(v, np.ndarray) and v.dtype.names == ("s0", "s1", "s2", "arr")]
    objects = [[bytes(v[0][f]).decode("ascii", "replace") for f in ("s0", "s2")] for v in opaque if v.size]
    return {name: value for name, value in content.items() if not name.startswith("__")}, objects
