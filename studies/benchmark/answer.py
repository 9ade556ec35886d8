"""The answer of a tool to a case: ``answer.json``, and a table with a prediction for each recording of the examination.

    {"schema": "phnn.answer/1", "names": {"creep": 0.8, "extra_hysteron": 0.1}, "none": 0.05, "unlisted": 0.05,
     "places": ["mechanical"], "seconds": 41.0}

``names`` holds the probability of each effect that it is missing, as far as the tool deems it possible; ``none`` that
nothing is missing; ``unlisted`` that something is missing which the list of effects does not have. Several effects may
be missing at once, so that the probabilities need not add up to one. ``places`` holds the locations of what is missing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from phnn.effects import catalogue
from phnn.effects.kinds import LOCATIONS
from phnn.errors import InputRefused, meant
from phnn.intake.files import named_file
from phnn.results import Place
from studies.benchmark.folders import OUTPUT, document_of

Array = NDArray[np.float64]

SCHEMA = "phnn.answer/1"
FILE = "answer.json"
# From here on a probability counts as a claim.
CLAIMED = 0.5
NONE, UNLISTED = "none", "unlisted"
_KEYS = ("schema", "names", "none", "unlisted", "places", "seconds", "failed")


@dataclass(frozen=True)
class Answer:
    """Attributes:
    names: probability of each effect that it is missing; none: that nothing is; unlisted: that something is which has
        no name.
    places: locations of what is missing, the first one first.
    predictions: (N,) displacement [m] by recording of the examination.
    seconds: of the processor.
    failed: why the tool has no answer; empty where it has one.
    """

    names: Mapping[str, float]
    none: float = 0.0
    unlisted: float = 0.0
    places: tuple[str, ...] = ()
    predictions: Mapping[str, Array] = field(default_factory=dict, compare=False)
    seconds: float = math.nan
    failed: str = ""

    def __post_init__(self) -> None:
        known = catalogue()
        for name in self.names:
            if name not in known:
                raise InputRefused(f"an answer names {name!r}{meant(name, known)}: the list has {', '.join(known)}")
        for name, value in self.probabilities.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
                raise InputRefused(f"an answer gives {name} the probability {value}: give a number from 0 to 1")
        for place in self.places:
            if place not in LOCATIONS:
                raise InputRefused(f"an answer has the place {place!r}: there are {', '.join(LOCATIONS)}")

    @property
    def probabilities(self) -> dict[str, float]:
        """All that is stated: of names, and under `NONE` and `UNLISTED`."""
        return {**self.names, NONE: self.none, UNLISTED: self.unlisted}

    @property
    def claims(self) -> frozenset[str]:
        """What is claimed: names, `NONE`, `UNLISTED`."""
        return frozenset(name for name, p in self.probabilities.items() if p >= CLAIMED)

    def first(self, count: int) -> frozenset[str]:
        """The most probable of all that is stated; empty where that is not unique."""
        ordered = sorted(self.probabilities.items(), key=lambda item: -item[1])
        chosen = ordered[:count]
        tied = len(ordered) > count and ordered[count][1] >= chosen[-1][1]
        return frozenset() if tied or chosen[-1][1] == 0.0 else frozenset(name for name, _ in chosen)


def write_answer(answer: Answer, place: Place, times: Mapping[str, Array]) -> None:
    """Write an answer into a folder; ``answer.json`` comes last.

    Args:
        times: (N,) [s] of the recordings of the examination.
    """
    for name, y in answer.predictions.items():
        table = pd.DataFrame({"time_s": times[name], OUTPUT: 1e6 * np.asarray(y)})
        (place / f"{name}.csv").write(table.to_csv(index=False).encode())
    content = {
        "schema": SCHEMA,
        "names": dict(answer.names),
        "none": answer.none,
        "unlisted": answer.unlisted,
        "places": list(answer.places),
        "seconds": answer.seconds,
        **({"failed": answer.failed} if answer.failed else {}),
    }
    (place / FILE).write_json(content)


def read_answer(folder: Path) -> Answer:
    """Read an answer.

    Raises:
        InputRefused: it is absent, damaged, or says what no answer can; names file and value.
    """
    content = document_of(folder / FILE, SCHEMA, "an answer", f"give a folder with an {FILE} for each case")
    unknown = [key for key in content if key not in _KEYS]
    if unknown:
        raise InputRefused(f"{folder / FILE}: unknown key {unknown[0]!r}{meant(unknown[0], _KEYS)}")
    names, places = content.get("names", {}), content.get("places", [])
    if not isinstance(names, dict) or not isinstance(places, list):
        raise InputRefused(f"{folder / FILE}: names must be an object of numbers, places a list of words")
    try:
        return Answer(
            names, content.get("none", 0.0), content.get("unlisted", 0.0), tuple(places), _predictions(folder),
            _seconds(content.get("seconds")), str(content.get("failed", "")),
        )  # fmt: skip
    except InputRefused as error:
        raise InputRefused(f"{folder / FILE}: {error}") from error


def _seconds(value: Any) -> float:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan


def _predictions(folder: Path) -> dict[str, Array]:
    found = {}
    for path in sorted(folder.glob("*.csv")):
        try:
            table = pd.read_csv(named_file(path, (folder,)).path)
            values = table[OUTPUT].to_numpy(dtype=float)
        except (ValueError, KeyError) as error:
            raise InputRefused(f"{path.name}: no numbers in a column {OUTPUT} ({error})") from error
        found[path.stem] = 1e-6 * values
    return found
