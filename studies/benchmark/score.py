"""An answer compared with the seal of its case."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from phnn.effects import catalogue
from phnn.errors import InputRefused
from studies.benchmark.answer import NONE, UNLISTED, Answer
from studies.benchmark.cases import Entry
from studies.benchmark.folders import OUTPUT
from studies.generator import Sealed

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Score:
    """One case, scored.

    Attributes:
        case, group, strength, plan: which case; truth: what was concealed, sorted: names, or one of `NONE` and
            `UNLISTED`; places: of it.
        claimed: what the answer claims, sorted.
        right: whether exactly the truth is claimed; what a background holds may stand beside.
        first: whether the truth is what the answer gives the highest probabilities to, claimed or not.
        placed: whether the first place is one of the true ones; placed_within: any of the first three.
        confidence: the highest probability that was stated; confirmed: whether what it was given to is true.
        brier: sum of squared distances of all probabilities from 0 or 1.
        error: of the predictions over the noise, root mean square over the recordings of the examination; infinite
            where one is missing.
        seconds: of the processor; failed: whether the tool had no answer.
    """

    case: str
    group: str
    strength: str
    plan: str
    truth: tuple[str, ...]
    places: tuple[str, ...]
    claimed: tuple[str, ...]
    right: bool
    first: bool
    placed: bool
    placed_within: bool
    confidence: float
    confirmed: bool
    brier: float
    error: float
    seconds: float
    failed: bool

    @property
    def false_alarm(self) -> bool:
        """Whether something is claimed where nothing was concealed."""
        return self.group == "none" and bool(set(self.claimed) - {NONE})

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
    truth = frozenset({"none": (NONE,), "outside": (UNLISTED,)}.get(entry.group, sealed.effects))
    beside = frozenset(sealed.background_effects) - truth
    stated, places = answer.probabilities, tuple(dict.fromkeys(sealed.location))
    best = max(stated, key=lambda name: stated[name])
    names = {**dict.fromkeys((*catalogue(), NONE, UNLISTED), 0.0), **stated}
    answered, among = not answer.failed, answer.places if not answer.failed else ()
    # A background may be named or not.
    brier = sum((p - (name in truth)) ** 2 for name, p in names.items() if name not in beside)
    return Score(
        entry.name, entry.group, entry.strength, entry.plan, tuple(sorted(truth)), places,
        tuple(sorted(answer.claims)), answered and answer.claims - beside == truth,
        answered and _without(answer, beside).first(len(truth)) == truth, bool(set(among[:1]) & set(places)),
        bool(set(among[:3]) & set(places)), stated[best], answered and best in truth | beside, brier,
        prediction_error(exam, answer.predictions, sealed), answer.seconds, bool(answer.failed),
    )  # fmt: skip


def _without(answer: Answer, names: frozenset[str]) -> Answer:
    return replace(answer, names={n: p for n, p in answer.names.items() if n not in names})


def prediction_error(exam: Mapping[str, pd.DataFrame], predictions: Mapping[str, Array], sealed: Sealed) -> float:
    """Error over the noise; the zero of a recording, which nobody can know, is taken off.

    Infinite where a prediction is missing, or is no number somewhere.
    """
    squares = []
    for name, table in exam.items():
        if name not in predictions:
            return float("inf")
        y, predicted = 1e-6 * table[OUTPUT].to_numpy(dtype=float), np.asarray(predictions[name], dtype=float)
        if predicted.shape != y.shape:
            raise InputRefused(f"{name}: {predicted.size} samples are predicted, the recording has {y.size}")
        noise = sealed.noise_rms.get(name, float(np.hypot(sealed.noise, sealed.quantisation / np.sqrt(12.0))))
        squares.append(float(np.var(y - predicted)) / noise**2)
    found = float(np.sqrt(np.mean(squares)))
    return found if np.isfinite(found) else float("inf")
