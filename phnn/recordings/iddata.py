"""MATLAB's ``iddata`` as a structure: ``s = get(data)`` and then ``save('data.mat', 's')``.

The object itself cannot be read: its content lies in an undocumented part of the file.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from phnn.errors import InputRefused
from phnn.recordings.table import Table, Where
from phnn.recordings.units import parse_name, suits
from phnn.results import printable

KIND = "iddata"
# A structure with these fields is one; further fields may be absent.
_NEEDED = frozenset({"OutputData", "InputData", "Ts"})
# Fields that are read.
FIELDS = (
    *("OutputData", "InputData", "Ts", "Tstart", "SamplingInstants", "TimeUnit", "Domain", "InterSample"),
    *("InputName", "InputUnit", "OutputName", "OutputUnit", "ExperimentName"),
)
_HOLDS = {"zoh": "zero_order", "foh": "linear", "bl": "band_limited"}


def is_iddata(fields: Collection[str]) -> bool:
    """Whether a structure with these fields is an ``iddata``."""
    return set(fields) >= _NEEDED


def refused_object(where: Where, variable: str) -> InputRefused:
    """The refusal of an object, with the line that converts it."""
    return InputRefused(
        f"{where}: {variable} is an iddata object, whose content only MATLAB can read: in MATLAB say "
        f"s = get({variable}); save('{variable}.mat', 's')"
    )


class _Experiment(NamedTuple):
    """One experiment: (N, inputs) and (N, outputs) samples, and (N,) time in the unit of the structure."""

    inputs: np.ndarray
    outputs: np.ndarray
    time: np.ndarray


def iddata_table(where: Where, fields: Mapping[str, Any]) -> Table:
    """Time, inputs and outputs of an ``iddata``; each experiment is a segment.

    Channels that have no name of a quantity are called voltage and displacement where their units are such, else input
    and output, if there is one of each; several keep their names.

    Raises:
        InputRefused: data in the frequency domain, without sampling times, or whose experiments do not agree.
    """
    if _texts(fields.get("Domain"))[:1] not in ([], ["Time"]):
        raise InputRefused(f"{where}: iddata in the frequency domain: save the samples over time")
    experiments = _experiments(where, fields)
    channels = _names(fields, experiments[0])
    if any((e.inputs.shape[1], e.outputs.shape[1]) != channels.counts for e in experiments):
        raise InputRefused(f"{where}: the experiments of the iddata have different channels: save them one by one")
    unit = (_texts(fields.get("TimeUnit")) or ["seconds"])[0]
    columns = {f"time [{unit}]": np.concatenate([e.time for e in experiments])}
    both = np.concatenate([np.hstack([e.inputs, e.outputs]) for e in experiments])
    columns |= dict(zip(channels.names, both.T, strict=True))
    edges = np.cumsum([e.time.size for e in experiments])[:-1]
    return Table(
        where,
        tuple(columns),
        tuple(columns.values()),
        True,
        _notes(fields),
        segments=tuple(int(edge) for edge in edges),
    )


def _experiments(where: Where, fields: Mapping[str, Any]) -> list[_Experiment]:
    outputs, inputs = _cells(fields["OutputData"]), _cells(fields["InputData"])
    if len(outputs) != len(inputs):
        raise InputRefused(f"{where}: {len(inputs)} inputs and {len(outputs)} outputs of experiments: save it again")
    count = len(outputs)
    steps, starts, instants = (_each(fields.get(n), count) for n in ("Ts", "Tstart", "SamplingInstants"))
    found = []
    for u, y, step, start, at in zip(map(_matrix, inputs), map(_matrix, outputs), steps, starts, instants, strict=True):
        size = y.shape[0]
        u = u if u.size else np.empty((size, 0))
        if step is not None and step.size == 1:
            time = (start.flat[0] if start is not None and start.size == 1 else step.flat[0]) + step.flat[
                0
            ] * np.arange(size)
        elif at is not None and at.size == size:
            time = at.ravel()
        else:
            raise InputRefused(f"{where}: the iddata has neither Ts nor SamplingInstants: set data.Ts, in seconds")
        if u.shape[0] != size:
            raise InputRefused(f"{where}: {u.shape[0]} samples of the input, {size} of the output: save it again")
        found.append(_Experiment(u, y, np.asarray(time, dtype=float)))
    return found


class _Names(NamedTuple):
    """Names of all channels, inputs first, and how many of each there are."""

    names: list[str]
    counts: tuple[int, int]


def _names(fields: Mapping[str, Any], one: _Experiment) -> _Names:
    counts = (one.inputs.shape[1], one.outputs.shape[1])
    units = [_padded(fields.get(f"{side}Unit"), n, "") for side, n in zip(("Input", "Output"), counts, strict=True)]
    names = [
        _padded(fields.get(f"{side}Name"), n, side[0].lower())
        for side, n in zip(("Input", "Output"), counts, strict=True)
    ]
    if counts == (1, 1):
        actuator = suits("voltage", units[0][0]) and suits("displacement", units[1][0])
        plain = ("voltage", "displacement") if actuator else ("input", "output")
        names = [[n[0] if parse_name(n[0]) else word] for n, word in zip(names, plain, strict=True)]
    flat = [(n, u) for some, of in zip(names, units, strict=True) for n, u in zip(some, of, strict=True)]
    return _Names([f"{n} [{u}]" if u and (parse_name(n) or ("", None))[1] is None else n for n, u in flat], counts)


def _padded(value: Any, count: int, prefix: str) -> list[str]:
    """Texts of all channels; those that are absent are numbered, or empty without a prefix."""
    texts = _texts(value)
    absent = [f"{prefix}{i}" if prefix else "" for i in range(1, count + 1)]
    return [texts[i] if i < len(texts) and texts[i] else absent[i] for i in range(count)]


def _notes(fields: Mapping[str, Any]) -> tuple[str, ...]:
    """What the structure says that is not taken over."""
    experiments = _texts(fields.get("ExperimentName"))
    held = [_HOLDS[word] for word in _texts(fields.get("InterSample")) if word in _HOLDS]
    notes = [f"experiments of the iddata in order: {', '.join(experiments)}"] if len(experiments) > 1 else []
    if held:
        # MATLAB writes zoh where nobody said anything, so that it proves nothing.
        notes.append(f"the iddata says how its input goes on between samples: if so, write `input: {held[0]}`")
    return tuple(notes)


def _cells(value: Any) -> list[Any]:
    """The cells of a cell array, or the one value."""
    if isinstance(value, list | tuple):
        return list(value)
    array = np.asarray(value)
    return list(array.ravel()) if array.dtype == object else [array]


def _each(value: Any, count: int) -> Sequence[np.ndarray | None]:
    """A number or array for each experiment; one for all is repeated, None stands for nothing."""
    if value is None:
        return [None] * count
    cells: list[np.ndarray | None] = [np.asarray(cell, dtype=float) for cell in _cells(value)]
    return cells if len(cells) == count else (cells[:1] or [None]) * count


def _matrix(value: Any) -> np.ndarray:
    """(N, channels); a vector is one channel."""
    array = np.asarray(value, dtype=float)
    return array.reshape(-1, 1) if array.ndim < 2 else array


def _texts(value: Any) -> list[str]:
    """The texts in a text, a list or a cell array, however deep."""
    if isinstance(value, str):
        return [printable(value)]
    if isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.dtype.kind in "OU"):
        return [text for one in np.asarray(value, dtype=object).ravel() for text in _texts(one)]
    return []
