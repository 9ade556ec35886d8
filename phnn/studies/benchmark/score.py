"""An answer compared with the seal of its case."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from phnn.demo import Sealed
from phnn.errors import InputRefused
from phnn.studies.benchmark.answer import Answer
from phnn.studies.benchmark.cases import Entry
from phnn.studies.benchmark.folders import OUTPUT

Array = NDArray[np.float64]

# A probability below this states nothing: a tool need not list what it rules out.
_STATED = 0.02


@dataclass(frozen=True)
class Score:
    """One case, scored.

    Attributes:
        case, group, strength, plan: which case; truth: names of what was concealed, sorted; places: of it.
        claimed: names that the answer claims; unlisted: whether it claims something without a name.
        right: whether exactly what was concealed is claimed. What a background holds may stand beside; an effect
            without a name is rightly told where no name is claimed.
        placed: whether the first place is one of the true ones; placed_within: any of the first three.
        statements: probabilities that were stated, and whether what they were given to is true.
        error: of the predictions over the noise, root mean square over the recordings of the examination.
        seconds: of the processor.
    """

    case: str
    group: str
    strength: str
    plan: str
    truth: tuple[str, ...]
    places: tuple[str, ...]
    claimed: tuple[str, ...]
    unlisted: bool
    right: bool
    placed: bool
    placed_within: bool
    statements: tuple[tuple[float, bool], ...]
    error: float
    seconds: float

    @property
    def false_alarm(self) -> bool:
        """Whether something is claimed where nothing was concealed."""
        return self.group == "none" and (bool(self.claimed) or self.unlisted)

    @property
    def kind(self) -> str:
        """What cases are balanced over: none, outside, pairs, and each listed effect."""
        return self.group if self.group in ("none", "outside", "pair") else "+".join(self.truth)


def scored(entry: Entry, sealed: Sealed, exam: Mapping[str, pd.DataFrame], answer: Answer) -> Score:
    """Score an answer.

    Args:
        exam: tables of the examination by recording, with the outputs.

    Raises:
        InputRefused: a prediction has another length than its recording.
    """
    truth, beside = set(sealed.effects), set(sealed.background_effects) - set(sealed.effects)
    claimed = set(answer.claims)
    outside = entry.group == "outside"
    right = answer.claims_unlisted if outside else claimed - beside == truth and not answer.claims_unlisted
    acts = {**dict.fromkeys(truth | beside, True)}
    stated = [(p, name in acts) for name, p in answer.names.items() if p >= _STATED]
    stated += [(p, true) for p, true in ((answer.none, not truth), (answer.unlisted, outside)) if p >= _STATED]
    places = tuple(dict.fromkeys(sealed.location))
    return Score(
        entry.name, entry.group, entry.strength, entry.plan, tuple(sorted(truth)), places, tuple(sorted(claimed)),
        answer.claims_unlisted, right, bool(set(answer.places[:1]) & set(places)),
        bool(set(answer.places[:3]) & set(places)), tuple(stated), prediction_error(exam, answer.predictions, sealed),
        answer.seconds,
    )  # fmt: skip


def prediction_error(exam: Mapping[str, pd.DataFrame], predictions: Mapping[str, Array], sealed: Sealed) -> float:
    """Error over the noise; the zero of a recording, which nobody can know, is taken off. NaN where one is missing."""
    squares = []
    for name, table in exam.items():
        if name not in predictions:
            return float("nan")
        y, predicted = 1e-6 * table[OUTPUT].to_numpy(dtype=float), np.asarray(predictions[name], dtype=float)
        if predicted.shape != y.shape:
            raise InputRefused(f"{name}: {predicted.size} samples are predicted, the recording has {y.size}")
        noise = sealed.noise_rms.get(name, float(np.hypot(sealed.noise, sealed.quantisation / np.sqrt(12.0))))
        squares.append(float(np.var(y - predicted)) / noise**2)
    return float(np.sqrt(np.mean(squares)))
