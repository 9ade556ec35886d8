"""xarray: the variables of a Dataset along one dimension, their units in ``attrs["units"]`` as CF writes them."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

import numpy as np

from phnn.errors import InputRefused
from phnn.recordings.adapters.given import Given, given_of, seconds, where_of
from phnn.recordings.table import Table
from phnn.recordings.units import parse_name
from phnn.results import printable

_TIMES = ("time", "t")


def is_labelled(data: object) -> bool:
    """Whether an object is a Dataset or a DataArray."""
    xarray = sys.modules.get("xarray")
    return xarray is not None and isinstance(data, xarray.Dataset | xarray.DataArray)


def given_labelled(data: Any, name: str = "") -> Iterator[Given]:
    """The recordings of a Dataset, one for each index of a second dimension; a DataArray has its channels along one.

    Raises:
        InputRefused: the dimensions are not those of recordings, or attributes say what is not understood.
    """
    where = where_of(data, name)
    data = _dataset(data)
    time, further = _dimensions(data, where)
    if further is None:
        yield _given(data, time, name, where)
        return
    labels = data.coords[further].values if further in data.coords else np.arange(data.sizes[further])
    for i, label in enumerate(labels):
        yield _given(data.isel({further: i}), time, f"{name or data.attrs.get('name', further)}_{label}", where)


def _dataset(data: Any) -> Any:
    """A Dataset; a DataArray with a coordinate of names becomes one, with the attributes of its own."""
    if hasattr(data, "data_vars"):
        return data
    channels = [d for d in data.dims if d in data.coords and data.coords[d].dtype.kind in "UOT"]
    if len(channels) != 1:
        raise InputRefused(
            f"{where_of(data, '')}: dimensions {', '.join(map(str, data.dims))}, of which one must name its channels, "
            f"such as voltage_V and displacement_um: give it such a coordinate, or give a Dataset"
        )
    found = data.to_dataset(dim=channels[0])
    units = data.attrs.get("units")
    for variable in found.data_vars:
        found[variable].attrs.pop("units", None)
        if isinstance(units, dict) and variable in units:
            found[variable].attrs["units"] = units[variable]
    return found.assign_attrs({k: v for k, v in data.attrs.items() if k != "units"})


def _dimensions(data: Any, where: object) -> tuple[str, str | None]:
    """The dimension of time, and a second one where there is one.

    Raises:
        InputRefused: there are more, or nothing tells which is the time.
    """
    dims = [str(d) for d in data.dims]
    times = [d for d in dims if d.lower() in _TIMES or (parse_name(d) or ("",))[0] == "time"]
    if len(dims) == 1:
        return dims[0], None
    if len(times) == 1 and len(dims) == 2:
        return times[0], next(d for d in dims if d != times[0])
    raise InputRefused(
        f"{where}: dimensions {', '.join(dims) or 'none'}: a recording has one, `time`, and at most one more along "
        f"which recordings are counted: select the rest"
    )


def _given(data: Any, time: str, name: str, where: Any) -> Given:
    """One recording along its time."""
    columns = {printable(str(n)): v.values for n, v in data.data_vars.items() if v.dims == (time,)}
    units = {printable(str(n)): str(v.attrs["units"]) for n, v in data.variables.items() if "units" in v.attrs}
    if time in data.coords:
        values = data.coords[time].values
        elapsed = seconds(values)
        if elapsed is not None:
            units.pop(time, None)
        label = "time_s" if elapsed is not None else "time" if parse_name(time) is None else time
        if label != time and time in units:
            units[label] = units.pop(time)
        columns.setdefault(label, values if elapsed is None else elapsed)
    return given_of(
        data.attrs, Table(where, tuple(columns), tuple(columns.values()), by_name=True), units, printable(name)
    )
