"""The characteristic of a learned resistor: its inverse over the visited flows, and thresholds from it.

A hysteron's voltage is all that the recordings see of its resistor, and the flow through it is what drives it: so a
resistor is compared where it has been, and as effort over flow, which a steep slope does not blow up.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from phnn.errors import PhnnError

Array = NDArray[np.float64]

_GRID = 20001


def inverse(
    law: Callable[[Tensor], Tensor],
    flows: Array,  # (K,) [A]
    reach: float,
) -> Array:
    """Return the (K,) smallest effort [V] within ``reach``, on the side of the flow's sign, at which the law carries
    each flow.

    Raises:
        PhnnError: a flow that the law does not reach.
    """
    effort, found = np.linspace(0.0, reach, _GRID), np.empty_like(flows)
    for side, mine in ((-1.0, flows < 0.0), (1.0, flows >= 0.0)):
        with torch.no_grad():
            carried = np.maximum.accumulate(side * law(torch.from_numpy(side * effort)).numpy())
        wanted = np.abs(flows[mine])
        if strange := wanted[(wanted <= carried[0]) | (wanted > carried[-1])].tolist():
            raise PhnnError(
                f"the law carries no {strange[0]:g} A within {reach:g} V: give a larger reach, or a flow above 0"
            )
        found[mine] = side * np.interp(wanted, carried, effort)
    return found


def thresholds(
    law: Callable[[Tensor], Tensor],
    largest: float,
    reach: float,
    points: int = 50,
) -> tuple[float, float]:
    """Return where the straight line through the inverse characteristic of each side meets zero flow [V].

    For the dead zone of eq. (2) these are ``−d/2`` and ``d/2`` exactly.

    Args:
        largest: largest flow that was visited [A]; the line is fitted from a twentieth of it on.
        reach: efforts looked at [V].
    """
    flows = np.linspace(0.05 * largest, largest, points)
    low, high = (np.polyfit(s * flows, inverse(law, s * flows, reach), 1)[1] for s in (-1.0, 1.0))
    return float(low), float(high)
