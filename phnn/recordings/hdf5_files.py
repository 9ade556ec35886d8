"""The datasets of an HDF5 file: those that lie in the file itself.

External storage, external links and virtual datasets are refused, unless the user allows them: a file must not make
the program read another one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from phnn.errors import InputRefused
from phnn.intake.files import OUTSIDE, Source
from phnn.intake.limits import LIMITS
from phnn.recordings.table import Stored
from phnn.results import printable

# Bytes of an HDF5 superblock up to the length of the file, whatever its version; bytes that are looked at together.
_SUPERBLOCK, _BLOCK = 52, 2**20
# Attributes of the CF conventions: of a unit, of numbers that are packed, of values that are missing.
_UNITS, _PACKED, _MISSING = ("units", "unit"), ("scale_factor", "add_offset"), ("_FillValue", "missing_value")
_CLASS, _EMPTY, _OBJECT = "MATLAB_class", "MATLAB_empty", "MATLAB_object_decode"


class _Outside(ValueError):
    """A part of the content lies in another file."""


def is_hdf5(source: Source) -> bool:
    """Return whether a file has the signature of an HDF5 file."""
    import h5py

    return bool(h5py.is_hdf5(source.path))


def datasets(source: Source) -> list[Stored]:
    """Return all datasets of a file that hold numbers, fields of tables as ``dataset.field``."""
    return _read(source, lambda file: [s for found in _walk(file, source) for s in _stored(source, *found)], False)


def matlab_content(source: Source) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """Return the variables of a MATLAB file of version 7.3, and names and classes of its objects.

    Structures are mappings, arrays of structures and cells are lists, texts are texts, numbers are `Stored`.
    """

    def content(file: Any) -> tuple[dict[str, Any], list[tuple[str, str]]]:
        top = dict.fromkeys(name.partition("/")[0] for name, _ in _walk(file, source))
        objects = [(n, _class(file[n])) for n in top if _OBJECT in file[n].attrs]
        named = [n for n in top if n not in dict(objects)]
        return {n: _decoded(source, file, n, file[n], 0) for n in named}, objects

    return _read(source, content, True)


def _read(source: Source, what: Callable[[Any], Any], matlab: bool) -> Any:
    import h5py

    try:
        with h5py.File(source.path, "r") as file:
            _check_length(source, file.userblock_size)
            return what(file)
    except InputRefused:
        raise
    except _Outside as error:
        remedy = f"copy everything into one file, or give the option {OUTSIDE} if you trust who made it"
        raise InputRefused(f"{source.name}: {error}: {remedy}") from error
    except Exception as error:  # on damaged bytes h5py raises errors of many kinds
        cause = "damaged .mat v7.3 file" if matlab else "not a readable HDF5 file"
        remedy = "save it again from MATLAB" if matlab else "export it again"
        raise InputRefused(f"{source.name}: {cause} ({printable(str(error))}): {remedy}") from error


def _walk(file: Any, source: Source) -> Iterator[tuple[str, Any]]:
    """Yield path and dataset of everything in a file, in the order of the names, every link once.

    Without leave, no link and no dataset may lead to another file.
    """
    import h5py

    found: dict[str, Any] = {}

    def visit(name: str, link: Any) -> ValueError | None:
        # What is returned ends the walk; what is raised would be lost within the library.
        if name.count("/") >= LIMITS.depth:
            return ValueError(f"groups more than {LIMITS.depth} levels deep")
        if isinstance(link, h5py.ExternalLink) and not source.outside:
            return _Outside(f"/{name} is a link to the file {printable(str(link.filename))!r}")
        found[name] = link
        return None

    if (stopped := file.visititems_links(visit)) is not None:
        raise stopped
    count = 0
    for name, link in found.items():
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
        raise _Outside(f"{dataset.name} has its numbers in the file {printable(str(dataset.external[0][0]))!r}")
    if dataset.is_virtual:
        parts = ", ".join(printable(str(part.file_name)) for part in dataset.virtual_sources()[:3])
        raise _Outside(f"{dataset.name} is a virtual dataset, made of parts of {parts!r}")


def _stored(source: Source, path: str, item: Any, matlab: bool = False) -> Iterator[Stored]:
    """Yield a dataset, or the fields of a table; MATLAB stores every array transposed."""
    name = path.strip("/").replace("/", ".")
    said = {} if matlab else dict(item.attrs)
    unit = next((printable(_text(said[key])) for key in _UNITS if key in said), "")
    # Numbers that are packed, or were never written, take less room in the file.
    packed = item.id.get_storage_size() < item.nbytes
    for field in item.dtype.names or (None,):
        dtype = item.dtype if field is None else item.dtype[field]
        shape = item.shape[::-1] if matlab else item.shape
        size = math.prod(shape) * dtype.itemsize

        def load(field: str | None = field, size: int = size) -> np.ndarray:
            source.check_memory(size, packed)

            def numbers(file: Any) -> np.ndarray:
                array = np.asarray(file[path][field] if field is not None else file[path][()])
                return array.T if matlab else _unpacked(array, said)

            return np.asarray(_read(source, numbers, matlab))

        yield Stored(name if field is None else f"{name}.{field}", shape, dtype, load, unit)


def _unpacked(array: np.ndarray, said: dict[str, Any]) -> np.ndarray:
    """Return the numbers that an array stands for by its attributes, missing ones as NaN."""
    if array.dtype.kind not in "iuf":
        return array
    missing = [float(v) for key in _MISSING if key in said for v in np.atleast_1d(said[key])]
    scale, offset = (float(np.ravel(said.get(key, usual))[0]) for key, usual in zip(_PACKED, (1.0, 0.0), strict=True))
    hidden = np.isin(array, missing) if missing else np.zeros(0, dtype=bool)
    if scale == 1.0 and offset == 0.0 and not hidden.any():
        return array
    values = array * scale + offset
    return np.where(hidden, np.nan, values) if hidden.any() else values


def _decoded(source: Source, file: Any, path: str, item: Any, depth: int) -> Any:
    """Return a variable of MATLAB as `matlab_content` says; None where it is of no known kind."""
    import h5py

    if depth > LIMITS.depth:
        return None
    if isinstance(item, h5py.Group):
        fields = {n: item[n] for n in item}
        found = {n: _decoded(source, file, f"{path}/{n}", x, depth + 1) for n, x in fields.items()}
        # The fields of an array of structures are references that are no cells.
        arrays = [isinstance(x, h5py.Dataset) and _references(x) and _class(x) != "cell" for x in fields.values()]
        if not found or not all(arrays) or len({len(v) for v in found.values()}) != 1:
            return found
        return [dict(zip(found, values, strict=True)) for values in zip(*found.values(), strict=True)]
    if not isinstance(item, h5py.Dataset) or item.shape is None:
        return None
    _check_dataset(source, item)
    if _EMPTY in item.attrs:
        return np.empty((0, 0))
    if _references(item):
        if item.size > LIMITS.variables:
            raise ValueError(f"{item.name} has more than {LIMITS.variables} cells")
        cells = (file[ref] for ref in item[()].T.ravel())
        return [_decoded(source, file, cell.name, cell, depth + 1) for cell in cells]
    if _class(item) == "char":
        source.check_memory(item.nbytes, True)
        return "".join(map(chr, np.asarray(item[()]).T.ravel()))
    parts = {s.name.rpartition(".")[2]: s for s in _stored(source, path, item, matlab=True)}
    return next(iter(parts.values())) if item.dtype.names is None else parts


def _references(item: Any) -> bool:
    import h5py

    return h5py.check_ref_dtype(item.dtype) is not None


def _class(item: Any) -> str:
    return _text(item.attrs.get(_CLASS, b""))


def _text(said: Any) -> str:
    if isinstance(said, bytes):
        return said.decode("utf-8", "replace")
    return str(np.ravel(said)[0] if np.ndim(said) else said)


def _check_length(source: Source, superblock: int) -> None:
    """Refuse another length than the superblock states; bytes that slipped in have moved what lies behind them.

    Zeros at the end, which fill a block, have not.

    Raises:
        ValueError: it has another length.
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
