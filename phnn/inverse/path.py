"""A displacement between its samples, with the derivatives that the inverse needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

Array = NDArray[np.float64]

# Degree of the spline: its second derivative is a cubic spline.
_DEGREE = 5


@dataclass(frozen=True)
class Path:
    """A motion at ``n + 1`` nodes, equally far apart.

    Attributes:
        times: (n+1,) [s], from zero; h: their interval [s].
        q, velocity, acceleration: (n+1,) displacement [m] and its derivatives.
        node_velocity: (n+1,) the velocity whose trapezoidal sum is the displacement up to fourth order in ``h``,
            ``q̇ − h² q⃛/12``: the step moves a displacement by the mean of the velocities at its ends.
    """

    times: Array
    h: float
    q: Array
    velocity: Array
    acceleration: Array
    node_velocity: Array


def smallest_count() -> int:
    """The fewest samples that a spline can be put through."""
    return _DEGREE + 1


def path_through(samples: Array, dt: float, substeps: int) -> Path:
    """The quintic spline through samples, on the sub-steps of a simulation.

    Args:
        samples: (N,) displacement [m]; dt: their interval [s].
        substeps: steps in an interval.
    """
    # In units of the interval, so that the equations of the spline are well scaled.
    curve = make_interp_spline(np.arange(samples.size), samples, k=_DEGREE)
    places = np.arange((samples.size - 1) * substeps + 1) / substeps
    h = dt / substeps
    q, v, a, jerk = (np.asarray(curve(places, nu)) / dt**nu for nu in range(4))
    times: Array = h * np.arange(places.size, dtype=np.float64)
    return Path(times, h, q, v, a, v - h * h / 12.0 * jerk)


def derivative(samples: Array, dt: float) -> Array:
    """(N,) rate of samples by the same spline."""
    places = np.arange(samples.size)
    return np.asarray(make_interp_spline(places, samples, k=_DEGREE)(places, 1)) / dt
