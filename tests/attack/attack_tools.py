"""Names and settings that the attacks share."""

from __future__ import annotations

import io
import shutil
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

# Runs a command and checks what must hold afterwards; see `attack` in conftest.py.
Attack = Callable[..., Any]


def often(count: int) -> settings:
    """So many examples, each with fixtures that a test clears itself."""
    return settings(
        max_examples=count, deadline=None, derandomize=True,
        suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.data_too_large],
    )  # fmt: skip


def quick(first: Sequence[str], *others: str) -> list[Any]:
    """Parameters of a test of which only the first run in the fast suite."""
    return [*first, *(pytest.param(other, marks=pytest.mark.slow) for other in others)]


def each(cases: Iterable[str], one: Callable[[str], object]) -> None:
    """One attack after the other in the same folder, which is quicker than a test for each; all that fail are told."""
    failed = []
    for case in cases:
        try:
            one(case)
        except AssertionError as error:
            failed.append(f"{case}: {error}")
    assert not failed, "\n".join(failed)


def put(path: Path, content: str | bytes) -> Path:
    """A file with this content, whatever was there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass"))
    return path


def zipped(members: Mapping[str, bytes] | Sequence[tuple[str, bytes]]) -> bytes:
    """An archive of these members; a sequence may hold a name twice."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, content in members.items() if isinstance(members, Mapping) else members:
            archive.writestr(name, content)
    return file.getvalue()


def encrypted(members: Mapping[str, bytes]) -> bytes:
    """An archive whose members say that they are encrypted."""
    raw = bytearray(zipped(members))
    for mark, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        at = raw.find(mark)
        while at >= 0:
            raw[at + flags] |= 1
            at = raw.find(mark, at + 1)
    return bytes(raw)


def packed_zeros(size: int) -> bytes:
    """So many zeros, compressed by zlib."""
    # The quickest level: two hundred times smaller do as well as a thousand times.
    packer, block = zlib.compressobj(1), bytes(10**6)
    return b"".join([*(packer.compress(block) for _ in range(size // len(block))), packer.flush()])


def table(samples: int = 120) -> np.ndarray:
    """(N, 3) time [s], voltage [V] and displacement [m] of a recording in which nothing is wrong."""
    t = 1e-3 * np.arange(samples)
    u = 50.0 * np.sin(2.0 * np.pi * 40.0 * t)
    y = 1e-6 * (0.9 * u + 2e-3 * u**2) + 20e-9 * np.random.default_rng(0).standard_normal(samples)
    return np.column_stack([t, u, y])


HEADER = "time_s,voltage_V,displacement_m"


def csv(rows: np.ndarray | None = None, header: str = HEADER) -> str:
    """The recording as text."""
    rows = table() if rows is None else rows
    return "\n".join([header, *(",".join(repr(float(v)) for v in row) for row in rows)]) + "\n"
