"""Checks of what was recorded: each refuses with one message that names place, value, cause and remedy."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from rich import filesize

from phnn.errors import InputRefused
from phnn.intake import LIMITS, available_memory, reached
from phnn.recordings.table import Where
from phnn.results import NOTES, listed, printable

_REMEDIES = {"time": "name one time_s, or write sample_rate_hz in recordings.yaml"} | {
    quantity: f"name the column with its unit, such as {quantity}_{unit}, or write in recordings.yaml "
    f"columns: {{{quantity}: {{column: ..., unit: {unit}}}}} (phnn template FOLDER prints a first one)"
    for quantity, unit in (("voltage", "V"), ("displacement", "um"))
}
FEWEST_SAMPLES = 50
# Bytes that any machine has; to ask for what is available takes time.
_MUCH = 10**8
LARGEST_VALUE = 1e30
# What varies by less is constant, in any unit; its squares would be no numbers any more.
SMALLEST_RANGE = 1e-60
# Shortest and longest sampling interval, s: a decade beyond the fastest digitiser, and thirty years.
INTERVALS = (1e-13, 1e9)
# Results of the commands, of which one lies in the folder of every result.
_RESULTS = (
    "diagnosis.json", "identify.json", "predict.json", "compare.json", "modes.json", "invert.json", "model.json",
)  # fmt: skip
# Largest voltages and strokes of piezo actuators, SI: a decade beyond what is sold, from sensor to transducer.
ACTUATORS = {"voltage": (1e-5, 1e5, "V"), "displacement": (1e-10, 1e-2, "m")}


def folder_exists(folder: Path) -> None:
    """Refuse a folder that is absent, out of reach or a file."""
    _, status = reached(folder, "folder ", "folder", "check the path")
    if not stat.S_ISDIR(status.st_mode):
        remedy = "give the folder that holds it (one file is one recording)"
        raise InputRefused(f"{printable(str(folder))}: this is a file: {remedy}")


def any_recordings(files: Sequence[Path], others: Sequence[str], folder: Path) -> None:
    """Refuse a folder without recordings, naming what lies in it."""
    if files:
        return
    content = f"; it holds {listed(others)}" if others else "; it is empty"
    remedy = "add .csv files with columns time_s, voltage_V, displacement_um"
    other = "describe the files in recordings.yaml (`phnn template` writes a first one)"
    raise InputRefused(f"folder {printable(str(folder))}: no recordings in it{content}: {remedy}, or {other}")


def no_results(folder: Path) -> None:
    """Refuse the folder of a result in the place of that of the recordings, unless it has a manifest."""
    result = next((name for name in _RESULTS if os.path.isfile(folder / name)), None)
    if result is not None and os.path.isdir(folder / NOTES) and not os.path.lexists(folder / "recordings.yaml"):
        remedy = "give the folder of the recordings, or describe those in this one in recordings.yaml"
        raise InputRefused(f"folder {printable(str(folder))}: holds a result of phnn ({result}): {remedy}")


def not_too_many(recordings: int, samples: int, folder: Path) -> None:
    """Refuse more recordings or samples than the limits say."""
    counts = (recordings, LIMITS.recordings, "recordings"), (samples, LIMITS.samples, "samples")
    for count, most, what in counts:
        if count > most:
            cause = f"more than {most} {what}"
            raise InputRefused(f"folder {printable(str(folder))}: {cause}: divide them among several folders")
    taken = samples * LIMITS.sample_bytes
    if taken > _MUCH and taken > available_memory():
        cause = f"{samples} samples take {filesize.decimal(taken)} of memory to check, and less is available"
        remedy = "export fewer, or divide them among several folders"
        raise InputRefused(f"folder {printable(str(folder))}: {cause}: {remedy}")


def unique_names(names: Iterable[tuple[str, str]]) -> None:
    """Refuse two recordings, given as ``(name, file)``, of one name."""
    seen: dict[str, str] = {}
    for name, file in names:
        if name in seen:
            remedy = "rename a file, or give each a `name` in recordings.yaml"
            raise InputRefused(f"two recordings are called {name!r} ({seen[name]} and {file}): {remedy}")
        seen[name] = file


def absent(quantity: str, names: Sequence[str], where: Where) -> InputRefused:
    """Return the refusal of a file without a column that is needed."""
    named = [name for name in names if name]
    columns = f"columns found: {listed(named)}" if named else "the columns have no names"
    return InputRefused(f"{where}: no {quantity} column ({columns}): {_REMEDIES[quantity]}")


def enough_samples(size: int, where: Where) -> None:
    """Refuse a recording of fewer than 50 samples."""
    if size < FEWEST_SAMPLES:
        cause = f"{size} sample{'s' if size != 1 else ''}, at least {FEWEST_SAMPLES} are needed"
        raise InputRefused(f"{where}: {cause}: record longer or faster, or remove the file")


def finite(values: np.ndarray, label: str, where: Where, mask: str) -> None:
    """Refuse missing and infinite values, and numbers that no instrument writes; ``mask`` says how they are masked."""
    bad = ~(np.abs(values) < LARGEST_VALUE)
    if bad.any():
        row = int(np.argmax(bad))
        what = "is missing (NaN or empty)" if np.isnan(values[row]) else f"is {values[row]:g}"
        cause = f"{label}, {where.row(row)}: the value {what}, {int(bad.sum())} such rows in all"
        remedy = f"repair them, or cut the recording there (`slice` in recordings.yaml){mask}"
        if bad.all():
            remedy = "choose another column, or remove this one from the file"
        raise InputRefused(f"{where}: {cause}: {remedy}")


def disorder(t: np.ndarray, where: Where, rows: np.ndarray) -> InputRefused:
    """Return the refusal of a time that goes back or stands still; ``rows`` of the file are those of the instants."""
    steps = np.diff(t)
    bad, cause = steps == 0.0, "two rows with one time"
    remedy = "delete the repeated row, write time with more digits, or say its rate, sample_rate_hz, in recordings.yaml"
    if (steps < 0.0).any():
        bad, cause = steps < 0.0, "time goes back"
        remedy = "sort the rows, or say `segments: true` in recordings.yaml where new recordings begin"
    i = int(np.argmax(bad)) + 1
    row = where.row(int(rows[i]))
    return InputRefused(f"{where}: time, {row}: {cause} ({t[i - 1]:.9g} s, then {t[i]:.9g} s): {remedy}")


def interval(dt: float, where: Where) -> None:
    """Refuse a sampling interval [s] that no instrument has."""
    least, most = INTERVALS
    if not least <= dt <= most:
        cause = f"samples {dt:.3g} s apart, between {least:g} s and {most:g} s are accepted"
        raise InputRefused(f"{where}: {cause}: correct the unit of time, or the sample rate")


def output_moves(y: np.ndarray, label: str, where: Where) -> None:
    """Refuse a constant output."""
    if np.ptp(y) <= SMALLEST_RANGE:
        cause = f"{label}: constant at {y[0]:.6g} in all {y.size} rows"
        raise InputRefused(f"{where}: {cause}: check the sensor and the choice of column")


def input_moves(u: np.ndarray, before: float | None, label: str, where: Where) -> None:
    """Refuse a constant input, unless the recording begins with a step from rest at ``before``."""
    if np.ptp(u) <= SMALLEST_RANGE and (before is None or abs(before - u[0]) <= SMALLEST_RANGE):
        cause = f"constant at {u[0]:.6g} in all {u.size} rows, nothing drives the system"
        remedy = "state the step at the start in recordings.yaml, start: {state: rest, input_before: ...}"
        raise InputRefused(f"{where}: {label}: {cause}: check the column, or {remedy}")


def turned(source: str) -> str:
    """Return how to reverse the sign of one recording among others that have the right one."""
    return (
        "a wire or a sign is reversed; list every file under `recordings` of recordings.yaml (`phnn template` does), "
        f"this one as {{file: {source}, columns: {{OUTPUT: {{scale: -1}}}}}}, where OUTPUT is displacement, for example"
    )


def like_an_actuator(size: float, quantity: str, label: str, where: Where) -> None:
    """Refuse what no piezo actuator does: its numbers are in another unit than is said."""
    least, most, unit = ACTUATORS[quantity]
    if not least <= size <= most:
        cause = f"a {quantity} of {size:.3g} {unit}, a piezo actuator's lies between {least:g} and {most:g} {unit}"
        remedy = "describe another system as a network, setup: {network: FILE.yaml} in recordings.yaml"
        raise InputRefused(f"{where}: {quantity} ({label}): {cause}: correct the unit, or {remedy}")
