"""Predict with the base model and an identified force.

The force follows from the states, and the states from the force. The fitted base model, whose motion is nearest to the
recorded one, gives the first states; a simulation of the base with this force as an input at its port gives the next
ones (Picard's iteration). Without convergence there is an error of the order of the force's change by its own effect:
a force that moves the output by a share ε of its range leaves an error of about ε² of it, more near the resonance.
The iteration contracts for stiffness-like forces below the resonance, not for dry friction, whose sign chatters. So
one, two or three iterations are made, whichever brings the model nearest to the recordings that are known.

The parameters of the base are estimated anew beside the force, for alone they have taken up a part of what is missing.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phnn.errors import PhnnError, SolverFailed
from phnn.identification.fit import Fit, fit
from phnn.identification.nuisances import without_nuisances
from phnn.recordings import read
from phnn.recordings.recording import Recording
from phnn.setup import Setup
from phnn.simulate import simulate
from studies.benchmark.residual_force.states import States, states_of

Array = NDArray[np.float64]

# Force [N] and change of the output [m] at the samples, by the states of a recording.
Law = Callable[[States], tuple[Array, Array]]

# Iterations at most; evaluations of a refit; change of the output over its range beyond which a prediction diverges.
_MOST, _EVALUATIONS, _DIVERGED = 3, 12, 0.5


@dataclass(frozen=True)
class Forced:
    """A base model with a law.

    Attributes:
        first: the base model that gives the first states; beside: with the parameters that were estimated beside the
            law; law: None for the base alone; iterations: of force and states; substeps: of simulations.
    """

    first: Setup
    beside: Setup
    law: Law | None
    iterations: int
    substeps: int


def alone(fitted: Fit) -> Forced:
    """The base model without a force."""
    return Forced(fitted.setup, fitted.setup, None, 0, fitted.plan.finest)


def forced(fitted: Fit, law: Law) -> Forced:
    """Estimate the base's parameters beside a law and choose the number of iterations.

    Where no number of them brings model and recordings nearer to one another, the law is given up with a warning.
    """
    try:
        beside = _refitted(fitted, law)
    except PhnnError as error:
        warnings.warn(f"the identified force cannot be simulated ({error}): the base predicts alone", stacklevel=2)
        return alone(fitted)
    candidates = [Forced(fitted.setup, beside, law, n, fitted.plan.finest) for n in range(1, _MOST + 1)]
    costs = [_cost(model, fitted) for model in candidates]
    if min(costs) < fitted.cost:
        return candidates[int(np.argmin(costs))]
    warnings.warn("the identified force brings the model no nearer: the base predicts alone", stacklevel=2)
    return alone(fitted)


def _refitted(fitted: Fit, law: Law) -> Setup:
    """The base with parameters that are estimated beside the force of its own states."""
    recordings = []
    for recording in fitted.plan.recordings:
        initial = fitted.initial(recording.name)
        states = states_of(simulate(fitted.setup, recording, fitted.plan.steps_of(recording), initial=initial))
        force, output = law(states)
        recordings.append(replace(with_force(recording, force), y=recording.y - output[states.lead :]))
    plan = replace(fitted.plan, recordings=tuple(recordings))
    return fit(fitted.setup, plan, fitted.variables.names, fitted.held, _EVALUATIONS, origin=fitted).setup


def with_force(recording: Recording, force: Array) -> Recording:
    """The recording with a force (N + lead,) [N] on the mass; the model's port counts it with the other sign."""
    lead = force.size - recording.t.size
    return replace(recording, further={**recording.further, "force": -force[lead:]})


def _cost(model: Forced, fitted: Fit) -> float:
    """Weighted sum of squares of the identification samples; infinite where a prediction diverges."""
    total, own = 0.0, fitted.setup.own
    for recording in fitted.plan.recordings:
        try:
            y = predicted(model, recording, fitted.plan.steps_of(recording))
        except PhnnError:
            return np.inf
        error = without_nuisances(recording.y - y, recording.mask("identification"), recording, own)
        total += float(np.sum(error**2)) / recording.noise**2
    return total


def predicted(model: Forced, recording: Recording, substeps: int) -> Array:
    """(N,) output [m].

    Raises:
        SolverFailed: a step has no solution, or the iteration diverges.
    """
    trajectory = simulate(model.first, recording, substeps)
    base, y = trajectory.y, trajectory.y
    if model.law is None:
        return base
    for _ in range(model.iterations):
        states = states_of(trajectory)
        force, output = model.law(states)
        trajectory = simulate(model.beside, with_force(recording, force), substeps)
        y = trajectory.y + output[states.lead :]
        if not np.ptp(y - base) < _DIVERGED * np.ptp(base):
            raise SolverFailed(f"{recording.name}: force and motion grow by one another: use the base model alone")
    return y


def examination(model: Forced, folder: Path) -> Mapping[str, Array]:
    """(N,) outputs [m] in the examination of a case by recording, of the base alone, with a warning, where the force
    diverges."""
    found = {}
    for recording in read(folder / "exam", need_output=False).recordings:
        try:
            found[recording.name] = predicted(model, recording, model.substeps)
        except PhnnError as error:
            warnings.warn(f"{error}: it predicts alone", stacklevel=2)
            base = replace(model, beside=model.first, law=None)
            found[recording.name] = predicted(base, recording, model.substeps)
    return found
