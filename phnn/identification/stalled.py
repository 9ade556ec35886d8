"""Fits that rest where their own linearisation says they should not.

A state that switches a law at a sample more or less makes the sum of squares rough on a small scale: descent stops in
front of the first local minimum of a non-smooth cost, though the derivatives predict a large decrease beyond.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from phnn.errors import PhnnError
from phnn.identification.fit import Fit, fit

Array = NDArray[np.float64]

# Least predicted decrease of the cost: a share of the excess over the noise, and residual variances.
_SHARE, _LEAST = 0.1, 12.0
# Lengths of the large step, how often it is made, and the largest change of a coordinate.
_LENGTHS, _TIMES, _FARTHEST = (2.0, 1.0, 0.5), 5, 2.0
_FEW = 8
# Room that is left between the bounds of a step where there is none.
_NONE = 1e-12


def resumed(fitted: Fit) -> Fit:
    """The fit, or a better one from a larger step where the cost is not smooth on a small scale.

    The predicted decrease by a step ``s`` inside the bounds is ``|r|² − |r + J s|²``; at an optimum it is zero, or
    limited by the bounds.
    """
    for _ in range(_TIMES):
        step, promise = _step(fitted)
        excess, least = fitted.beyond_noise, _LEAST * max(1.0, fitted.chi2)
        if promise < max(_SHARE * excess, least):
            break
        tried = [f for length in _LENGTHS if (f := _from(fitted, length * step)) is not None]
        best = min(tried, key=lambda f: f.cost, default=fitted)
        if best.cost > fitted.cost - least:
            break
        fitted = best
    return fitted


def _step(fitted: Fit) -> tuple[Array, float]:
    """Return the step inside the bounds with the largest predicted decrease, and this decrease."""
    if not fitted.z.size:
        return fitted.z, 0.0
    q, triangle = np.linalg.qr(fitted.jacobian)
    lower, upper = fitted.variables.bounds(fitted.setup)
    # Rounding may have left an estimate a little beyond its bound.
    low = np.minimum(np.maximum(lower - fitted.z, -_FARTHEST), -_NONE)
    high = np.maximum(np.minimum(upper - fitted.z, _FARTHEST), _NONE)
    step = lsq_linear(triangle, -q.T @ fitted.residual, (low, high)).x
    return step, fitted.cost - float(np.sum((fitted.residual + fitted.jacobian @ step) ** 2))


def _from(fitted: Fit, step: Array) -> Fit | None:
    """Fitted anew from a step away."""
    z = fitted.z + step
    there = fitted.variables.setup(fitted.setup, z)
    origin = replace(fitted, z=z, setup=there)
    try:
        return fit(there, fitted.plan, fitted.variables.names, fitted.held, _FEW, origin=origin)
    except PhnnError:
        return None
