"""Learned elements trained by simulation on some stretches of the recordings, and judged on the others."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from phnn.diagnosis.linearised_fit import prepare
from phnn.diagnosis.starts import clamped
from phnn.effects import Effect
from phnn.effects.learned import learned_elements
from phnn.errors import PhnnError
from phnn.identification.fit import Fit, fit
from phnn.identification.plan import Plan
from phnn.identification.problem import Problem
from phnn.recordings.recording import Part, Recording

# Stretches of a recording; simulations of a fit.
STRETCHES, _SIMULATIONS = 10, 15
_USES = ("identification", "held")


@dataclass(frozen=True)
class Trained:
    """A learned element in the base model; ``share``: of the base model's squares that it leaves where it was not
    trained. ``effect`` is None for the base model itself."""

    effect: Effect | None
    fit: Fit
    share: float


def trained(base: Fit, plan: Plan, places: Iterable[str]) -> list[Trained]:
    """The learned elements of some places, the best one first; none that cannot be simulated."""
    stretches = replace(plan, recordings=tuple(_in_turns(r) for r in plan.recordings))
    nothing = fit(base.setup, stretches, base.variables.names, base.held, _SIMULATIONS, origin=base)
    alone, scales = _held(nothing), prepare(nothing).scales
    found, wanted = [], set(places)
    for effect in learned_elements().values():
        if effect.location not in wanted or not effect.can_be_added_to(nothing.setup):
            continue
        for point in effect.grid(scales)[:1]:
            try:
                setup = clamped(effect, nothing.setup, point)
                own = [n for n in effect.parameters if not setup.parameters[n].fixed]
                names = [*nothing.variables.names, *own]
                one = fit(setup, stretches, names, base.held, _SIMULATIONS, origin=nothing)
                found.append(Trained(effect, one, _held(one) / alone))
            except PhnnError:
                continue
    return sorted(found, key=lambda t: t.share)


def _held(fitted: Fit) -> float:
    left = Problem(fitted.setup, fitted.plan, fitted.variables, use=_USES[1]).residual(fitted.z)
    return float(left @ left)


def _in_turns(recording: Recording) -> Recording:
    edges = np.linspace(0, recording.t.size, STRETCHES + 1).astype(int)
    parts = [Part(recording.name, int(a), int(b), _USES[i % 2]) for i, (a, b) in enumerate(itertools.pairwise(edges))]
    return replace(recording, parts=tuple(parts))
