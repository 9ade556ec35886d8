"""MATLAB's ``iddata`` as a structure: ``s = get(data)`` and then ``save('data.mat', 's')``.

The object itself cannot be read: its content lies in an undocumented part of the file.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

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


def iddata_table(where: Where, fields: Mapping[str, Any]) -> Table:
    """Time, inputs and outputs of an ``iddata``; each experiment is a segment.

    Channels that have no name of a quantity are called voltage and displacement where their units are such, else input
    and output, if there is one of each; several keep their names.
    """
    if _texts(fields.get("Domain"))[:1] not in ([], ["Time"]):
        raise InputRefused(f"{where}: iddata in the frequency domain: save the samples over time")
    experiments = _experiments(where, fields)
    counts = {(inputs.shape[1], outputs.shape[1]) for inputs, outputs, _ in experiments}
    if len(counts) > 1:
        raise InputRefused(f"{where}: the experiments of the iddata have different channels: save them one by one")
    unit = (_texts(fields.get("TimeUnit")) or ["seconds"])[0]
    columns = {f"time [{unit}]": np.concatenate([time for _, _, time in experiments])}
    both = np.concatenate([np.hstack([inputs, outputs]) for inputs, outputs, _ in experiments])
    columns |= dict(zip(_names(fields, counts.pop()), both.T, strict=True))
    segments = tuple(np.cumsum([time.size for _, _, time in experiments])[:-1].tolist())
    return Table(where, tuple(columns), tuple(columns.values()), True, _notes(fields), segments=segments)


def _experiments(where: Where, fields: Mapping[str, Any]) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """(N, inputs) and (N, outputs) samples, and (N,) time in the unit of the structure, of every experiment."""
    outputs, inputs = _cells(fields["OutputData"]), _cells(fields["InputData"])
    if len(outputs) != len(inputs):
        raise InputRefused(f"{where}: {len(inputs)} inputs and {len(outputs)} outputs of experiments: save it again")
    several = (_each(fields.get(n), len(outputs)) for n in ("Ts", "Tstart", "SamplingInstants"))
    found = []
    for u, y, step, start, at in zip(map(_matrix, inputs), map(_matrix, outputs), *several, strict=True):
        size = y.shape[0]
        u = u if u.size else np.empty((size, 0))
        if step is not None and step.size == 1:
            first = start if start is not None and start.size == 1 else step
            time = first.flat[0] + step.flat[0] * np.arange(size)
        elif at is not None and at.size == size:
            time = at.ravel()
        else:
            raise InputRefused(f"{where}: the iddata has neither Ts nor SamplingInstants: set data.Ts, in seconds")
        if u.shape[0] != size:
            raise InputRefused(f"{where}: {u.shape[0]} samples of the input, {size} of the output: save it again")
        found.append((u, y, np.asarray(time, dtype=float)))
    return found


def _names(fields: Mapping[str, Any], counts: tuple[int, int]) -> list[str]:
    """Names of all channels, with their units, inputs first."""
    sides = tuple(zip(("Input", "Output"), counts, strict=True))
    units = [_padded(fields.get(f"{side}Unit"), n, "") for side, n in sides]
    names = [_padded(fields.get(f"{side}Name"), n, side[0].lower()) for side, n in sides]
    if counts == (1, 1):
        actuator = suits("voltage", units[0][0]) and suits("displacement", units[1][0])
        plain = ("voltage", "displacement") if actuator else ("input", "output")
        names = [[n[0] if parse_name(n[0]) else word] for n, word in zip(names, plain, strict=True)]
    pairs = zip(names[0] + names[1], units[0] + units[1], strict=True)
    return [f"{n} [{u}]" if u and (parse_name(n) or ("", None))[1] is None else n for n, u in pairs]


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
