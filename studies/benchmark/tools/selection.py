"""Selection of effects by sparse regression, as a tool.

It takes the catalogue of phnn and its base model. It has no learned element, no held-out recording and no location but
that of the name.
"""

from __future__ import annotations

import contextlib
import itertools
import warnings
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky

from phnn.diagnose.diagnosis import available
from phnn.diagnose.linearised import LinearisedFit, prepare
from phnn.errors import PhnnError
from studies.benchmark.bench import Answer
from studies.benchmark.tools.common import base_of, fitted_with, library, places_of, predictions
from studies.rival_models.names import needed

Array = NDArray[np.float64]
Support = tuple[int, ...]
# Blocks that estimate coefficients, and blocks that judge them.
Fold = tuple[Sequence[int], Sequence[int]]

# SINDy: blocks of a recording at most, and their fewest samples; folds; draws of the ensemble; thresholds, between
# these shares of the target's length, but at least so many standard deviations; the ridge; terms of a forward
# regression.
_BLOCKS, _SAMPLES, _FOLDS, _DRAWS, _THRESHOLDS, _FIRST, _LAST, _DEVIATIONS, _RIDGE, _FORWARD = (
    6, 250, 5, 30, 8, 0.05, 0.9, 4.0, 1e-3, 6,
)  # fmt: skip
# Share of the best gain that a support with fewer effects may have; gain [units of χ²] below which there is none; χ²
# over the number of samples above which the base leaves more than noise.
_NEARLY, _CHANCE, _NOISE = 0.9, 30.0, 1.5
# The most that is believed of anything, and the least; share of the excess that terms have to explain to be trusted.
_BELIEVED, _LEAST, _EXPLAINED = 0.9, 0.05, 0.5


def sindy(folder: Path, seed: int) -> Answer:
    """Combine a sparse set of the catalogue's responses so that they are what the base model leaves.

    SINDy (Brunton, Proctor & Kutz 2016, PNAS 113) in the integral form that no noise spoils (Schaeffer & McCalla 2017,
    Phys. Rev. E 96): terms are compared through the response of the linearised base model. Two optimisers of pysindy
    propose supports: sequentially thresholded least squares over a grid of thresholds, and forward regression by
    orthogonal least squares. Blocks of time that are drawn with replacement give an ensemble (Fasel, Kutz, Brunton &
    Brunton 2022, Proc. R. Soc. A 478): of each draw, the support with the fewest effects stays that gains nearly as
    much as any in the blocks that were not drawn. The probability of an effect is the mean of two: whether all blocks
    select it, and the share of the draws that do.
    """
    needed("pysindy")
    base = base_of(folder, seed)
    linearised = prepare(base.fit)
    candidates, columns = library(linearised, available(base.campaign, base.fit.setup))
    effects = [c.effect.canonical for c in candidates]
    grams, sizes = _grams(linearised, columns)
    every = list(range(len(grams)))
    # Folds of blocks in turn: none is judged by what estimated it.
    folds = [([k for k in every if k % _FOLDS != f], every[f::_FOLDS]) for f in range(min(_FOLDS, len(grams)))]
    support = _fewest(grams, every, folds, effects)
    excess = float(sum(g[-1, -1] for g in grams)) - linearised.residual.size
    gain = _gain(grams, folds, support)
    drawn, rng = Counter[str](), np.random.default_rng(seed)
    for _ in range(_DRAWS if support else 0):
        taken = rng.integers(len(grams), size=len(grams)).tolist()
        tested = [k for k in every if k not in taken]
        if tested:
            drawn.update({effects[k] for k in _fewest(grams, taken, [(taken, tested)], effects)})
    chosen = {effects[k] for k in support}
    share = {n: 0.5 * (n in chosen) + 0.5 * drawn[n] / _DRAWS for n in chosen | set(drawn)}
    if not support and excess + linearised.residual.size <= _NOISE * linearised.residual.size:
        return Answer({}, none=_BELIEVED, unlisted=_LEAST, predictions=predictions(base.fit, folder))
    explained = min(1.0, gain / excess) if excess > 0.0 else 0.0
    trusted = explained >= _EXPLAINED
    names = {n: (_BELIEVED if trusted else _BELIEVED * explained) * p for n, p in share.items()}
    unlisted = _LEAST if trusted else max(_LEAST, _BELIEVED * (1.0 - explained))
    fitted = base.fit
    for k in support if trusted else ():
        values = candidates[k].scaled(float(_coefficients(grams, every, support)[support.index(k)] / sizes[k]))
        if candidates[k].effect.can_be_added_to(fitted.setup):
            with contextlib.suppress(PhnnError):
                fitted = fitted_with(fitted, candidates[k].effect, values)
    return Answer(names, _LEAST, unlisted, places_of(names), predictions(fitted, folder))


