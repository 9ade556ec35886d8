"""The table of features that training leaves on the disk.

    rows/NNNNN.json     the rows of one case, written when it is made: training goes on where it stopped
    validation.csv      see `studies.benchmark.fingerprints.validation`
    fingerprints.csv    all rows: number, variant, group, plan, strength, effects, beside, level, and the features

A case of twelve recordings gives two more rows, at the cost of a fit each: its four recordings that a set of four has,
and its sweep alone. They are variants of one actuator, and no validation may part them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from phnn.errors import InputRefused, PhnnError
from phnn.identification.fit import Fit
from phnn.intake.files import named_file
from phnn.parallel import executor
from phnn.recordings import Recording
from phnn.recordings.excitation import excitation_of
from phnn.results import Place
from studies.benchmark.fingerprints.actuators import Actuator, simulated
from studies.benchmark.fingerprints.cases import Drawn, drawn
from studies.benchmark.fingerprints.features import features, names
from studies.benchmark.fingerprints.fitting import fitted
from studies.benchmark.settings import GROUPS
from studies.generator.listed import LISTED

Say = Callable[[str], None]
Row = dict[str, Any]
TABLE, VALIDATION, _ROWS = "fingerprints.csv", "validation.csv", "rows"
TRAINING = (TABLE, VALIDATION, _ROWS)
KEYS = ("number", "variant", "group", "plan", "strength", "effects", "beside", "level")
_REMEDY = "give the folder that phnn bench train has written"
# The table is written anew after so many cases.
_OFTEN = 50
# Digits of a feature; frequencies [Hz] and amplitudes over the largest of the sines in a set of four.
_DIGITS = 6
_OF_FOUR = ((10.0, 1.0), (100.0, 1.0), (10.0, 2.0 / 3.0))


def train(seed: int, size: int, place: Place, where: str, say: Say) -> pd.DataFrame:
    """Make the cases of a training that are not made yet; returns the table of all.

    Args:
        seed: every case follows from it and its number; size: number of cases.
        place: claimed for the table.
        where: see `phnn.parallel.executor`; say: called with a line of progress.
    """
    (place / _ROWS).own_folder()
    todo = [n for n in range(size) if not (place / _ROWS / f"{n:05d}.json").path.exists()]
    for count, _ in enumerate(executor(where).each(partial(_made, place, seed), todo), start=1):
        say(f"trained {count} of {len(todo)}")
        if count % _OFTEN == 0:
            _write_table(place, size)
    return _write_table(place, size)


def _made(place: Place, seed: int, number: int) -> None:
    """The rows of a case; one that cannot be made has none, and is not tried again."""
    case = drawn(seed, number)
    try:
        rows = rows_of(case, simulated(case.case()))
    except PhnnError:
        rows = []
    (place / _ROWS / f"{number:05d}.json").write(json.dumps(rows).encode())


def rows_of(case: Drawn, actuator: Actuator) -> list[Row]:
    """The rows of a simulated case: all its recordings, and the variants."""
    return [row(case, actuator, variant, fitted(part)) for variant, part in variants(case.plan, actuator)]


def variants(plan: str, actuator: Actuator) -> Iterator[tuple[str, Actuator]]:
    """The actuator with all its recordings, under the name of its plan, and with some of them, under another plan's."""
    yield plan, actuator
    if plan == "twelve":
        kinds = {r.name: excitation_of(r.drive, r.dt) for r in actuator.recordings}
        largest = max(e.amplitude for e in kinds.values() if e.kind == "sine")
        sines = [(round(e.low_Hz, 3), round(e.amplitude / largest, 2), n) for n, e in kinds.items() if e.kind == "sine"]
        four = [n for f, a, n in sines if any(abs(f - f_4) < 0.01 and abs(a - a_4) < 0.01 for f_4, a_4 in _OF_FOUR)]
        yield "four", _only(actuator, [*four, *(n for n, e in kinds.items() if e.kind == "steps")])
        yield "one", _only(actuator, [n for n, e in kinds.items() if e.kind == "chirp"])


def _only(actuator: Actuator, chosen: Sequence[str]) -> Actuator:
    kept: tuple[Recording, ...] = tuple(r for r in actuator.recordings if r.name in chosen)
    return replace(actuator, recordings=kept)


def row(case: Drawn, actuator: Actuator, variant: str, found: Fit) -> Row:
    """One row of the table."""
    keys = (
        case.number, variant, case.group, case.plan, case.strength, "+".join(actuator.effects),
        "+".join(actuator.beside), actuator.level,
    )  # fmt: skip
    values = {n: None if x != x else float(f"{x:.{_DIGITS}g}") for n, x in features(found).items()}
    return {**dict(zip(KEYS, keys, strict=True)), **values}


def _write_table(place: Place, size: int) -> pd.DataFrame:
    """The rows of the first ``size`` cases that are there."""
    rows: list[Row] = []
    for path in sorted((place / _ROWS).path.glob("*.json")):
        if int(path.stem) < size:
            rows += json.loads(path.read_text(encoding="utf-8"))
    table = pd.DataFrame(rows, columns=[*KEYS, *names()])
    (place / TABLE).write(table.to_csv(index=False).encode())
    return table


def digest(folder: Path) -> str:
    """SHA-256 of the table in a folder.

    Raises:
        InputRefused: there is none.
    """
    return hashlib.sha256(named_file(folder / TABLE, (folder,), "", _REMEDY).path.read_bytes()).hexdigest()


def read_table(folder: Path) -> pd.DataFrame:
    """The table in a folder.

    Raises:
        InputRefused: it is absent, damaged, empty, or has other features than this version.
    """
    path = named_file(folder / TABLE, (folder,), "", _REMEDY).path
    try:
        text = dict.fromkeys(("variant", "group", "plan", "strength", "effects", "beside"), str)
        blank = {name: [""] for name in ("level", *names())}
        table = pd.read_csv(path, dtype=text, keep_default_na=False, na_values=blank)
    except (ValueError, UnicodeDecodeError) as error:
        raise InputRefused(f"{path}: is no table ({error}): {_REMEDY}") from error
    if list(table.columns) != [*KEYS, *names()]:
        raise InputRefused(f"{path}: has other columns than this version writes: train anew")
    if table.empty:
        raise InputRefused(f"{path}: has no rows: train with a larger size")
    if any(table[name].dtype.kind not in "if" for name in names()):
        raise InputRefused(f"{path}: holds words where numbers belong: train anew")
    strange = set(table["group"]) - set(GROUPS) or _named(table) - set(LISTED)
    if strange:
        raise InputRefused(f"{path}: has a group or an effect {min(strange)!r} that nobody conceals: train anew")
    return table


def _named(table: pd.DataFrame) -> set[str]:
    """The effects that rows name, but those that no catalogue lists."""
    listed = table[~table["group"].isin(("none", "outside"))]
    return {name for effects in listed["effects"] for name in effects.split("+")}
