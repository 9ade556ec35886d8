"""Recordings that are objects in memory: one object, a list of them, or some by names.

No library is loaded: an object can only be given where its library is loaded already.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from phnn.errors import InputRefused
from phnn.intake import LIMITS
from phnn.recordings.manifest import USES, Entry, Manifest, choice, mapping, number, shown
from phnn.recordings.recording import is_actuator
from phnn.recordings.table import Table, Where, beside, stored_arrays, table_of, with_stamps
from phnn.recordings.units import parse_name
from phnn.results import listed, printable

# A recording: what its object says about it (its name, which may be empty, use and rate), and its columns.
Given = tuple[Entry, Table]


def where_of(data: object, name: str) -> Where:
    """Return the place of a recording, for messages: its name where it has one, and what it is."""
    kind = type(data).__name__
    return Where(f"{printable(name)} ({kind})" if name else kind)


def plain(value: Any) -> Any:
    """Return a number of numpy as one of Python."""
    return value.item() if isinstance(value, np.generic | np.ndarray) and value.size == 1 else value


# Libraries that may be loaded, and the class of each whose objects are recordings.
_CLASSES = {"pandas": "DataFrame", "xarray": "Dataset", "nonlinear_benchmarks.utilities": "Input_output_data"}


def _library(data: object) -> str:
    """Return the first word of the library whose recording an object is; empty for any other object."""
    for name, of_recordings in _CLASSES.items():
        if name in sys.modules and isinstance(data, getattr(sys.modules[name], of_recordings)):
            return name.partition(".")[0]
    return ""


def given_labelled(data: Any, name: str) -> Iterator[Given]:
    """Return the recordings of a Dataset, one for each index of a second dimension."""
    where, dims = where_of(data, name), [str(d) for d in data.dims]
    times = [d for d in dims if len(dims) == 1 or d.lower() in ("time", "t") or parse_name(d)[0] == "time"]
    if len(times) != 1 or len(dims) > 2:
        cause = "a recording has one, `time`, and at most one more along which recordings are counted"
        raise InputRefused(f"{where}: dimensions {', '.join(dims) or 'none'}: {cause}: select the rest")
    runs = [(name, data)]
    for further in (d for d in dims if d not in times):
        labels = data.coords[further].values if further in data.coords else np.arange(data.sizes[further])
        stem = name or data.attrs.get("name", further)
        runs = [(f"{stem}_{label}", data.isel({further: i})) for i, label in enumerate(labels)]
    for called, run in runs:
        entry, table = given_frame(_along(run, times[0]), printable(called), where)
        yield entry, replace(table, by_name=True)


def _along(data: Any, time: str) -> Any:
    """Return the variables along time as a frame, whose index is the time where the data has one."""
    shown = data.reset_coords(drop=True)[[n for n, v in data.data_vars.items() if v.dims == (time,)]]
    frame = shown.to_dataframe()
    units = {str(n): str(v.attrs["units"]) for n, v in data.variables.items() if "units" in v.attrs}
    frame.index.name = None if time not in data.coords else time if parse_name(time)[0] else "time"
    if frame.index.name is not None and time in units:
        units[frame.index.name] = units.pop(time)
    if frame.index.dtype.kind in "mM":
        units.pop(frame.index.name, None)
    frame.attrs = {**data.attrs, "units": units}
    return frame


def given_frame(frame: Any, name: str = "", where: Where | None = None) -> Given:
    """Return the columns of a frame; an index of times, or one that is named as a time is, stands behind them.

    Its attributes may say ``name``, ``use``, ``sample_rate_hz`` and ``units``; ``where`` it comes from, for messages.
    """
    where = where or where_of(frame, name)
    if frame.columns.nlevels > 1 or frame.shape[1] > LIMITS.text_columns:
        cause = f"{frame.shape[1]} columns on {frame.columns.nlevels} levels"
        raise InputRefused(f"{where}: {cause}: give one recording with plain names, at most {LIMITS.text_columns}")
    names = [printable(str(column)) for column in frame.columns]
    columns = [frame.iloc[:, i].to_numpy() for i in range(frame.shape[1])]
    time = _time(frame.index)
    if time is not None and not any(parse_name(n)[0] == "time" for n in names):
        names.append(time[0])
        columns.append(time[1])
    attributes, place = frame.attrs, f"{where}: attrs"
    units = {printable(str(n)): str(u) for n, u in mapping(attributes.get("units", {}), f"{place}['units']").items()}
    use, rate = attributes.get("use"), attributes.get("sample_rate_hz")
    entry = Entry(
        name=name or printable(str(attributes.get("name", ""))),
        use=None if use is None else choice(use, USES, f"{place}['use']"),
        sample_rate_hz=None if rate is None else number(plain(rate), f"{place}['sample_rate_hz']", above=0.0),
    )
    return entry, with_stamps(Table(where, tuple(names), tuple(columns), units=units))


def _time(index: Any) -> tuple[str, np.ndarray] | None:
    """Return the name and numbers of an index of times; None where it only counts rows."""
    index = index.to_timestamp() if hasattr(index, "to_timestamp") else index
    zoned = getattr(index, "tz", None) is not None
    values = np.asarray(index.tz_convert(None) if zoned else index)
    if values.dtype.kind in "mM":
        return "time_s", np.asarray((values - values[:1]) / np.timedelta64(1, "ns"), dtype=float) * 1e-9
    name = str(index.name)
    return (name, values) if parse_name(name)[0] == "time" else None


def given_benchmark(data: Any, names: tuple[str, str], name: str) -> Given:
    """Return input and output of a benchmark, a single one by its name of two ``names``, several as ``u[0]``, …"""
    where = where_of(data, name)
    interval = plain(data.sampling_time)
    if not isinstance(interval, int | float) or not interval > 0.0:
        cause = f"sampling_time is {interval!r:.40}"
        raise InputRefused(f"{where}: {cause}: set it to the interval between samples in seconds")
    pairs = zip(names, ("u", "y"), (data.u, data.y), strict=True)
    columns = {one if np.squeeze(values).ndim < 2 else several: values for one, several, values in pairs}
    return Entry(name=name, sample_rate_hz=1.0 / interval), table_of(where, stored_arrays(columns))


_ACCEPTED = (
    "a folder, a pandas DataFrame, an xarray Dataset (of a DataArray: "
    "array.to_dataset(dim='channel')), an Input_output_data of nonlinear_benchmarks, a "
    "mapping from column names to arrays, or a list of these or a mapping from names to these"
)


def given(data: Any, manifest: Manifest) -> tuple[list[Given], list[str]]:
    """Return every recording of an object that the manifest asks for, and the names of the others.

    ``file`` in the manifest is the name of a recording; a manifest that lists none asks for all. What the manifest says
    wins over what an object says.
    """
    names = ("voltage", "displacement") if is_actuator(manifest.setup) else ("input", "output")
    recordings = list(itertools.islice(_collected(data, "", names), LIMITS.recordings + 1))
    if len(recordings) > LIMITS.recordings:
        raise InputRefused(f"{type(data).__name__}: more than {LIMITS.recordings} recordings: give fewer")
    if not recordings:
        raise InputRefused(f"{type(data).__name__}: it is empty, there is no recording in it: give {_ACCEPTED}")
    by_name: dict[str, Given] = {}
    for i, (one, table) in enumerate(recordings, start=1):
        # Those without a name are called "recording", several by their number.
        name = one.name or (f"recording_{i:0{len(str(len(recordings)))}d}" if len(recordings) > 1 else "recording")
        if name in by_name:
            raise InputRefused(f"two recordings are called {name!r}: give a mapping from names to recordings")
        by_name[name] = replace(one, name=name), table
    if manifest.entries is None:
        return [_described(replace(manifest.common, files=(name,)), by_name) for name in by_name], []
    for i, entry in enumerate(manifest.entries):
        if unknown := [file for file in entry.files if file not in by_name]:
            cause = f"no recording is called {shown(unknown[0])}, there are {', '.join(by_name)}"
            raise InputRefused(f"recordings[{i}]: {cause}: correct `file`")
    asked = {file for entry in manifest.entries for file in entry.files}
    return [_described(e, by_name) for e in manifest.entries], [name for name in by_name if name not in asked]


def _collected(data: Any, name: str, names: tuple[str, str]) -> Iterator[Given]:
    library = _library(data)
    if library == "pandas":
        yield given_frame(data, name)
    elif library == "xarray":
        yield from given_labelled(data, name)
    elif library:
        yield given_benchmark(data, names, name or printable(str(data.name)))
    elif isinstance(data, Mapping) and any(isinstance(v, Mapping) or _library(v) for v in data.values()):
        for key, one in data.items():
            yield from _collected(one, (f"{name}_" if name else "") + printable(str(key)), names)
    elif isinstance(data, Mapping) and data and all(map(_is_numbers, data.values())):
        columns = stored_arrays({str(k): v for k, v in data.items()})
        yield Entry(name=name), table_of(where_of(data, name), columns)
    elif isinstance(data, list | tuple) and not name:
        for one in data:
            yield from _collected(one, name, names)
    else:
        label = f"{name}: " if name else ""
        kind = type(data).__name__
        if isinstance(data, Mapping):
            wrong = [f"{printable(str(key))} ({type(v).__name__})" for key, v in data.items() if not _is_numbers(v)]
            kind = f"a {kind} with {listed(wrong) or 'nothing in it'}"
        raise InputRefused(f"{label}{kind} is not known as a recording: give {_ACCEPTED}")


def _is_numbers(value: Any) -> bool:
    """Return whether an object is an array of real numbers, or a list of some."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError):
        # Lists of unequal lengths, tensors on another device or with gradients.
        return False
    return array.dtype.kind in "iufb" and array.ndim > 0


def _described(entry: Entry, by_name: Mapping[str, Given]) -> Given:
    first, _ = by_name[entry.files[0]]
    table = beside([by_name[file][1] for file in entry.files])
    if entry.axes:
        raise InputRefused(f"{table.where}: `axes` describe a .npy array: leave them out, and give columns")
    stated: dict[str, Any] = {n: getattr(entry, n) or getattr(first, n) for n in ("name", "use", "sample_rate_hz")}
    return replace(entry, **stated), table
