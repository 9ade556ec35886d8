"""`phnn diagnose` as a tool, with all its parts and without one of them, and the base model alone.

A verdict is no probability. The constants below translate verdicts. They are rounded shares of right answers in the
43 first cases of the benchmark of seed 26117 and in 37 cases of seeds 40117 and 40118 (with more cases of another form
than a benchmark has), and nothing of any other seed. The calibration error of a score says how good they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from phnn.diagnosis.diagnosis import available, diagnose, input_measured
from phnn.diagnosis.scored import scored
from phnn.effects import Effect
from phnn.errors import PhnnError
from phnn.identification.options import Options
from phnn.predictor import of_network
from phnn.recordings import read
from phnn.report.result import document
from studies.benchmark.bench import Answer
from studies.benchmark.tools.common import base_of, fitted_with, predictions

# Probability that a verdict is right: a single name, a class of names, something without a name, nothing.
_NAMED, _CLASS, _UNKNOWN, _NONE = 0.97, 0.95, 0.65, 0.97
# Of a class, that its first member, which fits best, is the true one.
_FIRST = 0.6
# Elements with these claim a name.
_CLAIMING = ("named", "equivalent")
# Held-out recordings take out nothing but what makes their error clearly larger.
_NO_VETO = {
    **dict.fromkeys(("material", "material_share", "named_gain", "untested_fall"), 1e-9),
    "held_out_level": 0.999,
}
# Every candidate of the catalogue is refitted until it converges.
_NO_RACE = {
    **dict.fromkeys(("enter_large", "enter_second", "enter_last"), 1000),
    **dict.fromkeys(("least_saving", "least_score", "explained_left"), 1e-9),
    **dict.fromkeys(("near_moving", "near_at_rest", "incomparable_left"), 1e9),
}
# Probability of the name with the highest score, and that nothing is missing where no score is significant.
_HIGHEST, _NO_SCORE = 0.6, 0.95


def answer(folder: Path, seed: int) -> Answer:
    """Diagnose a case."""
    return _diagnosed(folder, Options(seed=seed, workers=1))


def without_veto(folder: Path, seed: int) -> Answer:
    """Diagnose; names and models stand whatever held-out recordings say, unless they become clearly worse."""
    return _diagnosed(folder, Options(seed=seed, workers=1, criteria=_NO_VETO))


def without_racing(folder: Path, seed: int) -> Answer:
    """Diagnose; no candidate is dropped before its refit has converged."""
    return _diagnosed(folder, Options(seed=seed, workers=1, criteria=_NO_RACE))


def without_learned(folder: Path, seed: int) -> Answer:
    """Diagnose; no learned element is added for what no name explains."""
    return _diagnosed(folder, Options(seed=seed, workers=1), learned=())


def scores_only(folder: Path, seed: int) -> Answer:
    """Name the effect with the highest score on the base model, refitted once; no local functions."""
    base = base_of(folder, seed)
    effects = available(base.campaign, base.fit.setup)
    found = scored(base.fit, effects, seed, terminals=input_measured(base.campaign, base.fit.setup))
    if not found.significant or not found.naming.candidates:
        return Answer({}, none=_NO_SCORE, predictions=predictions(base.fit, folder))
    best = found.naming.candidates[0]
    try:
        refitted = fitted_with(base.fit, best.effect, best.values)
    except PhnnError:
        refitted = base.fit
    names = {best.effect.canonical: _HIGHEST}
    return Answer(names, places=(best.effect.location,), predictions=predictions(refitted, folder))


def nothing(folder: Path, seed: int) -> Answer:
    """Say that nothing is missing, for certain, and predict with the base model."""
    return Answer({}, none=1.0, predictions=predictions(base_of(folder, seed).fit, folder))


def _diagnosed(folder: Path, options: Options, learned: Sequence[Effect] | None = None) -> Answer:
    diagnosis = diagnose(read(folder), options, learned=learned)
    model, exam = diagnosis.model, read(folder / "exam", need_output=False)
    predicted = {p.recording.name: p.y for p in of_network(model.setup, model.substeps, exam)}
    return as_answer(document(diagnosis), predicted)


def as_answer(content: Mapping[str, Any], predicted: Mapping[str, Any]) -> Answer:
    """Return the answer that ``diagnosis.json`` gives, with predictions of the examination."""
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
