"""Stepwise selection by Schwarz's criterion as a tool: the same catalogue, the same fits, no tests.

Every effect that can exist is added to the base model and refitted from the points of its grid. The one with the least

    BIC = χ² + k ln N

stays if it lowers the criterion, and the search goes on, up to three effects (Schwarz 1978, Annals of Statistics 6).
The models of a step get the weights ``exp(−ΔBIC/2)`` (Burnham & Anderson 2002, Sec. 6.4), which are the probabilities
of their names. There is no learned element, no held-out recording and no place but that of the name.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from phnn.diagnosis.diagnosis import available
from phnn.diagnosis.linearised_fit import prepare
from phnn.effects import Effect
from phnn.identification.fit import Fit
from phnn.model import Model
from phnn.recordings import Campaign
from studies.benchmark.answer import Answer
from studies.benchmark.tools.common import base_of, bic, places_of, predictions, refitted, tried

# Effects at most; tries that are refitted.
_MOST, _REFITTED = 3, 4


def answer(folder: Path, seed: int) -> Answer:
    """Add effects as long as the criterion falls."""
    base = base_of(folder, seed)
    current, taken, none = base.fit, list[str](), 0.0
    names: dict[str, float] = {}
    for step in range(_MOST):
        found = _step(current, base.campaign, taken)
        without, *weights = _weights([bic(current), *(bic(f) for _, f in found)])
        none = without if step == 0 else none
        for (effect, _), weight in zip(found, weights, strict=True):
            names[effect.canonical] = max(names.get(effect.canonical, 0.0), weight)
        if not found or without >= max(weights):
            break
        effect, current = min(found, key=lambda pair: bic(pair[1]))
        taken.append(effect.canonical)
    model = Model(current.setup, current.plan.finest)
    return Answer(names, none, places=places_of(names), predictions=predictions(model, folder))


def _weights(values: Sequence[float]) -> list[float]:
    """Weights of models by their criteria; they add up to one."""
    relative = np.exp(-0.5 * (np.array(values) - min(values)))
    return [float(w) for w in relative / relative.sum()]


def _step(current: Fit, campaign: Campaign, taken: Sequence[str]) -> list[tuple[Effect, Fit]]:
    """The best refit of each effect: all are tried briefly, the best are refitted."""
    scales = prepare(current).scales
    best: dict[str, tuple[Effect, Fit]] = {}
    for effect in available(campaign, current.setup):
        name = effect.canonical
        found = tried(current, effect, scales) if name not in taken else None
        if found is not None and (name not in best or bic(found) < bic(best[name][1])):
            best[name] = effect, found
    ordered = sorted(best.values(), key=lambda pair: bic(pair[1]))
    return [(e, refitted(current, f)) for e, f in ordered[:_REFITTED]] + ordered[_REFITTED:]
