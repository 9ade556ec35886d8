"""Classifiers on cases of the training that they have not seen, and the gain that more cases would bring.

Cross-validation over cases: all rows of one actuator are held out together. Rows that are parts of another recording
set train, but are not counted. Platt's scaling is fitted to the same held-out votes that are counted; it has two
parameters.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from studies.benchmark.answer import CLAIMED
from studies.benchmark.fingerprints.classifier import FOLDS, KINDS, crossed, labels, platt, scaled
from studies.benchmark.fingerprints.features import names

Array = NDArray[np.float64]

# Shares of the cases that a learning curve is made of.
_SHARES = (0.25, 0.5, 1.0)
_COLUMNS = ("kind", "trained_on", "of", "value", "cases", "right", "first", "brier")


def validated(table: pd.DataFrame, seed: int, kinds: Sequence[str] = tuple(KINDS)) -> pd.DataFrame:
    """Cross-validated figures of each kind of classifier.

    Returns:
        A row for all cases, each group, each set of recordings and each strength: how many cases there are, the share
        in which exactly what is concealed is claimed, the share in which it is the most probable, and the mean Brier
        score. ``trained_on`` is the number of cases of the training; those below the whole are a learning curve.
    """
    numbers = np.random.default_rng(seed).permutation(np.unique(table["number"]))
    rows = []
    for kind in kinds:
        for share in _SHARES:
            chosen = table[table["number"].isin(numbers[: round(share * numbers.size)])]
            if share < 1.0 and chosen["number"].nunique() < FOLDS:
                continue
            figures = _figures(chosen, kind, seed)
            rows += [(kind, chosen["number"].nunique(), *row) for row in figures if share == 1.0 or row[0] == "all"]
    return pd.DataFrame(rows, columns=_COLUMNS)


def _figures(table: pd.DataFrame, kind: str, seed: int) -> list[tuple[str, str, int, float, float, float]]:
    x, y = table[names()].to_numpy(dtype=np.float64), labels(table)
    votes = crossed(x, y, table["number"].to_numpy(), kind, seed)
    stated = scaled(votes, *platt(votes, y))
    whole = (table["variant"] == table["plan"]).to_numpy()
    counted, right = table[whole], ((stated >= CLAIMED) == y).all(axis=1)[whole]
    first, brier = _first(stated, y)[whole], np.sum((stated - y) ** 2, axis=1)[whole]
    found = [("all", "", len(counted), right.mean(), first.mean(), brier.mean())]
    for of in ("group", "plan", "strength"):
        # Nothing has no strength.
        among = counted["group"] != "none" if of == "strength" else np.ones(len(counted), dtype=bool)
        for value in dict.fromkeys(counted[of]):
            rows = (counted[of] == value).to_numpy() & np.asarray(among)
            found.append((of, value, int(rows.sum()), right[rows].mean(), first[rows].mean(), brier[rows].mean()))
    return [(of, value, count, float(r), float(f), float(b)) for of, value, count, r, f, b in found]


def _first(stated: Array, y: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether the true labels are the most probable ones."""
    least = np.where(y, stated, np.inf).min(axis=1)
    return np.asarray(least > np.where(y, -np.inf, stated).max(axis=1))
