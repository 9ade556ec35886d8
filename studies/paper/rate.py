"""Rate dependence (Fig. 15): the same extreme values of the voltage, passed at different rates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.recordings.recording import unrecorded
from phnn.setup import Setup
from phnn.simulate import simulate

Array = NDArray[np.float64]

_CORNERS = np.array([0.0, 1.0, -0.4, 0.6, -1.0, 0.0])  # voltage over its peak, reached one after the other
_SAMPLES = 6000  # a whole number for each of five lines, and for each of three periods


@dataclass(frozen=True)
class Passage:
    """Attributes:
    duration: s, of the input; t: (N,) time over the duration; u: (N,) input, V; y: (N,) displacement, m.
    """

    duration: float
    t: Array
    u: Array
    y: Array


def ramps(setup: Setup, peak: float, duration: float) -> Passage:
    """A model from rest under straight lines between fixed extreme values, in the time given.

    Args:
        setup: the model.
        peak: largest voltage, V.
        duration: of the five lines together, s.
    """
    t = np.linspace(0.0, 1.0, _SAMPLES + 1)
    u = peak * np.interp(t, np.linspace(0.0, 1.0, _CORNERS.size), _CORNERS)
    return _passage(setup, duration, t, u, "linear")


def loop(setup: Setup, peak: float, frequency: float) -> Passage:
    """The last of three periods of a sine from rest."""
    t = np.linspace(0.0, 3.0, _SAMPLES + 1)
    found = _passage(setup, 1.0 / frequency, t, peak * np.sin(2.0 * np.pi * t), "cubic")
    last = slice(2 * _SAMPLES // 3, None)
    return Passage(found.duration, t[last] - 2.0, found.u[last], found.y[last])


def _passage(setup: Setup, scale: float, t: Array, u: Array, interpolation: str) -> Passage:
    """A simulation at the times ``t · scale``."""
    blank = unrecorded("rate", t * scale, u, interpolation)
    return Passage(scale, t, u, simulate(setup, blank, substeps=2).y)
