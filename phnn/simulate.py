"""Simulate a setup on a recording, with exact derivatives of the output.

recorded input → reconstruction → amplifier → network (compiled march) → sensor → output
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.chain.passage import amplified, measured, measured_changes, place_of, sensed, sounded
from phnn.errors import SolverFailed
from phnn.integrate import kernel, sweep
from phnn.integrate.program import Program, compile_network
from phnn.integrate.rest import equilibrium, equilibrium_derivative, equilibrium_slope
from phnn.laws import FACTOR_LAWS, PORT_LAWS
from phnn.laws.namespace import TINY
from phnn.recordings.recording import Recording
from phnn.setup import Block, Setup
from phnn.signals.reconstruct import mean_input, substep_counts, substep_input

Array = NDArray[np.float64]

SPIN_UP_PERIODS = 3


@dataclass(frozen=True)
class Trajectory:
    """A simulated recording: ``N`` samples and ``n`` steps, those of a spin-up among them.

    Attributes:
        setup, recording, program, theta: what was simulated.
        h: (n,) steps [s].
        nodes: (N + lead,) step index of every sample.
        lead: spin-up samples before the first recorded one.
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

    Sources are silent before the first recorded sample, so that rest and spin-up know the recorded input alone; sensor
    blocks act during the spin-up too.

    Args:
        setup: the model.
        recording: gives input, sampling, start and reconstruction.
        substeps: steps per sample interval.
        method: another reconstruction than the recording's.
        initial: (N,) initial state; without it, the one the recording's start says.

    Raises:
        SolverFailed: no root of the step equation was found, with the time.
    """
    program = compile_network(setup.network)
    theta = program.theta(setup.network)
    lead, samples = _with_spin_up(recording)
    before = input_before(recording, samples)
    counts, fine = _reconstructed(recording, substeps, method or recording.interpolation)
    nodes = np.concatenate([[0], np.cumsum(counts)])
    h = np.repeat(recording.dt / counts, counts)
    fine, before = amplified(setup, fine, h, before)
    u = np.zeros((fine.shape[0], len(setup.network.ports)))
    u[:, 0] = mean_input(fine)
    for source in setup.sources:
        u[:, place_of(setup, source)] += sounded(setup, source, h, lead * recording.dt)
    rest = float(before) if initial is None else None
    x0 = equilibrium(program, setup.network, _constant(u, before)) if initial is None else initial
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
        setup, recording, program, theta, h, nodes, lead, rest, recording.t, y[lead:], fine, u, states, efforts
    )


def _constant(u: Array, voltage: float) -> Array:
    """(P,) a constant input at the first port."""
    values = np.zeros(u.shape[1])
    values[0] = voltage
    return values


@lru_cache(maxsize=64)
def _reconstructed(recording: Recording, substeps: int, method: str) -> tuple[NDArray[np.int64], Array]:
    """Sub-steps of the intervals and the input on them; kept, because every candidate model sees the same input."""
    _, samples = _with_spin_up(recording)
    counts = substep_counts(samples, input_before(recording, samples), substeps)
    fine = substep_input(samples, counts, method)
    fine.flags.writeable = False
    return counts, fine


def _with_spin_up(recording: Recording) -> tuple[int, Array]:
    """The input with a few periods before it where the recording starts in a steady cycle."""
    if recording.start.state != "periodic" or recording.period is None:
        return 0, recording.u
    one = round(recording.period / recording.dt)
    lead = SPIN_UP_PERIODS * one
    return lead, np.concatenate([np.tile(recording.u[:one], SPIN_UP_PERIODS), recording.u])


def input_before(recording: Recording, samples: Array) -> float:
    """The input before the first sample; the first sample itself where the start does not say."""
    return recording.start.input_before if recording.start.state == "rest" else float(samples[0])


def output_derivatives(
    trajectory: Trajectory,
    names: Sequence[str],
    initial: Sequence[int] = (),
    forces: Array | None = None,
    varied: Sequence[tuple[str, Array]] = (),
) -> Array:
    """(N, K + S + F + W) derivatives of the output.

    Args:
        names: K parameters of the setup.
        initial: S states whose initial value is perturbed.
        forces: (n, F) perturbations of the junction force, constant within each step.
        varied: W pairs of a network parameter and the (n,) signal by which it is perturbed.
    """
    setup, program = trajectory.setup, trajectory.program
    network_names = [n for n in names if n in program.names]
    asked = len(network_names)
    network_names += [n for n in dict.fromkeys(n for n, _ in varied) if n not in network_names]
    places = np.array([program.names.index(n) for n in network_names], dtype=np.int64)
    acting = _acting(trajectory, names)
    active = np.concatenate([places, [sweep.carrier(program, a.port) for a in acting]]).astype(np.int64)
    steps = trajectory.u.shape[0]
    looks, times, samples_of = sensed(setup, trajectory.nodes, trajectory.h)
    given = np.zeros((steps, 0)) if forces is None else np.ascontiguousarray(forces)
    signals = np.column_stack([w for _, w in varied]) if varied else np.zeros((steps, 0))
    start = np.zeros((trajectory.states.shape[1], places.size))
    if trajectory.rest is not None:
        start = equilibrium_derivative(program, setup.network, _constant(trajectory.u, trajectory.rest), places)
    out = sweep.sensitivities(
        program, trajectory.theta, active, trajectory.states, trajectory.efforts, trajectory.u, trajectory.h,
        np.hstack([start, *(a.rest[:, None] for a in acting)]), np.array(initial, dtype=np.int64), given,
        np.array([network_names.index(n) for n, _ in varied], dtype=np.int64), np.ascontiguousarray(signals),
        looks, {places.size + j: a.action for j, a in enumerate(acting)},
    )  # fmt: skip
    changes = out
    if list(names) != network_names or acting:
        head = np.zeros((out.shape[0], len(names)))
        for k, name in enumerate(network_names[:asked]):
            head[:, names.index(name)] = out[:, k]
        for j, a in enumerate(acting):
            head[:, names.index(a.name)] += out[:, places.size + j]
        changes = np.hstack([head, out[:, active.size :]])
    q, times = trajectory.states[looks, program.output], times - trajectory.lead * trajectory.recording.dt
    return measured_changes(setup, q, times, changes, names)[samples_of][trajectory.lead :]


def output_gradient(trajectory: Trajectory, names: Sequence[str], cotangent: Array) -> Array:
    """(K,) derivative of ``Σ_n c_n q_n`` by network parameters, by one backward sweep whatever their number.

    Args:
        names: K parameters of the network.
        cotangent: (N,) ``c``, of the samples of the measured state.
    """
    program = trajectory.program
    places = np.array([program.names.index(n) for n in names], dtype=np.int64)
    along = np.zeros_like(trajectory.states)
    along[trajectory.nodes[trajectory.lead :], program.output] = cotangent
    gradient, back = sweep.adjoint(
        program, trajectory.theta, places, trajectory.states, trajectory.efforts, trajectory.u, trajectory.h, along
    )
    if trajectory.rest is None:
        return gradient
    voltage = _constant(trajectory.u, trajectory.rest)
    return gradient + (back + along[0]) @ equilibrium_derivative(program, trajectory.setup.network, voltage, places)


def input_force(trajectory: Trajectory, change: Array) -> Array:
    """(n, …) change of the junction force by a change of the port's input, ``g ψ'(V) δV``."""
    port = trajectory.setup.network.ports[0]
    ((_, ratio),) = port.on.items()
    values = {n: p.value for n, p in trajectory.setup.network.parameters.items()}
    slope = PORT_LAWS[port.law].slope(trajectory.u[:, 0], *(values[n] for n in port.parameters))
    force = (values[ratio] * _factor(trajectory, ratio) if isinstance(ratio, str) else ratio) * np.asarray(slope)
    return force * change if change.ndim == 1 else force[:, None] * change


def _factor(trajectory: Trajectory, ratio: str) -> Array | float:
    """(n,) what a ratio is multiplied by during the steps; one where it follows no state."""
    network, states = trajectory.setup.network, trajectory.states
    total: Array | float = 1.0
    for m in network.modulations:
        if m.ratio == ratio:
            k = trajectory.program.states.index(m.by)
            read = 0.5 * (states[:-1, k] + states[1:, k]) if m.by in network.storage_names else states[:-1, k]
            values = (network.parameters[n].value for n in m.parameters)
            total = total * np.asarray(FACTOR_LAWS[m.law].factor(read, *values))
    return total


class _Acting(NamedTuple):
    """What a parameter of an amplifier block or a source changes.

    Attributes:
        name: of the parameter.
        port: which port it acts through.
        action: (n, P) change of what the ports make of their inputs.
        rest: (N,) change of the state at rest.
    """

    name: str
    port: int
    action: Array
    rest: Array


def _acting(trajectory: Trajectory, names: Sequence[str]) -> list[_Acting]:
    """By every named parameter of an amplifier block or a source."""
    setup, unmoved = trajectory.setup, np.zeros(trajectory.states.shape[1])
    found = [_by_amplifier(trajectory, b, n) for b in setup.amplifier for n in b.parameters if n in names]
    lead = trajectory.lead * trajectory.recording.dt
    for source in setup.sources:
        place = place_of(setup, source)
        for name in (n for n in source.parameters if n in names):
            change = np.imag(sounded(setup, source, trajectory.h, lead, name)) / TINY
            found.append(_Acting(name, place, _action(trajectory, place, change), unmoved))
    return found


def _by_amplifier(trajectory: Trajectory, block: Block, name: str) -> _Acting:
    setup, recording = trajectory.setup, trajectory.recording
    _, samples = _with_spin_up(recording)
    command = substep_input(samples, np.diff(trajectory.nodes), recording.interpolation)
    fine, before = amplified(setup, command, trajectory.h, input_before(recording, samples), (block, name))
    rest = np.zeros(trajectory.states.shape[1])
    if trajectory.rest is not None and np.imag(before) != 0.0:
        voltage = _constant(trajectory.u, trajectory.rest)
        rest = equilibrium_slope(trajectory.program, setup.network, voltage, 0) * (np.imag(before) / TINY)
    return _Acting(name, 0, _action(trajectory, 0, mean_input(np.imag(fine)) / TINY), rest)


def _action(trajectory: Trajectory, place: int, change: Array) -> Array:
    """(n, P) ``ψ'(u) δu`` of a change (n,) of one port's input."""
    network = trajectory.setup.network
    port, out = network.ports[place], np.zeros(trajectory.u.shape)
    slope = PORT_LAWS[port.law].slope(trajectory.u[:, place], *(network.parameters[n].value for n in port.parameters))
    out[:, place] = slope * change
    return out
