"""A signal whose values cannot all be reached."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Signal(NamedTuple):
    """Attributes:
    values: (M,) of the signal.
    lost: (M,) bool: what was asked for lies out of reach there.
    causes: why, in words, for messages.
    """

    values: Array
    lost: NDArray[np.bool_]
    causes: tuple[str, ...] = ()

    def then(self, values: Array, lost: NDArray[np.bool_] | None = None, cause: str = "") -> Signal:
        """The signal behind one more stage, which may lose samples for a cause of its own."""
        if lost is None or not lost.any():
            return Signal(values, self.lost, self.causes)
        return Signal(values, self.lost | lost, (*self.causes, cause))


def reachable(values: Array) -> Signal:
    """A signal of which nothing is lost."""
    return Signal(values, np.zeros(values.size, dtype=bool))
