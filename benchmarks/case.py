"""The case: the paper's sines as recorded, straight lines between the samples, and the compiled solver on them.

An actuator with the parameters of Table 1 at rest is driven by 75 V sines of 1 to 150 Hz, two periods of 1000 samples
each. What drives it is the recorded input: the straight line from sample to sample, for everybody.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from phnn.derivatives import output_derivatives
from phnn.integrate import kernel
from phnn.integrate.differentiable import simulated
from phnn.models.actuator import TABLE_1, from_paper
from phnn.network import PortHamiltonianSystem
from phnn.recordings.recording import Part, Recording, Start
from phnn.setup import Setup
from phnn.trajectory import Trajectory, simulate

Array = NDArray[np.float64]
Solve = Callable[[], Array]

FREQUENCIES = (1.0, 10.0, 25.0, 50.0, 75.0, 100.0, 150.0)  # Hz
AMPLITUDE = 75.0  # V
PERIODS = 2
SAMPLES = 2000
NAMES = tuple(TABLE_1)
TRUTH = np.array([TABLE_1[n] for n in NAMES])


def sine(frequency: float, samples: int = SAMPLES) -> Recording:
    """The first samples of a sine [Hz], without an output."""
    t = np.arange(samples) * (PERIODS / frequency / SAMPLES)
    return Recording(
        name=f"sine_{frequency:g}Hz",
        t=t,
        u=AMPLITUDE * np.sin(2.0 * np.pi * frequency * t),
        y=np.full(t.size, np.nan),
        start=Start("rest"),
        interpolation="linear",
        parts=(Part("all", 0, t.size, "identification"),),
        noise=1e-9,
        noise_source="none: a benchmark",
        noise_correlation=np.ones(1),
        period=None,
        channels={},
        source="",
    )


CAMPAIGN = tuple(sine(f) for f in FREQUENCIES)
# Enough for a solver that needs a second for it: the campaign lasts 360 times as long.
PART = (sine(150.0, SAMPLES // PERIODS + 1),)


def setup_with(theta: Array) -> Setup:
    """The actuator with other parameter values, in the order of `NAMES`."""
    return Setup(from_paper().with_values(dict(zip(NAMES, theta.tolist(), strict=True))))


def whole_call(recordings: Sequence[Recording], substeps: Sequence[float]) -> Solve:
    """(R, N) displacements by the public call: input, program and memory are made anew each time [m]."""

    def solve() -> Array:
        setup = setup_with(TRUTH)
        return np.stack([simulate(setup, r, int(s)).y for r, s in zip(recordings, substeps, strict=True)])

    return solve


class Prepared:
    """The solve alone: programs, inputs and memory are ready, only the march is left.

    The one place of the benchmarks that knows the signature of the compiled march.
    """

    def __init__(self, recordings: Sequence[Recording], substeps: Sequence[float], setup: Setup | None = None) -> None:
        own = setup or setup_with(TRUTH)
        self.trajectories = [simulate(own, r, int(s)) for r, s in zip(recordings, substeps, strict=True)]
        self._arguments = [_march_arguments(t) for t in self.trajectories]

    def march(self) -> Array:
        """(R, N) displacements of one run through all recordings [m]."""
        for arguments in self._arguments:
            kernel.march(*arguments)
        return np.stack(
            [a[5][t.nodes, t.program.output] for a, t in zip(self._arguments, self.trajectories, strict=True)]
        )


def _march_arguments(trajectory: Trajectory) -> tuple[Any, ...]:
    program = trajectory.program
    return (
        program, trajectory.theta, trajectory.states[0], trajectory.u, trajectory.h, np.empty_like(trajectory.states),
        np.empty_like(trajectory.efforts),
    )  # fmt: skip


def march_alone(recordings: Sequence[Recording], substeps: Sequence[float]) -> Solve:
    """(R, N) displacements by the integration alone [m]."""
    return Prepared(recordings, substeps).march


def swept_gradient(recordings: Sequence[Recording], substeps: Sequence[float], wanted: Array) -> Solve:
    """(R, 10) derivatives of ``Σ (q − wanted)²`` by the logarithms: a march and a sweep of ten columns [m²]."""
    prepared = Prepared(recordings, substeps)

    def solve() -> Array:
        residual = prepared.march() - wanted
        # The sweep runs along the prepared states, which the march has just reproduced.
        columns = np.stack([output_derivatives(t, NAMES) for t in prepared.trajectories])
        return np.asarray(2.0 * np.einsum("rn,rnk->rk", residual, columns) * TRUTH)

    return solve


def adjoint_gradient(recordings: Sequence[Recording], substeps: Sequence[float], wanted: Array) -> Solve:
    """(R, 10) the same by torch's autograd through the differentiable march: one backward sweep [m²]."""
    system = PortHamiltonianSystem(from_paper())
    trajectories = Prepared(recordings, substeps).trajectories
    inputs = [(torch.from_numpy(t.states[0]), torch.from_numpy(t.u), torch.from_numpy(t.h)) for t in trajectories]
    output = system.state_names.index(system.network.output)

    def one(which: int) -> Array:
        system.zero_grad()
        path = simulated(system, *inputs[which])
        q = path[torch.from_numpy(trajectories[which].nodes), output]
        ((q - torch.from_numpy(wanted[which])) ** 2).sum().backward()
        return np.array([system.free.gradient(n) for n in NAMES])

    return lambda: np.stack([one(r) for r in range(len(inputs))]) * TRUTH
