"""Simulate a setup on a recording.

recorded input → reconstruction → amplifier → network (compiled march) → sensor → output
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.chain.passage import amplified, measured, place_of, sensed, sounded
from phnn.errors import SolverFailed
from phnn.integrate import kernel
from phnn.integrate.cycle import steady_cycle
from phnn.integrate.program import Program, compile_network
from phnn.integrate.rest import equilibrium
from phnn.recordings.recording import Recording
from phnn.setup import Setup
from phnn.signals.reconstruct import mean_input, substep_counts, substep_input

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trajectory:
    """A simulated recording: ``N`` samples and ``n`` steps, those of a run-in among them.

    Attributes:
        setup, recording, program, theta: what was simulated.
        h: (n,) steps [s].
        nodes: (N + lead,) step index of every sample.
        lead: samples before the first recorded one, a period where the recording starts in a steady cycle.
        cycle: steps of that period, in whose steady state the simulation starts; 0 where it starts otherwise.
        rest: port voltage whose equilibrium the simulation starts from; None where it starts from a given state.
        t: (N,) time of the samples [s].
        y: (N,) sensor output without the displacement zero.
        fine: (n, 3) port input within the steps; u: (n, P) mean inputs.
        states: (n+1, N) states at the nodes, in the order of the network.
        efforts: (n, N) mean efforts of the storages and mean drives of the memories.
    """

    setup: Setup
    recording: Recording
    program: Program
    theta: Array
    h: Array
    nodes: NDArray[np.int64]
    lead: int
    cycle: int
    rest: float | None
    t: Array
    y: Array
    fine: Array
    u: Array
    states: Array
    efforts: Array

    @property
    def velocity(self) -> Array:
        """(n,) mean flow through the output during the steps [m/s]."""
        return self.efforts[:, self.program.flow]

    @property
    def mid_displacement(self) -> Array:
        """(n,) output state in the middle of the steps."""
        q = self.states[:, self.program.output]
        return 0.5 * (q[1:] + q[:-1])


def simulate(
    setup: Setup,
    recording: Recording,
    substeps: int = 1,
    method: str | None = None,
    initial: Array | None = None,
) -> Trajectory:
    """Simulate a setup on the input of a recording.

    A recording that starts in a steady cycle is led in by one period, in which amplifier and sensor blocks settle; the
    network starts it in the steady state that a settled amplifier brings about (`phnn.integrate.cycle`). Sources are
    silent before the first recorded sample, so that rest and cycle know the recorded input alone.

    Args:
        setup: the model.
        recording: gives input, sampling, start and reconstruction.
        substeps: steps per sample interval.
        method: another reconstruction than the recording's.
        initial: (N,) initial state; without it, the one the recording's start says.

    Raises:
        SolverFailed: no root of the step equation was found, with the time; no steady cycle, with what moves on.
    """
    program = compile_network(setup.network)
    theta = program.theta(setup.network)
    lead, samples = led_in(recording)
    before = input_before(recording, samples)
    counts, fine = _reconstructed(recording, substeps, method or recording.interpolation)
    nodes = np.concatenate([[0], np.cumsum(counts)])
    h, cycle = np.repeat(recording.dt / counts, counts), int(nodes[lead])
    fine, before = amplified(setup, fine, h, before)
    fine = settled(fine, cycle)
    u = np.zeros((fine.shape[0], len(setup.network.ports)))
    u[:, 0] = mean_input(fine)
    for source in setup.sources:
        u[:, place_of(setup, source)] += sounded(setup, source, h, lead * recording.dt)
    rest = None if cycle or initial is not None else float(before)
    x0 = initial
    if x0 is None:
        x0 = _begun(program, setup, u[:cycle], h[:cycle], before, recording.name)
    n = u.shape[0]
    states, efforts = np.empty((n + 1, x0.size)), np.empty((n, x0.size))
    done = kernel.march(program, theta, x0, u, h, states, efforts)
    if done < n:
        raise SolverFailed(
            f"{recording.name}: no solution of the step at t = {h[:done].sum() - lead * recording.dt:.6g} s; "
            "a parameter is probably far from physical: narrow its bounds or use more sub-steps"
        )
    looks, times, samples_of = sensed(setup, nodes, h)
    y = measured(setup, states[looks, program.output], times - lead * recording.dt)[samples_of]
    return Trajectory(
        setup, recording, program, theta, h, nodes, lead, cycle if initial is None else 0, rest, recording.t, y[lead:],
        fine, u, states, efforts,
    )  # fmt: skip


def _begun(program: Program, setup: Setup, u: Array, h: Array, before: float, name: str) -> Array:
    """(N,) the state in which a simulation begins: at rest, or in the steady cycle of a period (n, P), (n,)."""
    if not h.size:
        return equilibrium(program, setup.network, constant(setup, before))
    try:
        x = equilibrium(program, setup.network, constant(setup, before))
    except SolverFailed:
        x = np.zeros(len(program.states))
    try:
        return steady_cycle(program, program.theta(setup.network), x, u, h)
    except SolverFailed as error:
        raise SolverFailed(f"{name}: {error}") from error


def constant(setup: Setup, value: float) -> Array:
    """(P,) a constant input at the first port."""
    values = np.zeros(len(setup.network.ports))
    values[0] = value
    return values


@lru_cache(maxsize=64)
def _reconstructed(recording: Recording, substeps: int, method: str) -> tuple[NDArray[np.int64], Array]:
    """Sub-steps of the intervals and the input on them; kept, because every candidate model sees the same input."""
    lead, samples = led_in(recording)
    counts = substep_counts(samples, input_before(recording, samples), substeps)
    counts[:lead] = counts[lead : 2 * lead]
    fine = substep_input(samples, counts, method)
    fine.flags.writeable = False
    return counts, fine


def led_in(recording: Recording) -> tuple[int, Array]:
    """The input with a period before it where the recording starts in a steady cycle, and how many samples that is."""
    if recording.start.state != "periodic" or recording.period is None:
        return 0, recording.u
    lead = round(recording.period / recording.dt)
    return lead, np.concatenate([recording.u[:lead], recording.u])


def settled(fine: Any, cycle: int) -> Any:
    """(n, 3) what comes out of an amplifier, its transient in the first period replaced by the second."""
    return np.concatenate([fine[cycle : 2 * cycle], fine[cycle:]]) if cycle else fine


def input_before(recording: Recording, samples: Array) -> float:
    """The input before the first sample; the first sample itself where the start does not say."""
    return recording.start.input_before if recording.start.state == "rest" else float(samples[0])
