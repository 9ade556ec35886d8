"""The actions ``ψ_p(u_p)`` of the ports on their inputs, for all steps before the integration begins.

They depend on the inputs and parameters alone and on no state.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.program import Program
from phnn.integrate.tables import (
    LAW,
    PLACE_1,
    PORTS,
    rows_of,
)
from phnn.laws import PORT_LAWS
from phnn.laws.namespace import TINY

Array = NDArray[np.float64]


def actions(program: Program, theta: Any, u: Array) -> Any:
    """(…, P) ``ψ_p(u_p)`` of inputs (…, P)."""
    out = np.empty(u.shape, dtype=theta.dtype)
    for port, row in enumerate(rows_of(program.table, PORTS)):
        law = list(PORT_LAWS.values())[row[LAW]]
        out[..., port] = law.action(
            u[..., port], *(theta[place] for place in row[PLACE_1 : PLACE_1 + len(law.example)])
        )
    return out


def action_derivatives(program: Program, theta: Array, u: Array, places: NDArray[np.int64]) -> Array:
    """(S, n, P) derivatives of the actions by the parameters at some entries of ``theta``."""
    out = np.empty((places.size, *u.shape))
    for s, place in enumerate(places):
        moved = theta.astype(complex)
        moved[place] += 1j * TINY
        out[s] = np.imag(actions(program, moved, u)) / TINY
    return out
