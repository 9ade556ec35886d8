"""A Gaussian process as the residual force, as a tool.

The force is a process over signals of the base model (Álvarez, Luengo & Lawrence 2009, AISTATS; see
`studies.benchmark.residual_force.latent`), because a force in time alone predicts no other recording. Of several
sets of signals, the one of largest marginal likelihood is taken. Where no such process explains most of the residual,
because the force has a memory of its own, the force in time is what is compared with the table, and the base model
predicts alone.

A process has no names. The response to its mean is decomposed into responses to the terms of the table, forward, and
again for blocks of time that are drawn with replacement. What two effects do not explain together is not listed.

Settings were tuned on twelve cases of the benchmark with seed 902: 40 inducing points and two length scales were enough
(the marginal likelihoods of nulls fell short of no force, those of weak effects exceeded it by hundreds); the rules
that turn shares into claims were set on the same cases.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from studies.benchmark.answer import Answer
from studies.benchmark.residual_force.compressed import Compressed, compressed
from studies.benchmark.residual_force.evidence import Evidence, evidence_of
from studies.benchmark.residual_force.latent import Posterior, mean_of, posteriors
from studies.benchmark.residual_force.matching import named, shares
from studies.benchmark.residual_force.naming import EXPLAINED, Weighed, answer_of
from studies.benchmark.residual_force.prediction import alone, forced
from studies.benchmark.tools.common import base_of
from studies.rivals import needed

Array = NDArray[np.float64]

# Logarithm of the odds of a force against none that eighteen tries ask for; residual over noise, squared, that is no
# noise whatever explains it; draws; weight of all blocks beside the draws.
_ODDS, _NO_NOISE, _DRAWS, _WHOLE = 8.0, 1.5, 20, 0.5
# Share of the excess that the process has to explain for its force to be compared, rather than the force in time.
_BY_STATES = 0.8


def answer(folder: Path, seed: int) -> Answer:
    """Infer the force, compare it with the table, and predict with it."""
    needed("sklearn")
    base = base_of(folder, seed)
    evidence = evidence_of(base.fit)
    best = posteriors(evidence, seed)[0]
    found, lawful = weighed(evidence, best, seed)
    model = forced(base.fit, best) if lawful and best.evidence > _ODDS else alone(base.fit)
    return answer_of(found, model, folder)


def weighed(evidence: Evidence, best: Posterior, seed: int) -> tuple[Weighed, bool]:
    """Shares of the effects, turned into frequencies, and whether the process explains most of the residual."""
    small = compressed(evidence, np.column_stack([best.seen, evidence.columns]))
    every = list(range(len(small.factors)))
    effects = tuple(t.effect for t in evidence.terms)
    _, y = small.problem(every)
    if best.evidence < _ODDS and float(y @ y) < _NO_NOISE * sum(small.counts):
        return Weighed(False, {}, 0.0), False
    whole = _compared(small, every, best, effects)
    rng, found = np.random.default_rng(seed), Counter[str]()
    for _ in range(_DRAWS):
        found.update(_compared(small, rng.integers(len(every), size=len(every)).tolist(), best, effects).names)
    names = whole.names | set(found)
    frequencies = {n: _WHOLE * (n in whole.names) + (1.0 - _WHOLE) * found[n] / _DRAWS for n in names}
    return Weighed(True, frequencies, whole.explained), whole.lawful


class _Compared(NamedTuple):
    """Attributes:
    names: of the one or two effects that a force resembles most; lawful: the process explains most of the residual.
    explained: share of the force, scaled to what `studies.benchmark.residual_force.naming.EXPLAINED` asks.
    """

    names: frozenset[str]
    explained: float
    lawful: bool


def _compared(small: Compressed, blocks: list[int], best: Posterior, effects: tuple[str, ...]) -> _Compared:
    x, y = small.problem(blocks)
    count = sum(small.counts[k] for k in blocks)
    seen, columns = x[:, : best.mean.size], x[:, best.mean.size :]
    response = seen @ mean_of(seen, y, best.variance)
    excess = max(float(y @ y) - count, 1e-9)
    lawful = float(y @ y - (y - response) @ (y - response)) >= _BY_STATES * excess
    wanted, total = (response, float(response @ response)) if lawful else (y, excess)
    names, share = named(shares(columns, wanted, effects, total))
    return _Compared(names, min(1.0, EXPLAINED * share), lawful)
