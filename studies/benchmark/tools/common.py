"""Common parts of the tools that start from the base model."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phnn.diagnosis.starts import clamped
from phnn.effects import Effect, Scales, catalogue
from phnn.errors import PhnnError
from phnn.identification.fit import Fit, fit
from phnn.identification.identified import Identified, identify
from phnn.identification.options import Options
from phnn.model import Model
from phnn.predictor import of_network
from phnn.recordings import Campaign, Part, read

Array = NDArray[np.float64]

# Starting points of the base model's fit.
_STARTS = 4
# Points of an effect's grid that are tried; simulations of a try and of a refit.
_POINTS, _TRY, _REFIT = 3, 6, 30
# Places that are stated at most.
_PLACES = 3


def base_of(folder: Path, seed: int, everything: bool = False) -> Identified:
    """The base model of a case, identified from the samples for identification.

    Args:
        everything: use all samples of all recordings; else some are held out, as ``phnn diagnose`` does it.
    """
    campaign = read(folder)
    return identify(None, whole(campaign) if everything else campaign, Options(seed=seed, starts=_STARTS, workers=1))


def whole(campaign: Campaign) -> Campaign:
    """The same recordings with every sample for identification, for tools that hold nothing back."""
    recordings = tuple(replace(r, parts=(Part(r.name, 0, r.t.size, "identification"),)) for r in campaign.recordings)
    return replace(campaign, recordings=recordings, held_out=frozenset(), held_out_is_new=False)


def predictions(model: Model, folder: Path) -> Mapping[str, Array]:
    """(N,) outputs [m] of a model in the examination of a case, by recording."""
    exam = read(folder / "exam", need_output=False)
    return {p.recording.name: p.y for p in of_network(model.setup, model.substeps, exam)}


def bic(fitted: Fit) -> float:
    """Schwarz's criterion; residuals are in units of the noise."""
    return fitted.cost + fitted.z.size * math.log(fitted.residual.size)


def tried(current: Fit, effect: Effect, scales: Scales) -> Fit | None:
    """A few iterations with an effect from the points of its grid, the best of them; None where none can be simulated.

    Args:
        current: the fit to whose model the effect is added; scales: its typical sizes.
    """
    ends = []
    for point in effect.grid(scales)[:_POINTS]:
        try:
            ends.append(fitted_with(current, effect, point, _TRY))
        except PhnnError:
            continue
    return min(ends, key=bic, default=None)


def fitted_with(current: Fit, effect: Effect, point: Mapping[str, float], most: int = _REFIT) -> Fit:
    """A model with an effect from one starting point, fitted together with what was free before.

    Args:
        current: the fit to whose model the effect is added.
        point: starting values of the effect's parameters, SI; moved inside their bounds.
        most: simulations at most.

    Raises:
        PhnnError: it cannot be simulated.
    """
    begun = clamped(effect, current.setup, point)
    own = [n for n in effect.parameters if not begun.parameters[n].fixed]
    return fit(begun, current.plan, [*current.variables.names, *own], current.held, most, origin=current)


def refitted(current: Fit, found: Fit) -> Fit:
    """The end of a try, fitted to the end; the try itself where that cannot be simulated."""
    try:
        return fit(found.setup, current.plan, found.variables.names, current.held, _REFIT, origin=found)
    except PhnnError:
        return found


def places_of(names: Mapping[str, float]) -> tuple[str, ...]:
    """Locations by the sum of the probabilities of their effects, the most probable first; three at most."""
    known, sums = catalogue(), Counter[str]()
    for name, probability in names.items():
        sums[known[name].location] += probability  # type: ignore[assignment]
    return tuple(place for place, _ in sums.most_common(_PLACES))
