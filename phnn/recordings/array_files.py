"""Reading arrays: .mat (v5 and v7.3), .h5, .npy and .npz files."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from phnn.errors import InputRefused
from phnn.recordings.mat_layout import check_layout, is_v5
from phnn.recordings.table import Table, Where

_MOST_COLUMNS = 64
# Bytes of an HDF5 superblock up to the length of the file, whatever its version.
_SUPERBLOCK = 52


def read_mat(path: Path) -> Table:
    """The numeric variables of a .mat file.

    Vectors are found by name, structure fields as ``name.field``, the columns of a matrix as ``name[0]``, ….

    Raises:
        InputRefused: not a .mat file, damaged, or without numbers.
    """
    if not _is_hdf5(path):
        return _named(path, _load_v5(path))
    return _named(path, _load_hdf5(path, "damaged .mat v7.3 file", "save it again from MATLAB", transposed=True))


def read_hdf5(path: Path) -> Table:
    """The numeric datasets of an HDF5 file, those of a group as ``group.dataset``, columns as in `read_mat`.

    Raises:
        InputRefused: not an HDF5 file, damaged, or without numbers.
    """
    return _named(path, _load_hdf5(path, "not a readable HDF5 file", "export it again"))


def read_npz(path: Path) -> Table:
    """The arrays of an archive by name, columns as in `read_mat`.

    Raises:
        InputRefused: not an archive of arrays, damaged, or without numbers.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            content = dict(archive)
    except Exception as error:  # a damaged archive raises whatever zipfile and numpy stumble over
        raise InputRefused(
            f"{path.name}: not a readable .npz file ({error}): save it again with numpy.savez"
        ) from error
    return _named(path, content)


def _named(path: Path, content: Mapping[str, Any]) -> Table:
    variables = dict(_vectors(content))
    if not variables:
        raise InputRefused(f"{path.name}: no numeric variables in it: save the samples as vectors")
    return Table(Where(path.name), tuple(variables), tuple(variables.values()), by_name=True)


def read_npy(path: Path) -> Table:
    """A two-dimensional array (samples, columns), or a structured one with named fields.

    Raises:
        InputRefused: not a .npy file, damaged, or of another shape.
    """
    array = _load_npy(path)
    if array.dtype.names:
        fields = array.reshape(-1)
        return Table(Where(path.name), array.dtype.names, tuple(fields[name] for name in array.dtype.names))
    if array.ndim != 2:
        raise InputRefused(
            f"{path.name}: an array of shape {array.shape}: save it as (samples, columns) with voltage and "
            f"displacement among the columns, or say in recordings.yaml what its axes are, such as "
            f"axes: [time, channel, realisation, period]"
        )
    if array.shape[0] < array.shape[1] and array.shape[0] <= _MOST_COLUMNS:
        array = array.T  # channels along the first axis: never more channels than samples
    if array.shape[1] > _MOST_COLUMNS:
        raise InputRefused(f"{path.name}: shape {array.shape} is no table of samples: save it as (samples, columns)")
    return Table(Where(path.name), ("",) * array.shape[1], tuple(array.T))


def read_axes(path: Path, axes: Sequence[str]) -> Table:
    """An array whose axes are time and any of channel, realisation and period, as of a periodic experiment.

    The periods of a realisation follow one another, and so do the realisations, each a segment.

    Raises:
        InputRefused: not a .npy file, damaged, or with another number of axes.
    """
    if path.suffix.lower() != ".npy":
        raise InputRefused(f"{path.name}: `axes` describe a .npy array: leave them out, or save it with numpy.save")
    array = _load_npy(path)
    if array.ndim != len(axes) or array.dtype.kind not in "iuf":
        raise InputRefused(
            f"{path.name}: an array of shape {array.shape} and type {array.dtype}, said to have the axes "
            f"{', '.join(axes)}: name as many, of real numbers"
        )
    whole = np.expand_dims(array, tuple(range(array.ndim, 4)))
    absent = [name for name in ("realisation", "period", "time", "channel") if name not in axes]
    order = [[*axes, *absent].index(name) for name in ("realisation", "period", "time", "channel")]
    ordered = whole.transpose(order)
    realisations, periods, samples, channels = ordered.shape
    if channels > _MOST_COLUMNS:
        raise InputRefused(f"{path.name}: {channels} channels: correct the order of `axes`")
    columns = ordered.reshape(-1, channels)
    return Table(Where(path.name), ("",) * channels, tuple(columns.T), shape=(realisations, periods, samples))


