"""The prior distribution of a recording's initial state, before its samples are seen.

A recording that begins in the middle of an operation has been moving before. Its state is then most likely one that the
model passes through whenever the input has the same value and moves the same way, once what it was at first is
forgotten: the later part of a simulation on the recording's own input shows these states.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.passage import is_displacement
from phnn.simulate import Trajectory

Array = NDArray[np.float64]

# Inputs nearer than this, as a share of the input's range, count as the same value.
_NEAR = 0.1
# What comes before this share of a recording may still hold what the simulation began with.
_FORGOTTEN = 0.2
# With fewer such samples all of the recording's states come into question.
_FEWEST = 5
# Least spread, as a share of the range of a state: history may have been another than the recording's own input.
_LEAST = 0.2
# Spread of an initial displacement that was recorded, as a share of its range.
_RECORDED = 1e-4


@dataclass(frozen=True)
class Expected:
    """A normal distribution of the initial state, its states independent.

    Attributes:
        mean, spread: (N,) its mean and standard deviations, in the units of the states.
    """

    mean: Array
    spread: Array


def expected_start(trajectory: Trajectory, scales: Array) -> Expected:
    """The distribution of the state in which a recording begins.

    Args:
        trajectory: of the recording, from rest.
        scales: (N,) range of every state, which is not zero.
    """
    states = trajectory.states[trajectory.nodes[trajectory.lead :]]
    u = trajectory.recording.u
    way = np.sign(np.gradient(u)) if u.size > 1 else np.zeros(1)
    alike = (np.abs(u - u[0]) <= _NEAR * np.ptp(u)) & (way == way[0])
    alike[: int(_FORGOTTEN * u.size)] = False
    met = states[alike] if alike.sum() >= _FEWEST else states
    mean = met.mean(axis=0) if alike.sum() >= _FEWEST else states[0].copy()
    spread = np.maximum(met.std(axis=0), _LEAST * scales)
    place = trajectory.program.travel
    if place >= 0 and is_displacement(trajectory.setup, trajectory.recording):
        # Where the imposed motion begins was recorded.
        mean[place], spread[place] = states[0, place], _RECORDED * scales[place]
    return Expected(mean, spread)
