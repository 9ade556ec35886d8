"""Reading .tdms files, as LabVIEW writes them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from phnn.errors import InputRefused
from phnn.intake.files import Source
from phnn.intake.limits import LIMITS
from phnn.recordings.table import Table, Where
from phnn.results import printable

# Bytes before the content of a segment, and the flag of its first byte order.
_LEAD_IN, _BIG_ENDIAN, _UNCLOSED = 28, 1 << 6, b"\xff" * 8
_INTERVAL, _UNIT = "wf_increment", "unit_string"


def read_tdms(source: Source) -> Table:
    """The numeric channels as ``group.channel``, with their units; waveforms of one interval bring their time.

    Raises:
        InputRefused: the package npTDMS is missing, the file is damaged or too large, or has no numeric channels.
    """
    try:
        from nptdms import TdmsFile
    except ModuleNotFoundError as error:
        raise InputRefused(f"{source.name}: .tdms files need the package npTDMS: pip install 'phnn[tdms]'") from error
    try:
        closed = _closed(source)
        with source.open() as file, TdmsFile.open(file) as content:
            numeric = _numeric(source, content)
        intervals = {_interval(of) for _, of in numeric.values()}
    except InputRefused:
        raise
    except Exception as error:  # on damaged bytes npTDMS raises errors of many kinds
        raise InputRefused(
            f"{source.name}: not a readable .tdms file ({printable(str(error))}): export it again"
        ) from error
    if not numeric:
        raise InputRefused(f"{source.name}: no numeric channels in it: record it again or remove it")
    notes: tuple[str, ...] = ()
    if not closed:
        # What was not written of a channel is missing in all.
        whole = min(values.size for values, _ in numeric.values())
        numeric = {names: (values[:whole], of) for names, (values, of) in numeric.items()}
        notes = ("the file was not closed, its channels are as long as the shortest",)
    several = len({group for group, _ in numeric}) > 1
    columns = {_name(group, name, of, several): values for (group, name), (values, of) in numeric.items()}
    if len(intervals) == 1 and (interval := intervals.pop()) > 0.0:
        longest = max(values.size for values in columns.values())
        columns.setdefault("time_s", interval * np.arange(longest))
    return Table(Where(source.name), tuple(columns), tuple(columns.values()), by_name=True, notes=notes)


def _numeric(source: Source, content: Any) -> dict[tuple[str, str], tuple[np.ndarray, dict[str, Any]]]:
    """Numbers and properties of the channels that hold some, by group and name."""
    channels = [c for group in content.groups() for c in group.channels()]
    if len(channels) > LIMITS.variables:
        raise ValueError(f"{len(channels)} channels, at most {LIMITS.variables} are accepted")
    channels = [c for c in channels if c.dtype is not None and c.dtype.kind in "iuf" and len(c)]
    # Nothing in such a file is packed: what it states beyond its size is not there.
    stated = sum(len(c) * c.dtype.itemsize for c in channels)
    source.check_memory(stated, unpacked=True)
    found = {(c.group_name, c.name): (np.asarray(c[:]), dict(c.properties)) for c in channels}
    return {names: (values, of) for names, (values, of) in found.items() if values.ndim == 1 and values.size}


def _interval(properties: Mapping[str, Any]) -> float:
    """Seconds between samples of a waveform; 0 where nothing is said.

    Raises:
        ValueError: what is said is no interval.
    """
    said = properties.get(_INTERVAL, 0.0)
    if isinstance(said, bool) or not isinstance(said, int | float | np.number) or not 0.0 <= said < math.inf:
        raise ValueError(f"its property {_INTERVAL} is {said!r:.60}, not seconds")
    return float(said)


def _closed(source: Source) -> bool:
    """Whether the last segment was closed: one that a crash has left says that it reaches to the end of the file.

    Every other one states where the next begins, and the last ends with the file, unless bytes were lost or slipped in.

    Raises:
        ValueError: it does not.
    """
    size, first = source.size, 0
    with source.open() as file:
        while first < size:
            file.seek(first)
            head = file.read(_LEAD_IN)
            if not head.startswith(b"TDSm") or len(head) < _LEAD_IN:
                raise ValueError(f"no segment begins at byte {first}")
            if head[12:20] == _UNCLOSED:
                return False
            first += _LEAD_IN + int.from_bytes(head[12:20], "big" if head[4] & _BIG_ENDIAN else "little")
    if first > size:
        raise ValueError(f"{size} bytes long, its last segment ends at {first}")
    return True


def _name(group: str, channel: str, properties: Mapping[str, Any], several: bool) -> str:
    """A channel's name with its unit, and with its group where there are several of them."""
    unit = str(properties.get(_UNIT, "")).strip()
    name = f"{channel} [{unit}]" if unit and not channel.endswith(("]", ")")) else channel
    return printable(f"{group}.{name}" if several else name)