def _load_npy(path: Path) -> np.ndarray:
    try:
        array = np.load(path, allow_pickle=False)
    except Exception as error:  # a damaged header raises whatever numpy's parser stumbles over
        raise InputRefused(f"{path.name}: not a readable .npy file ({error}): save it again with numpy.save") from error
    if not isinstance(array, np.ndarray):
        raise InputRefused(f"{path.name}: an archive of arrays, not one array: save one array with numpy.save")
    return array


def _is_hdf5(path: Path) -> bool:
    import h5py

    return bool(h5py.is_hdf5(path))


def _load_v5(path: Path) -> Mapping[str, Any]:
    import scipy.io

    if path.stat().st_size == 0:
        raise InputRefused(f"{path.name}: the file is empty: record it again or remove it")
    try:
        raw = path.read_bytes()
        if is_v5(raw):
            check_layout(raw)
        with warnings.catch_warnings():
            warnings.filterwarnings("error", message="We do not support byte ordering")
            content = scipy.io.loadmat(path, simplify_cells=True)
    except Exception as error:  # on damaged bytes scipy raises whatever its reader stumbles over
        raise InputRefused(
            f"{path.name}: not a readable .mat file ({type(error).__name__}: {error}): save it again from MATLAB"
        ) from error
    return {name: value for name, value in content.items() if not name.startswith("__")}


def _load_hdf5(path: Path, cause: str, remedy: str, transposed: bool = False) -> Mapping[str, Any]:
    """Datasets by name, groups as mappings; MATLAB stores every array transposed."""
    import h5py

    def content(group: Any) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for name, item in group.items():
            if isinstance(item, h5py.Group):
                found[name] = {} if name.startswith("#") else content(item)
            else:
                found[name] = np.asarray(item).T if transposed else np.asarray(item)
        return found

    try:
        with h5py.File(path, "r") as file:
            _check_length(path, file.userblock_size)
            return content(file)
    except Exception as error:  # on damaged bytes h5py raises errors of many kinds
        raise InputRefused(f"{path.name}: {cause} ({error}): {remedy}") from error


def _check_length(path: Path, superblock: int) -> None:
    """An HDF5 file states its length in its superblock; bytes that slipped in have moved what lies behind them.

    Zeros at the end, which fill a block, have not.

    Raises:
        ValueError: it has another length.
    """
    with path.open("rb") as file:
        file.seek(superblock)
        head = file.read(_SUPERBLOCK)
        end = 28 if head[8] > 1 else 40 + 4 * head[8]
        stated, size = int.from_bytes(head[end : end + 8], "little"), path.stat().st_size
        file.seek(min(stated, size))
        if stated > size or any(file.read()):
            raise ValueError(f"{size} bytes long, and says that it has {stated}")


def _vectors(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, np.ndarray]]:
    for name, value in content.items():
        full = prefix + name
        if isinstance(value, Mapping):
            yield from _vectors(value, full + ".")
            continue
        array = np.asarray(value)
        if array.dtype.kind not in "iufbc":
            continue
        array = np.squeeze(array)
        if array.ndim <= 1:
            yield full, np.atleast_1d(array)
        elif array.ndim == 2 and array.shape[1] <= _MOST_COLUMNS:
            for i in range(array.shape[1]):
                yield f"{full}[{i}]", array[:, i]
