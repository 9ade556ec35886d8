"""Samples at a limit of the sensor: they say only that the output lies at or beyond the limit.

    r = 0                      where the recorded sample sits at a limit and the model's output lies beyond it
    r = (y − ŷ − zero)/σ       otherwise

The zero belongs to the model's output here. It is found together with the samples that count: the sum of squares is
convex in it, and a few rounds settle both.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.identification.nuisances import constant_and_own
from phnn.recordings.recording import Recording
from phnn.setup import NOTHING, Own

Array = NDArray[np.float64]
Rows = NDArray[np.bool_]

# Rounds after which the samples that count are taken as they are; two or three settle them.
_ROUNDS = 30


def beyond_limit(recording: Recording, y: Array, mask: NDArray[Any], own: Own = NOTHING) -> Rows | None:
    """(N,) which masked samples sit at a limit while the model lies beyond it; None where none sits at a limit.

    Args:
        y: (N,) the model's output without zero and nuisances.
        mask: (N,) the samples that are scored.
    """
    if not recording.sensor.is_limited:
        return None
    side = recording.sensor.at_limit(recording.y)
    at_limit = (side != 0) & mask
    if not at_limit.any():
        return None
    error, hidden = recording.y - y, at_limit
    for _ in range(_ROUNDS):
        left = error - constant_and_own(error, mask & ~hidden, recording, own)
        now = at_limit & (side * left <= 0.0)
        if np.array_equal(now, hidden):
            break
        hidden = now
    return hidden
