"""Probabilities of what is missing from the features of a base model.

Each name, ``none`` and ``unlisted`` is a label of its own, so that two effects of a pair can both be probable. A forest
of extremely randomised trees (Geurts, Ernst & Wehenkel 2006, Machine Learning 63) votes on all labels at once. Its
shares of votes are drawn towards the middle; Platt's scaling (1999) of their logits, fitted to votes on cases that were
held out, makes probabilities of them.

Chosen by cross-validation on 287 to 319 cases of training: this forest had a Brier score of 0.59 and the true labels
first in 62 %; the same with one label a row and weights for pairs 0.59 and 61 %; a random forest 0.64 and 59 %;
histogram gradient boosting (40 rounds, six leaves, one label a row) 0.67 and 54 %, as it needs more cases. The share of
features at a split and the number of trees were not tuned.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from phnn.errors import InputRefused
from studies.benchmark.answer import NONE, UNLISTED
from studies.benchmark.fingerprints.features import names
from studies.generator.effects import LISTED
from studies.rivals import needed

Array = NDArray[np.float64]

LABELS = (*LISTED, NONE, UNLISTED)
FOLDS = 5
_LEAST = 1e-3  # share of votes below which a label counts as not voted for
_TREES, _SHARE, _LEAF = 500, 0.3, 1
_NEIGHBOURS = 5


@dataclass(frozen=True, eq=False)
class Classifier:
    """Attributes:
    votes: features (N, F) to shares of votes (N, L) in the order of `LABELS`.
    slope, offset: of Platt's scaling.
    """

    votes: Callable[[Array], Array]
    slope: float
    offset: float

    def probabilities(self, found: Mapping[str, float]) -> dict[str, float]:
        """Probability of each label from the features of one case."""
        row = np.array([[found[name] for name in names()]])
        values = scaled(self.votes(row), self.slope, self.offset)[0]
        return {name: float(p) for name, p in zip(LABELS, values, strict=True)}


def labels(table: pd.DataFrame) -> NDArray[np.bool_]:
    """(N, L) which labels are true; physics of a background is no label."""
    found = np.zeros((len(table), len(LABELS)), dtype=bool)
    for i, (group, effects) in enumerate(zip(table["group"], table["effects"], strict=True)):
        true = {"none": [NONE], "outside": [UNLISTED]}.get(group) or effects.split("+")
        found[i, [LABELS.index(name) for name in true]] = True
    return found


def trained(table: pd.DataFrame, kind: str, seed: int) -> Classifier:
    """Fit a classifier to a table.

    Args:
        kind: one of `KINDS`; seed: of its draws.

    Raises:
        InputRefused: fewer cases than folds, or scikit-learn is not installed.
    """
    x, y = table[names()].to_numpy(dtype=np.float64), labels(table)
    held_out = crossed(x, y, table["number"].to_numpy(), kind, seed)
    slope, offset = platt(held_out, y)
    return Classifier(KINDS[kind](x, y, seed), slope, offset)


def crossed(x: Array, y: NDArray[np.bool_], groups: NDArray[Any], kind: str, seed: int) -> Array:
    """(N, L) votes on each row by a classifier that saw no row of the same group."""
    if np.unique(groups).size < FOLDS:
        raise InputRefused(f"a training needs {FOLDS} cases at least: train with a larger size")
    chosen = needed("sklearn.model_selection").GroupKFold(FOLDS, shuffle=True, random_state=seed)
    votes = np.zeros(y.shape)
    for inside, outside in chosen.split(x, groups=groups):
        votes[outside] = KINDS[kind](x[inside], y[inside], seed)(x[outside])
    return votes


def scaled(votes: Array, slope: float, offset: float) -> Array:
    """Platt's scaling of shares of votes."""
    clipped = np.clip(votes, _LEAST, 1.0 - _LEAST)
    return np.asarray(1.0 / (1.0 + np.exp(-(slope * np.log(clipped / (1.0 - clipped)) + offset))))


def platt(votes: Array, y: NDArray[np.bool_]) -> tuple[float, float]:
    """Slope and offset that make votes the most likely probabilities, for all labels alike."""
    clipped = np.clip(votes, _LEAST, 1.0 - _LEAST)
    logit = np.log(clipped / (1.0 - clipped)).reshape(-1, 1)
    fitted = needed("sklearn.linear_model").LogisticRegression(C=1e6).fit(logit, y.ravel())
    return float(fitted.coef_[0, 0]), float(fitted.intercept_[0])


def _trees(x: Array, y: NDArray[np.bool_], seed: int) -> Callable[[Array], Array]:
    made = needed("sklearn.ensemble").ExtraTreesClassifier(
        _TREES, max_features=_SHARE, min_samples_leaf=_LEAF, random_state=seed, n_jobs=1
    )
    made.fit(x, y)
    return lambda rows: np.column_stack([_second(p) for p in made.predict_proba(rows)])


def _second(p: Array) -> Array:
    """Probability of True where a label has two values in the training; 0 where it is never true."""
    return p[:, 1] if p.shape[1] > 1 else np.zeros(p.shape[0])


def _nearest(x: Array, y: NDArray[np.bool_], seed: int) -> Callable[[Array], Array]:
    """The nearest fingerprints, in features whose middle half is scaled to one; the votes fall with the distance."""
    x = np.where(np.isnan(x).all(axis=0), 0.0, x)  # a feature of recordings that nobody made
    middle, spread = np.nanmedian(x, axis=0), np.subtract(*np.nanquantile(x, (0.75, 0.25), axis=0))

    def prepared(rows: Array) -> Array:
        z = np.clip((rows - middle) / np.where(spread > 0.0, spread, 1.0), -3.0, 3.0)
        return np.where(np.isnan(z), 0.0, z)

    metric = {"weights": "distance", "metric": "manhattan"}
    made = needed("sklearn.neighbors").KNeighborsRegressor(min(_NEIGHBOURS, len(x)), **metric)
    made.fit(prepared(x), y.astype(float))
    return lambda rows: np.asarray(made.predict(prepared(rows)))


Fitter = Callable[[Array, NDArray[np.bool_], int], Callable[[Array], Array]]
KINDS: dict[str, Fitter] = {"trees": _trees, "nearest": _nearest}