def _grams(linearised: LinearisedFit, columns: Array) -> tuple[list[Array], Array]:
    """Return the products of ``[columns, residual]`` in each block of time, and the lengths of the columns before.

    What base parameters could explain themselves is projected out.
    """
    projected = linearised.project(columns)
    sizes = np.maximum(np.linalg.norm(projected, axis=0), 1e-6 * np.linalg.norm(columns, axis=0))
    rows, grams = np.column_stack([projected / sizes, linearised.residual]), []
    for part in linearised.slices:
        count = min(_BLOCKS, max(1, (part.stop - part.start) // _SAMPLES))
        edges = np.linspace(part.start, part.stop, count + 1).astype(int).tolist()
        grams += [rows[a:b].T @ rows[a:b] for a, b in itertools.pairwise(edges)]
    return grams, sizes


def _coefficients(grams: Sequence[Array], blocks: Iterable[int], support: Support) -> Array:
    total = sum((grams[k] for k in blocks), start=np.zeros_like(grams[0]))
    chosen = list(support)
    return np.asarray(np.linalg.solve(total[np.ix_(chosen, chosen)] + 1e-9 * np.eye(len(chosen)), total[chosen, -1]))


def _gain(grams: Sequence[Array], folds: Sequence[Fold], support: Support) -> float:
    """Return by how much χ² falls in the tested blocks where the taken ones have estimated the coefficients."""
    chosen, total = list(support), 0.0
    for taken, tested in folds:
        beta = _coefficients(grams, taken, support)
        held = sum((grams[k] for k in tested), start=np.zeros_like(grams[0]))
        total += float(2.0 * beta @ held[chosen, -1] - beta @ held[np.ix_(chosen, chosen)] @ beta)
    return total


def _fewest(grams: Sequence[Array], blocks: Sequence[int], folds: Sequence[Fold], effects: Sequence[str]) -> Support:
    """Return, of the supports that some blocks propose and that gain nearly as much as the best in left-out blocks,
    that with the fewest effects, then terms; empty where none gains more than chance would."""
    gains = {s: _gain(grams, folds, s) for s in _supports(grams, blocks)}
    best = max(gains.values(), default=0.0)
    near = [s for s, gain in gains.items() if gain >= _NEARLY * best] if best >= _CHANCE else []
    return min(near, key=lambda s: (len({effects[k] for k in s}), len(s), -gains[s]), default=())


def _supports(grams: Sequence[Array], blocks: Sequence[int]) -> set[Support]:
    """Return what the two optimisers propose for some blocks."""
    pysindy = needed("pysindy")
    total = sum((grams[k] for k in blocks), start=np.zeros_like(grams[0]))
    sizes = np.sqrt(np.diag(total))
    usable = np.flatnonzero(sizes[:-1] > 1e-3 * np.median(sizes[:-1]))
    kept = np.append(usable, sizes.size - 1)
    scale = np.append(sizes[usable], 1.0)
    gram = total[np.ix_(kept, kept)] / np.outer(scale, scale)
    # The factor of the products is a least-squares problem of few rows with the same solutions.
    factor = cholesky(gram + np.diag(np.append(np.full(usable.size, 1e-9), 1e-9 * gram[-1, -1])))
    x, y, proposed = factor[:-1, :-1], factor[:-1, -1:], set[Support]()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        size = float(np.linalg.norm(y))
        for threshold in np.geomspace(max(_DEVIATIONS, _FIRST * size), max(_DEVIATIONS, _LAST * size), _THRESHOLDS):
            model = pysindy.STLSQ(threshold=float(threshold), alpha=_RIDGE, max_iter=30).fit(x, y)
            proposed.add(tuple(usable[np.flatnonzero(model.coef_[0])].tolist()))
        # It refuses problems whose columns depend on each other, as those of a few drawn blocks may.
        with contextlib.suppress(ValueError):
            forward = pysindy.FROLS(max_iter=_FORWARD).fit(x, y)
            proposed |= {tuple(usable[np.flatnonzero(np.ravel(h))].tolist()) for h in forward.history_}
    return {s for s in proposed if s}
