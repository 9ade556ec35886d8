"""The datasets of an HDF5 file: those that lie in the file itself.

External storage, external links, soft links through them and virtual datasets of other files are refused, unless the
user allows them: a file must not make the program read another one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from phnn.errors import InputRefused
from phnn.intake.files import OUTSIDE, Source
from phnn.intake.limits import LIMITS
from phnn.recordings.stored import Stored
from phnn.results import printable

# Bytes of an HDF5 superblock up to the length of the file, whatever its version.
_SUPERBLOCK = 52
# Bytes that are looked at together.
_BLOCK = 2**20
# Soft links that lead to soft links; HDF5 follows 16 of them.
_LINKS = 32


class _Outside(ValueError):
    """A part of the content lies in another file."""


def is_hdf5(source: Source) -> bool:
    """Whether a file has the signature of an HDF5 file."""
    import h5py

    return bool(h5py.is_hdf5(source.path))


def datasets(source: Source, cause: str, remedy: str, transposed: bool = False) -> list[Stored]:
    """All datasets of a file that hold numbers, fields of tables as ``dataset.field``.

    Args:
        cause, remedy: of a refusal.
        transposed: MATLAB stores every array transposed.

    Raises:
        InputRefused: damaged, or with parts in other files.
    """
    import h5py

    def read(path: str, field: str | None, size: int, packed: bool) -> Callable[[], np.ndarray]:
        def load() -> np.ndarray:
            source.check_memory(size, packed)
            try:
                with h5py.File(source.path, "r") as file:
                    array = np.asarray(file[path][field] if field is not None else file[path][()])
                    return array.T if transposed else array
            except Exception as error:  # on damaged bytes h5py raises errors of many kinds
                raise refused_file(source, cause, error, remedy) from error

        return load

    try:
        with h5py.File(source.path, "r") as file:
            _check_length(source, file.userblock_size)
            found = []
            for path, dataset in _walk(file, source.outside):
                name = path.strip("/").replace("/", ".")
                # Numbers that are packed, or were never written, take less room in the file.
                packed = dataset.id.get_storage_size() < dataset.nbytes
                for part, field, dtype in _parts(dataset.dtype):
                    shape = dataset.shape[::-1] if transposed else dataset.shape
                    size = math.prod(shape) * dtype.itemsize
                    found.append(Stored(name + part, shape, dtype, read(path, field, size, packed)))
                if len(found) > LIMITS.variables:
                    raise ValueError(f"more than {LIMITS.variables} datasets")
            return found
    except _Outside as error:
        raise InputRefused(
            f"{source.name}: {error}: copy everything into one file, or give the option {OUTSIDE} if you trust who "
            f"made it"
        ) from error
    except Exception as error:  # on damaged bytes h5py raises errors of many kinds
        raise refused_file(source, cause, error, remedy) from error


def refused_file(source: Source, cause: str, error: Exception, remedy: str) -> InputRefused:
    """The refusal of a file on which the library stumbled; a refusal stays as it is."""
    if isinstance(error, InputRefused):
        return error
    return InputRefused(f"{source.name}: {cause} ({printable(str(error))}): {remedy}")


def _parts(dtype: np.dtype) -> Iterator[tuple[str, str | None, np.dtype]]:
    """Fields of a table, with the names that they add; the whole of an array."""
    if dtype.names is None:
        yield "", None, dtype
        return
    for name in dtype.names:
        yield f".{name}", name, dtype[name]


def _walk(file: Any, outside: bool) -> Iterator[tuple[str, Any]]:
    """Path and dataset of everything in a file, in the order of the names, no group twice on one path."""
    import h5py

    seen = {_address(file)}

    def inside(group: Any, prefix: str, depth: int) -> Iterator[tuple[str, Any]]:
        if depth > LIMITS.groups:
            raise ValueError(f"groups more than {LIMITS.groups} levels deep")
        for name in group:
            path = f"{prefix}/{name}"
            if not outside:
                _check_link(file, path, 0)
            item = group.get(name)
            if isinstance(item, h5py.Dataset) and item.shape is not None:
                if not outside:
                    check_dataset(item, path)
                yield path, item
            elif isinstance(item, h5py.Group) and not name.startswith("#") and _address(item) not in seen:
                seen.add(_address(item))
                yield from inside(item, path, depth + 1)

    yield from inside(file, "", 0)


def _address(item: Any) -> tuple[int, Any]:
    import h5py

    found = h5py.h5o.get_info(item.id)
    return found.fileno, found.addr


def _check_link(file: Any, path: str, depth: int) -> None:
    """Refuse a path on which an external link stands; soft links are followed by their texts.

    Raises:
        _Outside: names the path and the file that it leads to.
    """
    import h5py

    if depth > _LINKS:
        # The library itself follows fewer: the target does not exist.
        return
    done = ""
    parts = [part for part in path.split("/") if part not in ("", ".")]
    for i, part in enumerate(parts):
        here = f"{done}/{part}"
        link = file.get(here, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            raise _Outside(f"{here} is a link to the file {printable(str(link.filename))!r}")
        if isinstance(link, h5py.SoftLink):
            target = link.path if link.path.startswith("/") else f"{done}/{link.path}"
            rest = "/".join([target, *parts[i + 1 :]])
            try:
                _check_link(file, rest, depth + 1)
            except KeyError:
                # Its target does not exist.
                return
            return
        done = here


def check_dataset(dataset: Any, path: str) -> None:
    """Refuse numbers that lie in other files. Raises ValueError."""
    if dataset.external:
        raise _Outside(f"{path} has its numbers in the file {printable(str(dataset.external[0][0]))!r}")
    if dataset.is_virtual:
        for part in dataset.virtual_sources():
            if part.file_name != ".":
                raise _Outside(f"{path} is made of parts of the file {printable(str(part.file_name))!r}")


def _check_length(source: Source, superblock: int) -> None:
    """An HDF5 file states its length in its superblock; bytes that slipped in have moved what lies behind them.

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
