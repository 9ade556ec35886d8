"""Recordings given as one object, as a list of them, by names, or as a pair to train and test."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from phnn.errors import InputRefused
from phnn.intake.limits import LIMITS
from phnn.recordings.adapters.benchmark import given_benchmark, is_benchmark
from phnn.recordings.adapters.frames import given_frame, is_frame
from phnn.recordings.adapters.given import Given, where_of
from phnn.recordings.adapters.labelled import given_labelled, is_labelled
from phnn.recordings.array_files import stored_arrays, table_of
from phnn.recordings.manifest import Manifest
from phnn.recordings.recording import is_actuator
from phnn.results import printable

_ACCEPTED = (
    "a folder, a pandas DataFrame, an xarray Dataset or DataArray, an Input_output_data of nonlinear_benchmarks or its "
    "(train, test), a mapping from column names to arrays, or a list of these or a mapping from names to these"
)
# Members of a mapping that a message lists.
_SHOWN = 5
# Names of the two parts of a benchmark, and what they serve as.
_PARTS = (("train", "identification"), ("test", "confirmation"))


def given(data: Any, said: Manifest) -> list[Given]:
    """The recordings of an object, each with a name of its own.

    Args:
        said: names input and output as its setup does.

    Raises:
        InputRefused: the object is none that is known, or holds no recording.
    """
    names = ("voltage", "displacement") if is_actuator(said.setup) else ("input", "output")
    found = []
    for one in _collected(data, "", names):
        found.append(one)
        if len(found) > LIMITS.recordings:
            raise InputRefused(f"{type(data).__name__}: more than {LIMITS.recordings} recordings: give fewer")
    if not found:
        raise InputRefused(f"{type(data).__name__}: it is empty, there is no recording in it: give {_ACCEPTED}")
    return _named_apart(found)


def _collected(data: Any, name: str, names: tuple[str, str]) -> Iterator[Given]:
    if is_frame(data):
        yield given_frame(data, name)
    elif is_labelled(data):
        yield from given_labelled(data, name)
    elif is_benchmark(data):
        yield given_benchmark(data, names, name)
    elif _is_pair(data):
        yield from _pair(data, name, names)
    elif isinstance(data, Mapping) and any(map(_is_recording, data.values())):
        for key, one in data.items():
            yield from _collected(one, _joined(name, key), names)
    elif _is_arrays(data):
        yield _given_arrays(data, name)
    elif isinstance(data, list | tuple) and not name:
        for one in data:
            yield from _collected(one, name, names)
    else:
        label = f"{name}: " if name else ""
        kind = type(data).__name__
        if isinstance(data, Mapping):
            wrong = [f"{printable(str(key))} ({type(v).__name__})" for key, v in data.items() if not _is_numbers(v)]
            kind = f"a {kind} with {', '.join(wrong[:_SHOWN]) or 'nothing in it'}"
        raise InputRefused(f"{label}{kind} is not known as a recording: give {_ACCEPTED}")


def _is_recording(data: Any) -> bool:
    """Whether an object is a recording or several, not one column: what has a name in a mapping."""
    return isinstance(data, Mapping) or is_frame(data) or is_labelled(data) or is_benchmark(data) or _is_pair(data)


def _joined(name: str, key: object) -> str:
    return f"{name}_{printable(str(key))}" if name else printable(str(key))


def _is_pair(data: Any) -> bool:
    """Whether an object is (train, test) of a benchmark, each one recording or several."""
    if not isinstance(data, tuple) or len(data) != 2:
        return False
    return all(is_benchmark(d) or (isinstance(d, list | tuple) and d and all(map(is_benchmark, d))) for d in data)


def _pair(data: Any, name: str, names: tuple[str, str]) -> Iterator[Given]:
    for part, (word, use) in zip(data, _PARTS, strict=True):
        several = [part] if is_benchmark(part) else list(part)
        for i, one in enumerate(several, start=1):
            label = _joined(name, word) + (f"_{i}" if len(several) > 1 else "")
            yield given_benchmark(one, names, label, use)


def _named_apart(found: list[Given]) -> list[Given]:
    """Every recording with a name: its own, else ``recording`` and, among several, its number."""
    digits = len(str(len(found)))
    numbered = (f"recording_{i:0{digits}d}" if len(found) > 1 else "recording" for i in range(1, len(found) + 1))
    return [replace(one, name=one.name or name) for one, name in zip(found, numbered, strict=True)]


def _is_arrays(data: object) -> bool:
    """Whether an object maps names to numbers, arrays or lists."""
    return isinstance(data, Mapping) and bool(data) and all(map(_is_numbers, data.values()))


def _given_arrays(data: Mapping[str, Any], name: str = "") -> Given:
    """The arrays by name, the columns of a matrix as ``name[0]``, ….

    Raises:
        InputRefused: there are no arrays of numbers.
    """
    where = where_of(data, name)
    return Given(name, table_of(where, stored_arrays({str(k): v for k, v in data.items()})))


def _is_numbers(value: Any) -> bool:
    """Whether an object is an array of real numbers, or a list of some."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError):
        # Lists of unequal lengths, tensors on another device or with gradients.
        return False
    return array.dtype.kind in "iufb" and array.ndim > 0
