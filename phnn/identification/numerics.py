"""The numerical error of a simulation, solver and input reconstruction, seen as an experimenter would.

A coherent error far below the noise can be significant over many samples and would then be named as physics. So
the error is measured by halving the step and by changing the reconstruction, and what base parameters and zero
absorb is projected out; the norm of the rest, over the whole plan, is in units of one standard deviation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phnn.identification.censoring import beyond_limit
from phnn.identification.fit import Fit
from phnn.identification.nuisances import without_nuisances
from phnn.identification.plan import Plan
from phnn.recordings.recording import Recording
from phnn.setup import Setup
from phnn.simulate import simulate

Array = NDArray[np.float64]

MAX_SUBSTEPS = 64


@dataclass(frozen=True)
class NumericalError:
    """Attributes:
    error: (N,) weighted error over the identification samples, stacked over recordings.
    sigma: its norm after projection on what base and zero cannot absorb.
    shares: weighted norm by recording before the projection.
    """

    error: Array
    sigma: float
    shares: dict[str, float]


def substeps_for(setup: Setup, plan: Plan, bound: float, initial: Mapping[str, Array] | None = None) -> Plan:
    """The plan with sub-steps doubled, recording by recording, until the solver error is below the bound.

    The bound [standard deviations] is shared evenly among the recordings, 1.5 times over, because the projection that
    is not made here takes away more than half.
    """
    chosen = dict(plan.substeps)
    share = 1.5 * bound / np.sqrt(len(plan.recordings))

    def run(recording: Recording, steps: int) -> Array:
        return simulate(setup, recording, steps, initial=(initial or {}).get(recording.name)).y

    def enough(recording: Recording) -> int:
        steps = plan.steps_of(recording)
        coarse = run(recording, steps)
        while steps < MAX_SUBSTEPS:
            fine = run(recording, 2 * steps)
            mask = recording.mask("identification")
            hidden = beyond_limit(recording, fine, mask, setup.own)
            change = without_nuisances(coarse - fine, mask, recording, setup.own, hidden)
            if 4.0 / 3.0 * np.linalg.norm(change) / recording.noise <= share:
                break
            steps, coarse = 2 * steps, fine
        return steps

    for recording, steps in zip(plan.recordings, plan.each(enough), strict=True):
        chosen[recording.name] = steps
    return replace(plan, substeps=chosen)


def numerical_error(fit: Fit) -> NumericalError:
    """Error of solver and reconstruction at a fit."""
    plan = fit.plan

    def one(recording: Recording) -> Array:
        steps, initial = plan.steps_of(recording), fit.initial(recording.name)
        base = simulate(fit.setup, recording, steps, initial=initial).y
        solver = (simulate(fit.setup, recording, 2 * steps, initial=initial).y - base) * 4.0 / 3.0
        reconstruction = np.zeros_like(solver)
        if recording.interpolation == "cubic":
            reconstruction = simulate(fit.setup, recording, steps, method="quintic", initial=initial).y - base
        mask = recording.mask("identification")
        hidden = beyond_limit(recording, base, mask, fit.setup.own)
        return without_nuisances(solver + reconstruction, mask, recording, fit.setup.own, hidden) / recording.noise

    parts = plan.each(one)
    error = np.concatenate(parts)
    rest = error
    if fit.jacobian.shape[1]:
        q, _ = np.linalg.qr(fit.jacobian)
        rest = error - q @ (q.T @ error)
    names = [r.name for r in plan.recordings]
    shares = {n: float(np.linalg.norm(p)) for n, p in zip(names, parts, strict=True)}
    return NumericalError(error, float(np.linalg.norm(rest)), shares)
