"""The uncertainty that anchors bring into a fit.

A fit holds an anchor ``a`` at its stated value and minimises ``½|r(z, a)|²`` over ``z`` alone. At the optimum
``Jᵀr = 0`` with ``J = ∂r/∂z``, so that by the implicit function theorem (Gauss–Newton, without second derivatives)

    dz/da = −(JᵀJ)⁻¹ Jᵀ ∂r/∂a

and an anchor of variance ``s²`` adds ``(dz/da) s² (dz/da)ᵀ`` to the covariance of ``z``. No table of exponents is
needed: where voltage and displacement leave one factor open, this gives ``d ln k / d ln m = 1`` by itself, and ratios
such as ``k/m`` keep their standard error.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phnn.derivatives import output_derivatives
from phnn.identification.censoring import beyond_limit
from phnn.identification.nuisances import without_nuisances
from phnn.identification.problem import Problem
from phnn.recordings.recording import Recording
from phnn.simulate import Trajectory

Array = NDArray[np.float64]


def held_anchors(problem: Problem) -> dict[str, float]:
    """Standard deviations [SI] of the anchors that a problem's setup has and does not estimate; exact ones left out."""
    names = problem.template.parameters
    estimated = problem.variables.names
    return {n: s for n, s in problem.plan.anchors.items() if s > 0.0 and n in names and n not in estimated}


def residual_by_anchors(problem: Problem, z: Array, names: tuple[str, ...]) -> Array:
    """(N, A) derivatives of the weighted residual by A held parameters [1/SI unit], initial states unchanged."""
    own = problem.template.own

    def one(recording: Recording, trajectory: Trajectory, mask: Array) -> Array:
        hidden = beyond_limit(recording, trajectory.y, mask, own)
        changes = without_nuisances(output_derivatives(trajectory, names), mask, recording, own, hidden)
        return np.asarray(changes / -recording.noise)

    return np.concatenate(problem.plan.each(one, problem.trajectories(z), problem.masks))


def estimates_by_anchors(bread: Array, jacobian: Array, columns: Array) -> Array:
    """(K, A) derivatives of the estimates ``z`` by the anchors, ``−B Jᵀ ∂r/∂a`` with ``B = (JᵀJ)⁻¹``."""
    return np.asarray(-bread @ (jacobian.T @ columns))
