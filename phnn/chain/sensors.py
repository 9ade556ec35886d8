"""Sensor blocks: from the network's output to the recorded output.

A block takes samples (N, …) of its input, their times (N,) or (N, 1) [s] and its parameters, and gives the samples of
its output. It acts on every column alike: with ``q + i·1e-140 q'`` in the columns come the directional derivatives.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.chain.knee import bent, kneed
from phnn.chain.lag import lag
from phnn.chain.play import play
from phnn.chain.rate import rate
from phnn.chain.time import clock, drifting_gain
from phnn.laws.namespace import absolute

Array = NDArray[Any]


def drift(y: Array, t: Array, rate: Any) -> Array:
    """``y + r t``: a sensor that drifts at a constant rate."""
    return np.asarray(y + rate * t)


def polynomial(y: Array, t: Array, square: Any, cube: Any) -> Array:
    """``y + a₂ y² + a₃ y³``: a static characteristic that is not straight."""
    return np.asarray(y * (1.0 + y * (square + y * cube)))


def zero(y: Array, t: Array, offset: Any) -> Array:
    """``y + y₀``: a sensor whose zero is the same in all recordings."""
    return np.asarray(y + offset)


def rectification(y: Array, t: Array) -> Array:
    """``|y|``: a sensor that knows no sign."""
    return np.asarray(absolute(y))


def knee(y: Array, t: Array, share: Any, level: Any) -> Array:
    """`phnn.chain.knee.kneed`: less gain beyond a level on one side."""
    return kneed(y, share, level)


def cubic(y: Array, t: Array, square: Any, cube: Any, level: Any) -> Array:
    """`phnn.chain.knee.bent`: a characteristic that is a cubic within a level and straight beyond it."""
    return bent(y, square, cube, level)


SENSORS: dict[str, Callable[..., Array]] = {
    "drift": drift,
    "lag": lag,
    "rate": rate,
    "polynomial": polynomial,
    "rectification": rectification,
    "zero": zero,
    "play": play,
    "knee": knee,
    "cubic": cubic,
    "clock": clock,
    "drifting_gain": drifting_gain,
}
REMEMBERING = ("lag", "play", "clock", "rate")
"""Blocks whose output depends on what was between the samples."""
LINEAR = ("lag", "rate", "clock", "drifting_gain")
"""Blocks whose output is linear in their input, so that changes of it pass like the signal itself."""
