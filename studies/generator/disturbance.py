"""A disturbance that acts on one recording and is not recorded."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from studies.generator.parameters import FORCE_STEP, Array

__all__ = ["CALM", "FORCE_STEP", "Disturbance"]


def _nothing() -> Array:
    return np.zeros(0)


@dataclass(frozen=True, eq=False)
class Disturbance:
    """A random force on the mass and errors of the sampling instants; both are absent where they are empty.

    Attributes:
        force: (n,), N, at multiples of ``FORCE_STEP`` from the start of the recording on, straight in between.
        late: (samples,), s: the displacement is sampled that much later than its time says, the voltage is not.
    """

    force: Array = field(default_factory=_nothing)
    late: Array = field(default_factory=_nothing)


CALM = Disturbance()
