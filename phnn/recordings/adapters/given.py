"""One recording in memory, as every adapter hands it on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from phnn.recordings.manifest import USES
from phnn.recordings.table import Table, Where, with_stamps
from phnn.recordings.values import choice, number
from phnn.results import printable


@dataclass(frozen=True, eq=False)
class Given:
    """The columns of one recording, and what its object says about them.

    Attributes:
        name: of the recording; empty where the object has none.
        table: its columns.
        use: ``"identification"``, ``"confirmation"`` or None.
        sample_rate_hz: where no column is a time.
    """

    name: str
    table: Table
    use: str | None = None
    sample_rate_hz: float | None = None


def given_of(attributes: Mapping[Any, Any], table: Table, units: Mapping[str, str], name: str = "") -> Given:
    """A recording with what the attributes of its object say: ``name``, ``use``, ``sample_rate_hz``.

    Raises:
        InputRefused: a use or a rate that is not one.
    """
    where = f"{table.where}: attrs"
    use, rate = attributes.get("use"), attributes.get("sample_rate_hz")
    return Given(
        name or printable(str(attributes.get("name", ""))),
        with_stamps(replace(table, units=units)),
        None if use is None else choice(use, USES, f"{where}['use']"),
        None if rate is None else number(plain(rate), f"{where}['sample_rate_hz']", above=0.0),
    )


def where_of(data: object, name: str) -> Where:
    """The place of a recording, for messages: its name where it has one, and what it is."""
    kind = type(data).__name__
    return Where(f"{printable(name)} ({kind})" if name else kind)


def plain(value: Any) -> Any:
    """A number of numpy as one of Python."""
    return value.item() if isinstance(value, np.generic | np.ndarray) and value.size == 1 else value


def seconds(times: np.ndarray) -> np.ndarray | None:
    """(N,) dates or differences of time as seconds since the first; None where they are neither."""
    if times.dtype.kind not in "mM":
        return None
    return np.asarray((times - times[:1]) / np.timedelta64(1, "ns"), dtype=float) * 1e-9
