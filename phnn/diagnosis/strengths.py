"""Start values for the strengths of an element: the model is nearly linear in them, and they have bounds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import lsq_linear

from phnn.errors import SolverFailed
from phnn.identification.fit import Fit, variables_from
from phnn.identification.plan import Plan
from phnn.identification.problem import Problem
from phnn.setup import Setup

# Shares of the step that are tried, the longest first.
_SHARES = (1.0, 0.3)
# Strengths that the linear problem puts on a bound begin this share of the largest one away from it, by their typical
# sizes: from next to a bound the optimiser's first steps would all be short.
_FAINT = 0.02


def started(
    setup: Setup, plan: Plan, names: Sequence[str], strengths: Sequence[str], origin: Fit | None, longest: float
) -> Setup:
    """The setup with strengths and base parameters moved to where the linearised least-squares problem has its minimum.

    From small strengths the bounded optimiser takes dozens of steps to where this single one leads: each ends where the
    first of the strengths meets its bound.

    Args:
        setup: with the element at any strengths inside their bounds.
        plan: recordings and sub-steps.
        names: all parameters that are estimated; strengths: those of the element.
        origin: earlier fit with the initial states.
        longest: by how much other parameters may move, in estimation coordinates.

    Returns:
        The setup as it was where no share of the step lowers the sum of squares.
    """
    problem = Problem(setup, plan, variables_from(setup, plan, names, origin))
    start = problem.variables.start(setup)
    lower, upper = problem.variables.bounds(setup)
    own = np.array([n in strengths for n in names] + [False] * (start.size - len(names)))
    near = np.where(own, np.inf, longest)
    lower, upper = np.maximum(lower - start, -near), np.minimum(upper - start, near)
    jacobian, residual = problem.jacobian(start), problem.residual(start)
    used = np.any(jacobian != 0.0, axis=0) & (lower < upper)
    # The same problem in a small square.
    square = np.asarray(np.linalg.qr(np.column_stack([jacobian[:, used], residual]), mode="r"))
    step = np.zeros(start.size)
    step[used] = lsq_linear(square[:, :-1], -square[:, -1], (lower[used], upper[used]), method="bvls").x
    least, cost = problem.variables.bounds(setup), float(residual @ residual)
    for share in _SHARES:
        z = start + share * step
        away = _FAINT * float(np.abs(z[own]).max(initial=0.0))
        room = np.minimum(away, 0.5 * (least[1] - least[0]))
        z[own] = np.clip(z, least[0] + room, least[1] - room)[own]
        # Initial states stay with the origin of the fit.
        z[len(names) :] = start[len(names) :]
        try:
            found = problem.residual(z)
        except SolverFailed:
            continue
        if float(found @ found) < cost:
            return problem.variables.setup(setup, z)
    return setup
