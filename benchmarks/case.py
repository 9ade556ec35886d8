"""The case: the paper's seven sines, from rest, with the parameters of Table 1, and the compiled solver on it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.integrate import kernel
from phnn.models.actuator import TABLE_1, from_paper
from phnn.recordings.recording import Part, Recording, Start
from phnn.setup import Setup
from phnn.simulate import Trajectory, output_derivatives, simulate

Array = NDArray[np.float64]

FREQUENCIES = (1.0, 10.0, 25.0, 50.0, 75.0, 100.0, 150.0)  # Hz
AMPLITUDE = 75.0  # V
PERIODS = 2
SAMPLES = 2000
NAMES = tuple(TABLE_1)
TRUTH = np.array([TABLE_1[n] for n in NAMES])


def times(frequency: float) -> Array:
    """(SAMPLES,) sampling times of one sine [s]."""
    return np.asarray(np.arange(SAMPLES) * (PERIODS / frequency / SAMPLES), dtype=np.float64)


def recording(frequency: float) -> Recording:
    """One sine as the solver sees it: samples only, the input between them is a cubic spline."""
    t = times(frequency)
    return Recording(
        name=f"sine_{frequency:g}Hz",
        t=t,
        u=AMPLITUDE * np.sin(2.0 * np.pi * frequency * t),
        y=np.full(t.size, np.nan),
        start=Start("rest"),
        interpolation="cubic",
        parts=(Part("all", 0, t.size, "identification"),),
        noise=1e-9,
        noise_source="none: a benchmark",
        noise_correlation=np.ones(1),
        period=None,
        channels={},
        source="",
    )


RECORDINGS = tuple(recording(f) for f in FREQUENCIES)


def setup_with(theta: Array) -> Setup:
    """The actuator with other parameter values, in the order of `NAMES`."""
    return Setup(from_paper().with_values(dict(zip(NAMES, theta.tolist(), strict=True))))


def simulate_all(theta: Array, substeps: int, recordings: Sequence[Recording] = RECORDINGS) -> tuple[Trajectory, ...]:
    """The whole call on every recording."""
    setup = setup_with(theta)
    return tuple(simulate(setup, r, substeps) for r in recordings)


def outputs(trajectories: Sequence[Trajectory]) -> Array:
    """(R, SAMPLES) displacements [m]."""
    return np.stack([t.y for t in trajectories])


def sensitivities(trajectories: Sequence[Trajectory]) -> Array:
    """(R, SAMPLES, 10) derivatives of the displacement by the logarithms of the parameters [m]."""
    theta = np.array([trajectories[0].setup.parameters[n].value for n in NAMES])
    return np.stack([output_derivatives(t, NAMES) for t in trajectories]) * theta


class Prepared:
    """The solve alone: programs, inputs and memory are ready, only the march is left."""

    def __init__(self, trajectories: Sequence[Trajectory]) -> None:
        self.trajectories = trajectories
        self._arguments = [_march_arguments(t) for t in trajectories]

    def march(self) -> Array:
        """(R, SAMPLES) displacements of one run through all recordings [m]."""
        for arguments in self._arguments:
            kernel.march(*arguments)
        return np.stack(
            [a[9][t.nodes, t.program.output] for a, t in zip(self._arguments, self.trajectories, strict=True)]
        )


def _march_arguments(trajectory: Trajectory) -> tuple[Any, ...]:
    program = trajectory.program
    return (
        program.leaves, program.modulators, program.resistors, program.ports, program.inertia, trajectory.theta,
        trajectory.states[0], trajectory.u, trajectory.h, np.empty_like(trajectory.states),
        np.empty_like(trajectory.velocity), np.empty_like(trajectory.efforts),
    )  # fmt: skip


def cost_gradient(prepared: Prepared, wanted: Array) -> Array:
    """(10,) derivative of ``Σ (q − wanted)²`` by the logarithms of the parameters: one march and one sweep [m²]."""
    residual = prepared.march() - wanted
    # The sweep runs along the prepared states, which the march has just reproduced.
    return 2.0 * np.einsum("rn,rnk->k", residual, sensitivities(prepared.trajectories))
