"""Stepwise selection by Schwarz's criterion as a tool: the same catalogue, the same fits, no tests.

Every effect that can exist is added to the base model and refitted from the points of its grid. The one with the least

    BIC = χ² + k ln N

stays if it lowers the criterion, and the search goes on, up to three effects (Schwarz 1978, Annals of Statistics 6).
The models of a step get the weights ``exp(−ΔBIC/2)`` (Burnham & Anderson 2002, Sec. 6.4), which are the probabilities
of their names. There is no learned element, no held-out recording and no place but that of the name.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from phnn.diagnosis.diagnosis import available
from phnn.diagnosis.linearised_fit import prepare
from phnn.diagnosis.starts import clamped
from phnn.effects import Effect, Scales, catalogue
from phnn.errors import PhnnError
from phnn.identification.fit import Fit, fit
from phnn.model import Model
from phnn.recordings import Campaign
from phnn.studies.benchmark.answer import Answer
from phnn.studies.benchmark.tools.common import base_of, predictions

# Effects at most; points of a grid; simulations of a first try and of a refit; tries that are refitted.
_MOST, _POINTS, _TRY, _REFIT, _REFITTED = 3, 3, 6, 30, 4
# Places that are stated at most.
_PLACES = 3


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
    return Answer(names, none, places=_places(names), predictions=predictions(model, folder))


def _places(names: Mapping[str, float]) -> tuple[str, ...]:
    """Locations by the sum of the probabilities of their effects, the most probable first; three at most."""
    known, sums = catalogue(), Counter[str]()
    for name, probability in names.items():
        sums[known[name].location] += probability  # type: ignore[assignment]
    return tuple(place for place, _ in sums.most_common(_PLACES))


def bic(fitted: Fit) -> float:
    """Schwarz's criterion; residuals are in units of the noise."""
    return fitted.cost + fitted.z.size * math.log(fitted.residual.size)


def _weights(values: Sequence[float]) -> list[float]:
    """Weights of models by their criteria; they add up to one."""
    relative = np.exp(-0.5 * (np.array(values) - min(values)))
    return [float(w) for w in relative / relative.sum()]


def _step(current: Fit, campaign: Campaign, taken: Sequence[str]) -> list[tuple[Effect, Fit]]:
    """The best refit of each effect: all are tried briefly, the best are refitted."""
    scales = prepare(current).scales
    tried: dict[str, tuple[Effect, Fit]] = {}
    for effect in available(campaign, current.setup):
        name = effect.canonical
        found = _tried(current, effect, scales) if name not in taken else None
        if found is not None and (name not in tried or bic(found) < bic(tried[name][1])):
            tried[name] = effect, found
    ordered = sorted(tried.values(), key=lambda pair: bic(pair[1]))
    return [(e, _refitted(current, f)) for e, f in ordered[:_REFITTED]] + ordered[_REFITTED:]


def _tried(current: Fit, effect: Effect, scales: Scales) -> Fit | None:
    """A few iterations from the points of the grid; None where none can be simulated."""
    ends = []
    for point in effect.grid(scales)[:_POINTS]:
        try:
            begun = clamped(effect, current.setup, point)
            own = [n for n in effect.parameters if not begun.parameters[n].fixed]
            names = [*current.variables.names, *own]
            ends.append(fit(begun, current.plan, names, current.held, _TRY, origin=current))
        except PhnnError:
            continue
    return min(ends, key=bic, default=None)


def _refitted(current: Fit, found: Fit) -> Fit:
    try:
        return fit(found.setup, current.plan, found.variables.names, current.held, _REFIT, origin=found)
    except PhnnError:
        return found
