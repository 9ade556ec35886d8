"""`phnn diagnose` as a tool.

A verdict is no probability. The constants below translate verdicts. They are rounded shares of right answers in the
43 first cases of the benchmark of seed 26117 and in 37 cases of seeds 40117 and 40118 (with more cases of another form
than a benchmark has), and nothing of any other seed. The calibration error of a score says how good they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from phnn.diagnosis.diagnosis import diagnose
from phnn.effects import Effect
from phnn.identification.options import Options
from phnn.recordings import read
from phnn.report.result import document
from studies.benchmark.answer import Answer
from studies.benchmark.tools.common import predictions

# Probability that a verdict is right: a single name, a class of names, something without a name, nothing.
_NAMED, _CLASS, _UNKNOWN, _NONE = 0.97, 0.95, 0.65, 0.97
# Of a class, that its first member, which fits best, is the true one.
_FIRST = 0.6
# Elements with these claim a name.
_CLAIMING = ("named", "equivalent")


def answer(folder: Path, seed: int) -> Answer:
    """Diagnose a case."""
    return diagnosed(folder, Options(seed=seed, workers=1))


def diagnosed(folder: Path, options: Options, learned: Sequence[Effect] | None = None) -> Answer:
    """Diagnose a case with other options, or with other elements without a name."""
    diagnosis = diagnose(read(folder), options, learned=learned)
    return as_answer(document(diagnosis), predictions(diagnosis.model, folder))


def as_answer(content: Mapping[str, Any], predicted: Mapping[str, Any]) -> Answer:
    """The answer that ``diagnosis.json`` gives, with predictions of the examination."""
    names: dict[str, float] = {}
    for entry in content["missing"]:
        if entry["status"] in _CLAIMING and entry["effect"] != "unknown":
            first, *others = dict.fromkeys((entry["effect"], *entry["equivalent_to"]))
            names[first] = _FIRST if others else _NAMED
            for name in others:
                names.setdefault(name, (_CLASS - _FIRST) / len(others))
    verdict, location = content["verdict"], content["location"]
    places = () if location is None else (location["name"], *location["tied"])
    return Answer(
        names, _NONE if verdict == "none" else 0.0, _UNKNOWN if verdict == "unknown" else 0.0, places, predicted
    )
