"""Sources: inputs of further ports as functions of the recording's time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


def tone(t: Array, cosine: Any, sine: Any, frequency: Any) -> Array:
    """``A_c cos 2πft + A_s sin 2πft``."""
    phase = 2.0 * np.pi * frequency * t
    return np.asarray(cosine * np.cos(phase) + sine * np.sin(phase))


SOURCES: dict[str, Callable[..., Array]] = {"tone": tone}
