"""Binary recordings as bytes."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable

import h5py
import numpy as np
import scipy.io
from attack_tools import table

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


def hdf5(fill: Callable[[h5py.File], object]) -> bytes:
    file = io.BytesIO()
    with h5py.File(file, "w") as f:
        fill(f)
    return file.getvalue()


def columns(f: h5py.File) -> None:
    for name, values in COLUMNS.items():
        f[name] = values
