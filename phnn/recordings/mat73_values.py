"""Values of a MATLAB v7.3 file that are no plain numbers: texts, cell arrays, and objects that only MATLAB can read."""

from __future__ import annotations

from typing import Any

import numpy as np

from phnn.intake.files import Source
from phnn.intake.limits import LIMITS
from phnn.recordings.hdf5_files import check_dataset, refused_file

_CLASS, _EMPTY, _OBJECT = "MATLAB_class", "MATLAB_empty", "MATLAB_object_decode"


def matlab_value(source: Source, name: str) -> Any:
    """A number array, a text, or a list of the cells of a cell array; None for a structure in a cell.

    Args:
        name: of the dataset, groups before it, as ``group.dataset``.

    Raises:
        InputRefused: damaged, too large, or leading to other files.
    """
    import h5py

    try:
        with h5py.File(source.path, "r") as file:
            return _decoded(source, file, file[name.replace(".", "/")], 0)
    except Exception as error:  # on damaged bytes h5py raises errors of many kinds
        raise refused_file(source, "damaged .mat v7.3 file", error, "save it again from MATLAB") from error


def objects_of(source: Source, kind: str) -> list[str]:
    """Names of the variables that are objects of a class."""
    import h5py

    with h5py.File(source.path, "r") as file:
        plain = [n for n in file if isinstance(file.get(n, getlink=True), h5py.HardLink)]
        return [n for n in plain if _OBJECT in file[n].attrs and _class(file[n]) == kind]


def _decoded(source: Source, file: Any, item: Any, depth: int) -> Any:
    import h5py

    if not isinstance(item, h5py.Dataset) or item.shape is None or depth > LIMITS.groups:
        return None
    if not source.outside:
        check_dataset(item, item.name)
    if _EMPTY in item.attrs:
        return np.empty((0, 0))
    source.check_memory(item.nbytes, item.id.get_storage_size() < item.nbytes)
    if h5py.check_ref_dtype(item.dtype) is not None:
        if item.size > LIMITS.variables:
            raise ValueError(f"{item.name} has more than {LIMITS.variables} cells")
        return [_decoded(source, file, file[ref], depth + 1) for ref in item[()].T.ravel()]
    values = np.asarray(item[()]).T
    return "".join(map(chr, values.ravel())) if _class(item) == "char" else values


def _class(item: Any) -> str:
    said = item.attrs.get(_CLASS, b"")
    return said.decode("ascii", "replace") if isinstance(said, bytes) else str(said)
