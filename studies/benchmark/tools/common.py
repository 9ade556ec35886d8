"""Common parts of the tools that start from the base model."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phnn import predictor
from phnn.diagnose.linearised import LinearisedFit, direction, prepare
from phnn.diagnose.refit import clamped
from phnn.effects import Effect, catalogue
from phnn.identification.fit import Fit, fit, fit_problem, variables_from
from phnn.identification.identified import Identified, identify
from phnn.identification.plan import Options, Plan
from phnn.identification.problem import Problem
from phnn.model import Model
from phnn.recordings import Part, read
from phnn.recordings.recording import Recording

Array = NDArray[np.float64]

_STARTS = 4  # of the base model's fit
_REFIT = 30  # simulations at most
PLACES = 3  # that are stated at most


def base_of(folder: Path, seed: int) -> Identified:
    """Identify the base model of a case from the samples for identification; some are held out, as phnn does it."""
    return identify(None, read(folder), Options(seed=seed, starts=_STARTS, workers=1))


def predictions(fitted: Fit, folder: Path) -> dict[str, Array]:
    """Return (N,) outputs [m] of a fitted model in the examination of a case, by recording."""
    model, exam = Model(fitted.setup, fitted.plan.finest), read(folder / "exam", need_output=False)
    return {p.recording.name: p.y for p in predictor.predictions(model, exam)}


def fitted_with(current: Fit, effect: Effect, point: Mapping[str, float], most: int = _REFIT) -> Fit:
    """Fit a model with one more effect from one starting point, together with what was free before.

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


def places_of(names: Mapping[str, float]) -> tuple[str, ...]:
    """Return locations by the sum of the probabilities of their effects, the most probable first; three at most."""
    known, sums = catalogue(), Counter[str]()
    for name, probability in names.items():
        sums[known[name].location] += probability  # type: ignore[assignment]
    return tuple(place for place, _ in sums.most_common(PLACES))


def with_parts(recording: Recording, edges: Sequence[int], uses: Sequence[str]) -> Recording:
    """Return a recording whose stretches between ``edges`` take turns in what they are for."""
    parts = tuple(
        Part(recording.name, int(a), int(b), uses[i % len(uses)]) for i, (a, b) in enumerate(itertools.pairwise(edges))
    )
    return replace(recording, parts=parts)


def in_turns(plan: Plan, stretches: int, uses: Sequence[str]) -> Plan:
    """Return the plan with so many equal stretches of every recording that take turns in what they are for."""
    cut = (with_parts(r, np.linspace(0, r.t.size, stretches + 1).astype(int).tolist(), uses) for r in plan.recordings)
    return replace(plan, recordings=tuple(cut))


def whole(plan: Plan) -> Plan:
    """Return the plan with every sample for identification, for methods that split the samples themselves."""
    return in_turns(plan, 1, ["identification"])


def evaluated(fitted: Fit, plan: Plan) -> LinearisedFit:
    """Evaluate a fitted model on other samples: residual, Jacobian and trajectories, with no step of a fit."""
    variables = variables_from(fitted.setup, plan, fitted.variables.names, fitted)
    return prepare(fit_problem(Problem(fitted.setup, plan, variables), fitted.held, 1))


def left(fitted: Fit, use: str) -> float:
    """Return the sum of squares over the noise that a model leaves in the samples of a use in its own plan."""
    residual = Problem(fitted.setup, fitted.plan, fitted.variables, use=use).residual(fitted.z)
    return float(residual @ residual)


def orthonormal(columns: Array, sizes: Array | None = None, rank: float = 1e-3, least: float = 0.0) -> Array:
    """Return an (N, p) basis of columns, each of them counted in units of its size, its length if left out.

    Directions weaker than the share ``rank`` of the strongest one, or of ``least``, are left out.
    """
    sizes = np.linalg.norm(columns, axis=0) if sizes is None else sizes
    used = sizes > 0.0
    if not used.any():
        return np.zeros((columns.shape[0], 0))
    basis, singular, _ = np.linalg.svd(columns[:, used] / sizes[used], full_matrices=False)
    return np.asarray(basis[:, singular > rank * max(least, singular[0])])


@dataclass(frozen=True)
class Candidate:
    """An effect at a point of its grid, where its coefficient is one; ``column``: its number in the library."""

    effect: Effect
    point: Mapping[str, float]
    column: int

    def scaled(self, coefficient: float) -> Mapping[str, float]:
        """Return the effect's parameters at a coefficient."""
        return self.effect.scaled(self.point, coefficient)


def library(linearised: LinearisedFit, effects: Sequence[Effect]) -> tuple[list[Candidate], Array]:
    """Return every effect at every point of its grid, and (N, M) its responses; none that change nothing."""
    candidates: list[Candidate] = []
    columns: list[Array] = []
    for effect in effects:
        for point in effect.grid(linearised.scales):
            column = direction(linearised, effect, point)
            if np.isfinite(column).all() and column.any():
                candidates.append(Candidate(effect, point, len(candidates)))
                columns.append(column)
    return candidates, np.column_stack(columns) if columns else np.zeros((linearised.fit.residual.size, 0))
