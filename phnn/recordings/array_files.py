"""Reading arrays: .mat (v5 and v7.3), .h5, .npy and .npz files, and json.

What a file holds is listed first, by name, shape and type; numbers are read when somebody asks for them, after their
size has been held against the memory. Json is an object of arrays of numbers, in groups or not, or a list of records
with the same keys.
"""

from __future__ import annotations

import json
import math
import mmap
import struct
import warnings
import zipfile
import zlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from phnn.errors import InputRefused
from phnn.intake import LIMITS, Source, each_key_once
from phnn.recordings.library_files import matlab_content, readable
from phnn.recordings.manifest import AXES
from phnn.recordings.table import NUMBERS, Stored, Table, Where, experiments_of, stored_arrays, table_of, upright
from phnn.recordings.text_files import read_content
from phnn.results import listed, printable

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
    """The type of an element, the range of its data, and where the following element begins."""

    type: int
    first: int
    last: int
    next: int

    @property
    def size(self) -> int:
        """Return the bytes of its data."""
        return self.last - self.first


def check_layout(raw: Raw, most: int) -> int:
    """Walk all elements of a version 5 file, compressed ones unpacked: damaged ones would end Python within scipy.

    Return how many bytes were unpacked; more than ``most`` where the walk ended before all were looked at. Raises
    BadLayout for an element of unknown type, beyond its container, or of another size than its dimensions say.
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
        element = _Element(kind & 0xFFFF, position + 4, position + 4 + (kind >> 16), position + 8)
        if element.last > element.next:
            raise BadLayout(f"a small element of {kind >> 16} bytes at byte {position}")
    else:
        last = position + 8 + count
        if last > end:
            raise BadLayout(f"an element of {count} bytes at byte {position} reaches beyond its container")
        element = _Element(kind, position + 8, last, min(last + (-count) % 8, end))
    if accepted and element.type not in accepted:
        raise BadLayout(f"unexpected element type {element.type} at byte {position}")
    return element


def _matrix(raw: Raw, matrix: _Element, order: str, depth: int) -> None:
    if matrix.first == matrix.last:
        return  # an empty cell or field
    if depth > _DEEPEST:
        raise BadLayout(f"nested too deeply at byte {matrix.first}")
    end = matrix.last
    flags = _element(raw, matrix.first, end, order, (6,))
    if flags.size != 8:
        raise BadLayout(f"array flags of {flags.size} bytes at byte {matrix.first}")
    (word,) = struct.unpack_from(order + "I", raw, flags.first)
    kind, is_complex = word & 0xFF, bool((word >> 8) & _COMPLEX)
    if kind > _LAST_NUMERIC:
        return  # functions and opaque objects hold no samples
    shape = _element(raw, flags.next, end, order, (5, 6))
    dimensions = struct.unpack_from(f"{order}{shape.size // 4}i", raw, shape.first)
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
            numbers, rest = divmod(element.size, _BYTES[element.type])
            if rest or stated not in (None, numbers):
                cause = f"{element.size} bytes of numbers at byte {position}"
                raise BadLayout(f"{cause} where the dimensions say {stated} numbers")
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
        if length.size != 4 or width <= 0 or names.size % width:
            raise BadLayout(f"field names of {width} characters at byte {position}")
        count *= names.size // width
        position = names.next
    for _ in range(count):
        element = _element(raw, position, end, order, (_MATRIX,))
        _matrix(raw, element, order, depth + 1)
        position = element.next


def read_mat(source: Source) -> Table:
    """Return the numeric variables of a .mat file.

    Vectors are found by name, structure fields as ``name.field``, the columns of a matrix as ``name[0]``, …, signals
    that are structures with a name, data and a unit by that name (ControlDesk, Simulink). Of an array or cells of
    experiments, each is a segment.
    """
    import h5py

    where = Where(source.name)
    content, classes = matlab_content(source) if h5py.is_hdf5(source.path) else _load_v5(source)
    objects = [(printable(name), printable(kind)) for name, kind in classes]
    experiments = {n: e for n, v in content.items() if (e := experiments_of(n, v))}
    arrays = list(stored_arrays({n: v for n, v in content.items() if n not in experiments}))
    if not any(stored.dtype.kind in NUMBERS for stored in arrays) and not experiments and objects:
        name, kind = objects[0]
        # The object of MATLAB's System Identification Toolbox has a time, an input and an output.
        fields = ("SamplingInstants", "InputData", "OutputData") if kind == "iddata" else ()
        time, u, y = (f"{name}.{field}" for field in fields) if fields else ("…", "…", "…")
        cause = f"{name} is an object of class {kind}, whose content only MATLAB can read"
        remedy = f"time_s = {time}; input_V = {u}; output_m = {y}; save('{name}.mat', 'time_s', 'input_V', 'output_m')"
        raise InputRefused(f"{where}: {cause}: save its numbers there, with their units: {remedy}")
    if len(experiments) == 1:
        ((name, columns),) = experiments.items()
        names, values = zip(*columns, strict=True)
        note = f"{name}: {len(values[0])} experiments, each a recording"
        segments = tuple(np.cumsum([v.size for v in values[0]])[:-1].tolist())
        table = Table(where, names, tuple(map(np.concatenate, values)), True, (note,), segments=segments)
    else:
        table = table_of(where, arrays)
    if objects:
        names = listed(f"{name} ({kind})" for name, kind in objects)
        note = f"{names}: left alone, objects that only MATLAB can read"
        table = replace(table, notes=(*table.notes, note))
    return table


_NPZ = "not a readable .npz file", "save it again with numpy.savez"


def read_npz(source: Source) -> Table:
    """Return the arrays of an archive by name, columns as in `read_mat`; those that nobody asks for are not read."""
    with readable(source, *_NPZ), source.open() as file, zipfile.ZipFile(file) as archive:
        members = [m for m in archive.infolist() if m.filename.endswith(".npy")]
        if len(members) > LIMITS.variables:
            raise ValueError(f"{len(members)} arrays, at most {LIMITS.variables} are accepted")
        arrays = [_member(source, archive, member) for member in members]
    return table_of(Where(source.name), arrays)


def _member(source: Source, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> Stored:
    with archive.open(member) as stream:
        shape, dtype = _header(stream)

    def load() -> np.ndarray:
        source.check_memory(math.prod(shape) * dtype.itemsize, member.compress_type != zipfile.ZIP_STORED)
        with readable(source, *_NPZ), source.open() as file, zipfile.ZipFile(file) as archive:
            with archive.open(member) as stream:
                array: np.ndarray = np.lib.format.read_array(stream, allow_pickle=False)
                # The checksum is held against the content at its end.
                if stream.read(1):
                    raise ValueError(f"{member.filename} is longer than it says")
            return array

    return Stored(member.filename[:-4], shape, dtype, load)


def _header(stream: BinaryIO | Any) -> tuple[tuple[int, ...], np.dtype]:
    """Return the shape and type that the head of a .npy file states."""
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0 if version[0] == 1 else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(stream)
    return shape, dtype


def read_npy(source: Source) -> Table:
    """Return a two-dimensional array (samples, columns), or a structured one with named fields."""
    array = _load_npy(source)
    if array.dtype.names:
        names = array.dtype.names
        return Table(Where(source.name), tuple(map(printable, names)), tuple(array.reshape(-1)[n] for n in names))
    if array.ndim != 2:
        remedy = "save it as (samples, columns) with voltage and displacement among the columns"
        other = "say in recordings.yaml what its axes are, such as axes: [time, channel, realisation, period]"
        raise InputRefused(f"{source.name}: an array of shape {array.shape}: {remedy}, or {other}")
    array = upright(array)
    if array.shape[1] > LIMITS.columns:
        raise InputRefused(f"{source.name}: shape {array.shape} is no table of samples: save it as (samples, columns)")
    return Table(Where(source.name), ("",) * array.shape[1], tuple(array.T))


def read_axes(source: Source, axes: Sequence[str]) -> Table:
    """Return an array whose axes are time and any of channel, realisation and period, as of a periodic experiment.

    The periods of a realisation follow one another, and so do the realisations, each a segment.
    """
    if source.suffix != ".npy":
        raise InputRefused(f"{source.name}: `axes` describe a .npy array: leave them out, or save it with numpy.save")
    array = _load_npy(source)
    if array.ndim != len(axes) or array.dtype.kind not in "iuf":
        cause = f"an array of shape {array.shape} and type {array.dtype}, said to have the axes {', '.join(axes)}"
        raise InputRefused(f"{source.name}: {cause}: name as many, of real numbers")
    absent = [name for name in AXES if name not in axes]
    ordered = np.expand_dims(array, tuple(range(array.ndim, 4))).transpose([[*axes, *absent].index(n) for n in AXES])
    channels = ordered.shape[3]
    if channels > LIMITS.columns:
        raise InputRefused(f"{source.name}: {channels} channels: correct the order of `axes`")
    if not array.size:
        raise InputRefused(f"{source.name}: an array of shape {array.shape} holds no samples: save it again")
    columns = ordered.reshape(-1, channels)
    return Table(Where(source.name), ("",) * channels, tuple(columns.T), shape=ordered.shape[:3])


def _load_npy(source: Source) -> np.ndarray:
    with readable(source, "not a readable .npy file", "save it again with numpy.save"), source.open() as file:
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
    with readable(source, "not a readable .mat file", "save it again from MATLAB", typed=True), source.open() as file:
        # Only what is looked at comes into memory.
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as raw:
            # The header names version 5; files of version 4 have none.
            if len(raw) >= HEADER and raw[126:128] in (b"IM", b"MI") and 0 not in raw[:4]:
                source.check_memory(check_layout(raw, LIMITS.unpacked_bytes + source.size), unpacked=True)
        with warnings.catch_warnings():
            warnings.filterwarnings("error", message="We do not support byte ordering")
            content = scipy.io.loadmat(file, simplify_cells=True)
    # Of objects scipy hands on name and class alone.
    opaque = [v for v in content.values() if isinstance(v, np.ndarray) and v.dtype.names == ("s0", "s1", "s2", "arr")]
    objects = [[bytes(v[0][f]).decode("ascii", "replace") for f in ("s0", "s2")] for v in opaque if v.size]
    return {name: value for name, value in content.items() if not name.startswith("__")}, objects


# A text takes at most so many times its size while it is read: an object of 32 bytes for each "0,", and itself.
_TIMES = 20
LINES = ".jsonl"  # a record in each line
_SHOWN = 40
_REMEDY = "save it as an object of arrays of equal length, or as a list of records with the same keys"


class NoRecording(InputRefused):
    """Sound json that holds no arrays of numbers: settings, results, a description."""


def read_json(source: Source) -> Table:
    """Return the arrays of numbers by name; ``null`` and ``NaN`` are missing samples. Raises NoRecording for json of
    another kind, InputRefused where it is damaged, too large, not json, or a sample is no number."""
    source.check_memory(_TIMES * source.size)
    text = read_content(source, LIMITS.json_bytes, "a json recording")
    skipped: list[str] = []
    try:
        if source.suffix == LINES:
            # A record in each line; so many lines as before, for what is told of a line.
            text = "[" + text.strip().replace("\n", ",\n") + "]"
        content = json.loads(text, parse_int=float, object_pairs_hook=each_key_once)
        columns = dict(_columns(content, "", 0, skipped))
    except RecursionError as error:
        raise InputRefused(f"{source.name}: objects or lists too deep in one another: {_REMEDY}") from error
    except json.JSONDecodeError as error:
        cause = f"line {error.lineno}, column {error.colno}: not json ({error.msg}): the file is damaged or was cut"
        raise InputRefused(f"{source.name}: {cause}: save it again") from error
    except ValueError as error:
        raise InputRefused(f"{source.name}: {error}") from error
    if not columns:
        raise NoRecording(f"{source.name}: no arrays of numbers in it: {_REMEDY}")
    notes = (f"{listed(skipped)} are no arrays of numbers and were left alone",) if skipped else ()
    return Table(Where(source.name), tuple(columns), tuple(columns.values()), by_name=True, notes=notes)


def _columns(content: Any, prefix: str, depth: int, skipped: list[str]) -> Iterator[tuple[str, np.ndarray]]:
    """Yield names and numbers of all arrays; ``skipped`` takes the names of other values."""
    if depth > LIMITS.depth:
        raise ValueError(f"objects more than {LIMITS.depth} levels deep: {_REMEDY}")
    if isinstance(content, dict):
        if len(content) > LIMITS.variables:
            raise ValueError(f"an object of more than {LIMITS.variables} keys: save one recording in a file")
        rows, names = content.get("data"), content.get("columns")
        if isinstance(rows, list) and isinstance(names, list) and all(isinstance(n, str) for n in names):
            # Of a pandas frame: the names of its columns, and its rows.
            if any(not isinstance(row, list) or len(row) != len(names) for row in rows):
                raise ValueError(f"data: rows of other lengths than the {len(names)} columns: {_REMEDY}")
            content = dict(zip(names, map(list, zip(*rows, strict=True)), strict=True))
        for key, value in content.items():
            name = prefix + printable(key[: LIMITS.name_characters])
            cells = list(value.values()) if isinstance(value, dict) and all(map(str.isdecimal, value)) else []
            if cells and all(isinstance(cell, float | None) for cell in cells):
                value = cells  # of a pandas frame, too, by the numbers of its rows
            if isinstance(value, list) and value and isinstance(value[0], float | None):
                yield name, _numbers(value, name)
            elif isinstance(value, dict) or (isinstance(value, list) and value and isinstance(value[0], dict)):
                yield from _columns(value, f"{name}.", depth + 1, skipped)
            else:
                skipped.append(name)
    elif isinstance(content, list) and content and isinstance(content[0], dict):
        first = content[0]
        for i, record in enumerate(content, start=1):
            if not isinstance(record, dict) or record.keys() != first.keys():
                odd = sorted(set(first) ^ set(record))[0] if isinstance(record, dict) else str(record)
                raise ValueError(f"record {i} has other keys ({odd[:_SHOWN]!r}): give every record the same keys")
        for key in (k for k in first if isinstance(first[k], float | None)):
            name = prefix + printable(key[: LIMITS.name_characters])
            yield name, _numbers([record[key] for record in content], name)


def _numbers(values: list[Any], name: str) -> np.ndarray:
    """Return the numbers of an array, missing ones as NaN."""
    for i, value in enumerate(values, start=1):
        if not isinstance(value, float | None):
            remedy = "write numbers with a point as decimal sign, and null where a sample is missing"
            raise ValueError(f"{name}, row {i}: {printable(repr(value)[:_SHOWN])} is no number: {remedy}")
    return np.array([np.nan if value is None else value for value in values])
