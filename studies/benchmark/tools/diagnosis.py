"""`phnn diagnose` as a tool, with all its parts and without one of them, and the base model alone.

Names that are claimed have the probabilities that the diagnosis gives them. An unknown cause has none: the constant
below is the rounded share of right ones in cases of other seeds than those of a benchmark.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from phnn import predictor
from phnn.criteria import Criteria
from phnn.diagnose.diagnosis import available, diagnose
from phnn.diagnose.linearised import prepare
from phnn.diagnose.screen import Screen
from phnn.effects import Effect
from phnn.errors import PhnnError
from phnn.identification.plan import Options
from phnn.recordings import read
from studies.benchmark.bench import Answer
from studies.benchmark.tools.common import base_of, fitted_with, predictions
from studies.sealed.run import Row, logged

# Probability that something without a name is missing, where the verdict is that it is.
_UNKNOWN = 0.65
# Elements with these claim a name.
_CLAIMING = ("named", "equivalent")
# The model is the best one by its fit, whatever it makes of held-out recordings.
_NO_VETO = {"material_share": 1e9}
# Every candidate of the catalogue is refitted.
_NO_RACE = {"near_best": 1e-9, "near_best_far": 1e-9, "refits": 1000, "score": 1e-9}
# Probability of the name with the highest score, and that nothing is missing where no score is significant.
_HIGHEST, _NO_SCORE = 0.6, 0.95


def answer(
    folder: Path, seed: int, criteria: Mapping[str, float] | None = None, learned: Sequence[Effect] | None = None
) -> Answer:
    """Diagnose a case, with other criteria or learned elements than those of phnn if some are given."""
    diagnosis = diagnose(read(folder), Options(seed=seed, workers=1, criteria=criteria or {}), learned=learned)
    model, exam = diagnosis.model, read(folder / "exam", need_output=False)
    predicted = {p.recording.name: p.y for p in predictor.predictions(model, exam)}
    return as_answer(logged(diagnosis, 0.0), predicted)


# Held-out recordings decide nothing; no candidate is dropped before its refit; no learned element is added.
without_veto = partial(answer, criteria=_NO_VETO)
without_racing = partial(answer, criteria=_NO_RACE)
without_learned = partial(answer, learned=())


def scores_only(folder: Path, seed: int) -> Answer:
    """Name the effect with the largest predicted fall of χ² on the base model, refitted once."""
    base, criteria = base_of(folder, seed), Criteria()
    linearised = prepare(base.fit)
    candidates = Screen(linearised, available(base.campaign, base.fit.setup), criteria)(linearised)
    best = next((c for c in candidates if c.score > criteria.score), None)
    if best is None:
        return Answer({}, none=_NO_SCORE, predictions=predictions(base.fit, folder))
    try:
        refitted = fitted_with(base.fit, best.effect, best.values)
    except PhnnError:
        refitted = base.fit
    names = {best.effect.canonical: _HIGHEST}
    return Answer(names, places=(best.effect.location,), predictions=predictions(refitted, folder))


def nothing(folder: Path, seed: int) -> Answer:
    """Say that nothing is missing, for certain, and predict with the base model."""
    return Answer({}, none=1.0, predictions=predictions(base_of(folder, seed).fit, folder))


def as_answer(row: Row, predicted: Mapping[str, Any]) -> Answer:
    """Return the answer that a row of a log gives, with predictions of the examination."""
    claimed = [c for c in row["claims"] if c["status"] in _CLAIMING]
    names = {n: row["probability"].get(n, 0.0) for c in claimed for n in (c["effect"], *c["alike"])}
    none = row["probability"].get("none", 0.0) if row["verdict"] == "none" else 0.0
    unlisted = _UNKNOWN if row["verdict"] == "unknown" and not names else 0.0
    return Answer(names, none, unlisted, tuple(row["places"]), predicted)
