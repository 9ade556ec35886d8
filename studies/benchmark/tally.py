"""Figures over the scores of a tool."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from studies.benchmark.cases import PLANS, STRENGTHS
from studies.benchmark.paired import paired_interval
from studies.benchmark.score import Score
from studies.benchmark.settings import GROUPS
from studies.proof.page import Rate

# Equal bins of probability for the calibration error.
_BINS = 10


def balanced_accuracy(scores: Sequence[Score]) -> float:
    """Mean over the kinds of truth of the share that is right; NaN without cases."""
    kinds: dict[str, list[bool]] = {}
    for s in scores:
        kinds.setdefault(s.kind, []).append(s.right)
    return float(np.mean([np.mean(found) for found in kinds.values()])) if kinds else float("nan")


def calibration_error(scores: Sequence[Score]) -> float:
    """Expected calibration error of the highest probability that each answer states: mean distance of probability and
    frequency in ten bins, weighted by their numbers (Naeini, Cooper & Hauskrecht 2015). NaN without answers.

    It asks only whether probabilities are honest: a tool that states in every case how often it is right on average is
    calibrated. The Brier score asks also whether they tell cases apart. Cases without an answer do not count.
    """
    scores = [s for s in scores if not s.failed]
    if not scores:
        return float("nan")
    stated = np.array([s.confidence for s in scores])
    true = np.array([s.confirmed for s in scores], dtype=float)
    bins = np.minimum((_BINS * stated).astype(int), _BINS - 1)
    distances = [abs(float(np.sum(stated[bins == b] - true[bins == b]))) for b in np.unique(bins)]
    return float(sum(distances) / len(scores))


def listed(scores: Sequence[Score]) -> list[Score]:
    """Those with listed effects and nothing beside them: groups same, other and pair."""
    return [s for s in scores if s.group in ("same", "other", "pair")]


@dataclass(frozen=True)
class Difference:
    """Right answers of two tools to the same cases.

    Attributes:
        cases: how many; gained: right with the first tool alone; lost: right with the second alone.
    """

    cases: int
    gained: int
    lost: int

    @property
    def share(self) -> float:
        """Share of right answers of the first less that of the second; NaN without cases."""
        return (self.gained - self.lost) / self.cases if self.cases else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Exact 95 % interval, see `studies.benchmark.paired`."""
        return paired_interval(self.cases, self.gained, self.lost)


def difference(first: Sequence[Score], second: Sequence[Score]) -> Difference:
    """Compare two tools, case by case.

    Raises:
        ValueError: they answered other cases.
    """
    pairs = [(a.right, b.right) for a, b in zip(first, second, strict=True) if a.case == b.case]
    if len(pairs) != len(first):
        raise ValueError("the scores are of different cases")
    return Difference(len(pairs), sum(a and not b for a, b in pairs), sum(b and not a for a, b in pairs))


def summary(scores: Sequence[Score]) -> dict[str, float]:
    """The figures of a tool, by label; shares from 0 to 1."""
    concealing = [s for s in scores if s.group != "none"]
    named = listed(scores)
    modelled = [s for s in scores if s.group in ("outside", "background")]
    return {
        "cases": len(scores),
        "without an answer": sum(s.failed for s in scores),
        "balanced accuracy of claims": balanced_accuracy(scores),
        "names claimed rightly (same, other, pair)": _mean(s.right for s in named),
        "names first in probability (same, other, pair)": _mean(s.first for s in named),
        "location right": _mean(s.placed for s in concealing),
        "location among three": _mean(s.placed_within for s in concealing),
        "false alarms": _mean(s.false_alarm for s in scores if s.group == "none"),
        "calibration error": calibration_error(scores),
        "Brier score": _mean(s.brier for s in scores),
        "prediction error / noise, median": _median(s.error for s in scores),
        "prediction error / noise in `outside` and `background`, median": _median(s.error for s in modelled),
        "processor seconds a case, median": _median(s.seconds for s in scores),
    }


def by_group(scores: Sequence[Score]) -> pd.DataFrame:
    """A row for each group, and of what conceals something for each strength and set of recordings: cases, rightly
    claimed, with the exact 95 % interval."""
    concealing, rows = [s for s in scores if s.group != "none"], []
    wanted = [("group", g, scores) for g in GROUPS]
    wanted += [("strength", x, concealing) for x in STRENGTHS] + [("recordings", x, concealing) for x in PLANS]
    for what, value, among in wanted:
        chosen = [s for s in among if value in (s.group, s.strength, s.plan)]
        if chosen:
            found = Rate(value, sum(s.right for s in chosen), len(chosen), "")
            rows.append((what, value, found.cases, found.hits, found.share, *found.interval))
    return pd.DataFrame(rows, columns=["of", "value", "cases", "right", "share", "low", "high"])


def _mean(values: Iterable[float]) -> float:
    found = list(values)
    return float(np.mean(found)) if found else float("nan")


def _median(values: Iterable[float]) -> float:
    found = list(values)
    return float(np.median(found)) if found else float("nan")
