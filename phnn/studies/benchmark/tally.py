"""Figures over the scores of a tool."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd

from phnn.studies.benchmark.score import Score
from phnn.studies.benchmark.settings import GROUPS
from phnn.studies.proof.tally import Rate

# Equal bins of probability for the calibration error.
_BINS = 10


def rate(label: str, scores: Iterable[Score], hits: Iterable[bool]) -> Rate:
    """A share with its exact interval."""
    found = list(hits)
    return Rate(label, sum(found), len(list(scores)), "")


def balanced_accuracy(scores: Sequence[Score]) -> float:
    """Mean over the kinds of truth of the share that is right; NaN without cases."""
    kinds: dict[str, list[bool]] = {}
    for s in scores:
        kinds.setdefault(s.kind, []).append(s.right)
    return float(np.mean([np.mean(found) for found in kinds.values()])) if kinds else float("nan")


def calibration_error(scores: Iterable[Score]) -> float:
    """Expected calibration error of all stated probabilities: mean distance of probability and frequency in ten bins,
    weighted by their numbers (Naeini, Cooper & Hauskrecht 2015). NaN where nothing was stated."""
    stated = np.array([statement for s in scores for statement in s.statements], dtype=float).reshape(-1, 2)
    if not stated.size:
        return float("nan")
    bins = np.minimum((_BINS * stated[:, 0]).astype(int), _BINS - 1)
    distances = [abs(float(np.sum(stated[bins == b, 0] - stated[bins == b, 1]))) for b in np.unique(bins)]
    return float(sum(distances) / len(stated))


def summary(scores: Sequence[Score]) -> dict[str, float]:
    """The figures of a tool, by label; shares from 0 to 1."""
    concealing = [s for s in scores if s.group != "none"]
    listed = [s for s in scores if s.group in ("same", "other", "pair")]
    errors = [s.error for s in scores if np.isfinite(s.error)]
    modelled = [s.error for s in scores if s.group in ("outside", "background") and np.isfinite(s.error)]
    return {
        "cases": float(len(scores)),
        "balanced accuracy": balanced_accuracy(scores),
        "names right (same, other, pair)": _share(s.right for s in listed),
        "place right": _share(s.placed for s in concealing),
        "place among three": _share(s.placed_within for s in concealing),
        "false alarms": _share(s.false_alarm for s in scores if s.group == "none"),
        "calibration error": calibration_error(scores),
        "prediction error / noise, median": float(np.median(errors)) if errors else float("nan"),
        "the same, outside and background": float(np.median(modelled)) if modelled else float("nan"),
        "predicted": float(len(errors)),
        "processor seconds a case, median": float(np.median([s.seconds for s in scores])) if scores else float("nan"),
    }


def by_group(scores: Sequence[Score]) -> pd.DataFrame:
    """A row for each group, strength and plan: cases, right, with the exact 95 % interval."""
    rows = []
    for what, values in (("group", GROUPS), ("strength", _of("strength", scores)), ("plan", _of("plan", scores))):
        for value in values:
            chosen = [s for s in scores if getattr(s, what) == value]
            if chosen:
                found = rate(value, chosen, (s.right for s in chosen))
                low, high = found.interval
                rows.append((what, value, found.cases, found.hits, found.share, low, high))
    return pd.DataFrame(rows, columns=["of", "value", "cases", "right", "share", "low", "high"])


def _of(what: str, scores: Sequence[Score]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(getattr(s, what) for s in sorted(scores, key=lambda s: s.case)))


def _share(hits: Iterable[bool]) -> float:
    found = list(hits)
    return float(np.mean(found)) if found else float("nan")
