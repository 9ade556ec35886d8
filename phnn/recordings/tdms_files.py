"""Reading .tdms files, as LabVIEW writes them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from phnn.errors import InputRefused
from phnn.recordings.table import Table, Where

# Bytes before the content of a segment, and the flag of its first byte order.
_LEAD_IN, _BIG_ENDIAN, _UNCLOSED = 28, 1 << 6, b"\xff" * 8
_INTERVAL, _UNIT = "wf_increment", "unit_string"


def read_tdms(path: Path) -> Table:
    """The numeric channels as ``group.channel``, with their units; waveforms of one interval bring their time.

    Raises:
        InputRefused: the package npTDMS is missing, the file is damaged, or it has no numeric channels.
    """
    try:
        from nptdms import TdmsFile
    except ModuleNotFoundError as error:
        raise InputRefused(f"{path.name}: .tdms files need the package npTDMS: pip install 'phnn[tdms]'") from error
    try:
        closed = _closed(path)
        channels = {
            (group.name, channel.name): (np.asarray(channel[:]), dict(channel.properties))
            for group in TdmsFile.read(path).groups()
            for channel in group.channels()
        }
    except Exception as error:  # on damaged bytes npTDMS raises errors of many kinds
        raise InputRefused(f"{path.name}: not a readable .tdms file ({error}): export it again") from error
    numeric = {names: c for names, c in channels.items() if c[0].dtype.kind in "iuf" and c[0].ndim == 1 and c[0].size}
    if not numeric:
        raise InputRefused(f"{path.name}: no numeric channels in it: record it again or remove it")
    notes: tuple[str, ...] = ()
    if not closed:
        # What was not written of a channel is missing in all.
        whole = min(values.size for values, _ in numeric.values())
        numeric = {names: (values[:whole], of) for names, (values, of) in numeric.items()}
        notes = ("the file was not closed, its channels are as long as the shortest",)
    several = len({group for group, _ in numeric}) > 1
    columns = {_name(group, name, of, several): values for (group, name), (values, of) in numeric.items()}
    intervals = {float(of.get(_INTERVAL, 0.0)) for _, of in numeric.values()}
    if len(intervals) == 1 and (interval := intervals.pop()) > 0.0:
        longest = max(values.size for values in columns.values())
        columns.setdefault("time_s", interval * np.arange(longest))
    return Table(Where(path.name), tuple(columns), tuple(columns.values()), by_name=True, notes=notes)


def _closed(path: Path) -> bool:
    """Whether the last segment was closed: one that a crash has left says that it reaches to the end of the file.

    Every other one states where the next begins, and the last ends with the file, unless bytes were lost or slipped in.

    Raises:
        ValueError: it does not.
    """
    size, first = path.stat().st_size, 0
    with path.open("rb") as file:
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
    return f"{group}.{name}" if several else name
