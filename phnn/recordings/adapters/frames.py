"""pandas: a frame is a recording, its columns have their units in their names or in ``attrs["units"]``."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from phnn.errors import InputRefused
from phnn.intake.limits import LIMITS
from phnn.recordings.adapters.given import Given, given_of, seconds, where_of
from phnn.recordings.table import Table
from phnn.recordings.units import parse_name
from phnn.recordings.values import mapping
from phnn.results import printable


def is_frame(data: object) -> bool:
    """Whether an object is a DataFrame."""
    pandas = sys.modules.get("pandas")
    return pandas is not None and isinstance(data, pandas.DataFrame)


def given_frame(frame: Any, name: str = "") -> Given:
    """The columns of a frame; an index of times, or one that is named as a time is, stands behind them.

    Raises:
        InputRefused: it has several levels of columns or too many, or its attributes say what is not understood.
    """
    where = where_of(frame, name)
    if frame.columns.nlevels > 1 or frame.shape[1] > LIMITS.text_columns:
        raise InputRefused(
            f"{where}: {frame.shape[1]} columns on {frame.columns.nlevels} levels: give one recording with plain "
            f"names, at most {LIMITS.text_columns}"
        )
    names = [printable(str(column)) for column in frame.columns]
    columns = [frame.iloc[:, i].to_numpy() for i in range(frame.shape[1])]
    time = _time(frame.index)
    if time is not None and not any((parse_name(n) or ("",))[0] == "time" for n in names):
        names.append(time[0])
        columns.append(time[1])
    units = mapping(frame.attrs.get("units", {}), f"{where}: attrs['units']")
    table = Table(where, tuple(names), tuple(columns))
    return given_of(frame.attrs, table, {printable(str(n)): str(u) for n, u in units.items()}, name)


def _time(index: Any) -> tuple[str, np.ndarray] | None:
    """Name and numbers of an index of times; None where it only counts rows."""
    values = np.asarray(index)
    elapsed = seconds(values)
    if elapsed is not None:
        return "time_s", elapsed
    named = parse_name(str(index.name)) if index.name is not None else None
    return (str(index.name), values) if named is not None and named[0] == "time" else None
