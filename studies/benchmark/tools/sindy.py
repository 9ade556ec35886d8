"""SINDy on the residual force as a tool.

A sparse combination of candidate terms is to be the force that the base model lacks (Brunton, Proctor & Kutz 2016,
PNAS 113), in the integral form that no noise spoils (`studies.benchmark.residual_force.evidence`). Two optimisers
of pysindy propose supports: sequentially thresholded least squares over a grid of thresholds, and forward regression by
orthogonal least squares (Billings 2013, Nonlinear System Identification, ch. 3). Blocks of time that are drawn with
replacement give an ensemble (Fasel, Kutz, Brunton & Brunton 2022, Proc. R. Soc. A 478): of each draw, the supports are
compared on the blocks that it lacks, and the one with the fewest effects stays that gains nearly as much as any.
The probability of an effect is the mean of two: whether all blocks select it, and the share of the draws that do.

Settings were tuned on twelve cases of the benchmark with seed 902, and on two cubic springs. With the least error of
prediction alone, thresholding kept 10 to 40 terms where an effect is strong and its law is a little off. The first term
of forward regression was right in six of the eight cases with one effect; stepwise elimination (pysindy's SSR) chose
alike and was left out. With the share of draws alone, a cubic spring that all blocks show clearly
has a half: few blocks are drawn from few recordings.
"""

from __future__ import annotations

import contextlib
import warnings
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from studies.benchmark.answer import Answer
from studies.benchmark.residual_force.compressed import Compressed, compressed
from studies.benchmark.residual_force.evidence import Evidence, evidence_of, force_of
from studies.benchmark.residual_force.naming import EXPLAINED, Weighed, answer_of
from studies.benchmark.residual_force.prediction import alone, forced
from studies.benchmark.residual_force.states import States
from studies.benchmark.tools.common import base_of
from studies.rivals import needed

Array = NDArray[np.float64]
Support = tuple[int, ...]

# Draws of the ensemble; thresholds, from the first to the last one of these shares of the target's length, but at least
# so many standard deviations of a coefficient; the ridge; terms of a forward regression.
_DRAWS, _THRESHOLDS, _FIRST, _LAST, _DEVIATIONS, _RIDGE, _FORWARD = 30, 8, 0.05, 0.9, 4.0, 1e-3, 6
# Share of the best gain that a support with fewer effects may have; gain [units of χ²] below which there is none.
NEARLY, CHANCE = 0.9, 30.0
# Weight of what all blocks select beside the draws.
_WHOLE = 0.5


def answer(folder: Path, seed: int) -> Answer:
    """Select terms, and predict with them."""
    needed("pysindy")
    base = base_of(folder, seed)
    evidence = evidence_of(base.fit)
    weighed, support = selected(evidence, seed)
    # Terms that leave most of the residual are no law to predict by.
    lawful = support and weighed.explained >= EXPLAINED
    model = forced(base.fit, Sparse(evidence, support)) if lawful else alone(base.fit)
    return answer_of(weighed, model, folder)


class Sparse:
    """The law of some terms with the coefficients that fit the recordings."""

    def __init__(self, evidence: Evidence, support: Support) -> None:
        chosen = list(support)
        columns = np.column_stack([evidence.base, evidence.columns[:, chosen]])
        found = np.linalg.lstsq(columns, evidence.target, rcond=1e-9)[0][evidence.base.shape[1] :]
        self.terms = [evidence.terms[k] for k in chosen]
        self.coefficients = found / evidence.lengths[chosen]

    def __call__(self, s: States) -> tuple[Array, Array]:
        """(N,) force [N] and change of the output [m]."""
        force, output = np.zeros(s.q.size), np.zeros(s.q.size)
        for term, coefficient in zip(self.terms, self.coefficients, strict=True):
            action = term.action(s)
            force += coefficient * force_of(s, action)
            output += coefficient * (0.0 if action.output is None else action.output)
        return force, output


def selected(evidence: Evidence, seed: int) -> tuple[Weighed, Support]:
    """What an ensemble selects, and the support that all blocks select."""
    small = compressed(evidence)
    effects = [t.effect for t in evidence.terms]
    every = list(range(len(small.factors)))
    without = small.validated(np.zeros(0, dtype=int))
    scored = {s: float(np.sum(without - small.validated(np.array(s)))) for s in _supports(small, every)}
    support = _fewest(scored, effects)
    gain = scored.get(support, 0.0)
    excess = float(without.sum()) - sum(small.counts)
    explained = gain / excess if excess > 0.0 else 0.0
    rng, found = np.random.default_rng(seed), Counter[str]()
    for _ in range(_DRAWS if support else 0):
        drawn = rng.integers(len(every), size=len(every)).tolist()
        tested = [k for k in every if k not in drawn]
        if tested:
            found.update({effects[k] for k in _of_draw(small, drawn, tested, effects)})
    chosen = {effects[k] for k in support}
    frequencies = {
        name: _WHOLE * (name in chosen) + (1.0 - _WHOLE) * found[name] / _DRAWS for name in chosen | set(found)
    }
    return Weighed(bool(support) or explained_by_none(without, small), frequencies, min(1.0, explained)), support


def explained_by_none(without: Array, small: Compressed) -> bool:
    """Whether the base leaves more than noise that no candidate predicts."""
    return float(without.sum()) > 1.5 * sum(small.counts)


def _of_draw(small: Compressed, drawn: Sequence[int], tested: Sequence[int], effects: Sequence[str]) -> Support:
    """The support that a draw of blocks selects by the blocks that it lacks."""
    alone = small.left_out(np.zeros(0, dtype=int), drawn, tested)
    scored = {s: alone - small.left_out(np.array(s), drawn, tested) for s in _supports(small, drawn)}
    return _fewest(scored, effects)


def _fewest(scored: dict[Support, float], effects: Sequence[str]) -> Support:
    """Of the supports that gain nearly as much as the best, that with the fewest effects, then terms; empty where none
    gains more than chance would."""
    best = max(scored.values(), default=0.0)
    if best < CHANCE:
        return ()
    near = [s for s, gain in scored.items() if gain >= NEARLY * best]
    return min(near, key=lambda s: (len({effects[k] for k in s}), len(s), -scored[s]))


def _supports(small: Compressed, blocks: Sequence[int]) -> set[Support]:
    """What the two optimisers propose for some blocks."""
    sindy = needed("pysindy")
    x, y = small.problem(blocks)
    lengths = np.linalg.norm(x, axis=0)
    # What the base takes up in these blocks is no candidate there.
    usable = np.flatnonzero(lengths > 1e-3 * np.median(lengths))
    x, found = x[:, usable] / lengths[usable], set[Support]()
    size = float(np.linalg.norm(y))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for threshold in np.geomspace(max(_DEVIATIONS, _FIRST * size), _LAST * size, _THRESHOLDS):
            thresholded = sindy.STLSQ(threshold=float(threshold), alpha=_RIDGE, max_iter=30).fit(x, y[:, None])
            found.add(tuple(usable[np.flatnonzero(thresholded.coef_[0])].tolist()))
        # It refuses problems whose columns depend on each other, as those of a few drawn blocks may.
        with contextlib.suppress(ValueError):
            forward = sindy.FROLS(max_iter=_FORWARD).fit(x, y[:, None])
            found |= {tuple(usable[np.flatnonzero(np.ravel(h))].tolist()) for h in forward.history_}
    return {s for s in found if s}
