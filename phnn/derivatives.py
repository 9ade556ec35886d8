"""Exact derivatives of a simulated output by parameters, constant or along a signal, initial states and forces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.integrate import sweep
from phnn.integrate.program import compile_network
from phnn.integrate.rest import equilibrium_derivative, equilibrium_slope
from phnn.integrate.sweep import Integrated, Perturbed, cycle_derivative, without_impulse
from phnn.laws import FACTOR_LAWS, PORT_LAWS
from phnn.laws.namespace import TINY
from phnn.models.actuator import hrc
from phnn.recordings.excitation import made_periodic
from phnn.signals.reconstruct import mean_input
from phnn.trajectory import (
    Trajectory,
    driven,
    driven_changes,
    measured_changes,
    measured_network,
    place_of,
    sensed,
    source_input,
    with_earlier_cycles,
)

Array = NDArray[np.float64]


def output_derivatives(
    trajectory: Trajectory,
    names: Sequence[str],
    initial: Sequence[int] = (),
    forces: Array | None = None,
    varied: Sequence[tuple[str, Array]] = (),
    instants: bool = False,
) -> Array:
    """Return (N, K + G + S + F + W) derivatives of the output.

    Args:
        names: K parameters of the setup.
        instants: whether the G instants of the input's jumps are perturbed; G is 0 otherwise.
        initial: S states whose initial value is perturbed.
        forces: (n, F) perturbations of the junction force, constant within each step.
        varied: W pairs of a network parameter and the (n,) signal by which it is perturbed.
    """
    if trajectory.compiled is None and not (len(names) or instants or forces is not None or varied):
        return _by_start(trajectory, initial)
    setup, program = trajectory.setup, trajectory.program
    network_names = [n for n in names if n in program.names]
    asked = len(network_names)
    network_names += [n for n in dict.fromkeys(n for n, _ in varied) if n not in network_names]
    places = np.array([program.names.index(n) for n in network_names], dtype=np.int64)
    jumps = _by_instants(trajectory) if instants else []
    acting, names = [*_acting(trajectory, names), *jumps], [*names, *(a.name for a in jumps)]
    active = np.concatenate([places, [sweep.carrier(program, a.port) for a in acting]]).astype(np.int64)
    sensor_nodes, times, samples_of = sensed(
        setup, trajectory.recording, trajectory.driving, trajectory.nodes, trajectory.h
    )
    none = np.zeros((trajectory.h.size, 0))
    moved = Perturbed(
        active,
        none if forces is None else np.ascontiguousarray(made_periodic(forces, trajectory.cycle)),
        np.array([network_names.index(n) for n, _ in varied], dtype=np.int64),
        made_periodic(np.column_stack([none, *(w for _, w in varied)]), trajectory.cycle),
        {places.size + j: a.action for j, a in enumerate(acting)},
    )
    start = np.insert(_start_derivative(trajectory, moved, places), [active.size] * len(initial), 0.0, axis=1)
    start[:, places.size : active.size] += np.column_stack([np.zeros((start.shape[0], 0)), *(a.rest for a in acting)])
    wanted, repeated = np.unique(sensor_nodes, return_inverse=True)
    out = sweep.sensitivities(_integrated(trajectory), moved, start, np.array(initial, dtype=np.int64), wanted)
    out = out[repeated]
    changes = out
    if list(names) != network_names or acting:
        head = np.zeros((out.shape[0], len(names)))
        for k, name in enumerate(network_names[:asked]):
            head[:, names.index(name)] = out[:, k]
        for j, a in enumerate(acting):
            head[:, names.index(a.name)] += out[:, places.size + j]
        changes = np.hstack([head, out[:, active.size :]])
    both = np.column_stack([trajectory.states[sensor_nodes, program.output], changes])
    times = times - trajectory.lead * trajectory.recording.dt
    both, times, copied = with_earlier_cycles(setup, both, times, trajectory.run_in, sensor_nodes)
    seen = measured_changes(setup, both[:, 0], times, both[:, 1:], names)
    return seen[copied:][samples_of][trajectory.lead :]


def _by_start(trajectory: Trajectory, initial: Sequence[int]) -> Array:
    """Return (N, S) derivatives of an output by initial states, of a network that torch has solved."""
    from phnn.integrate.differentiable import by_start

    nodes, times, samples_of = sensed(
        trajectory.setup, trajectory.recording, trajectory.driving, trajectory.nodes, trajectory.h
    )
    network = measured_network(trajectory.setup.network, trajectory.recording)
    changes = by_start(
        network, trajectory.states, trajectory.u, trajectory.h, nodes, trajectory.output, trajectory.scheme
    )
    times = times - trajectory.lead * trajectory.recording.dt
    seen = measured_changes(
        trajectory.setup, trajectory.states[nodes, trajectory.output], times, changes[:, list(initial)], ()
    )
    return seen[samples_of][trajectory.lead :]


def _integrated(trajectory: Trajectory) -> Integrated:
    """Return the simulation as the sweeps take it."""
    return Integrated(
        trajectory.program, trajectory.theta, trajectory.states, trajectory.efforts, trajectory.u, trajectory.h
    )


def _start_derivative(trajectory: Trajectory, moved: Perturbed, places: NDArray[np.int64]) -> Array:
    """Return (N, C) derivatives of the initial state; at rest those by the network's parameters alone."""
    n, cycle = trajectory.states.shape[1], trajectory.cycle
    start = np.zeros((n, moved.columns))
    if cycle:
        end = np.empty((n, moved.columns + n))
        march, none = _integrated(trajectory).first(cycle), np.zeros(1, dtype=np.int64)
        sweep.sensitivities(march, moved.first(cycle), start[:, :0], np.arange(n), none, end)
        end = without_impulse(trajectory.program, end, moved.active.size)
        return cycle_derivative(end, moved.active.size, trajectory.states[: cycle + 1])
    if trajectory.rest is not None:
        names = [trajectory.program.names[place] for place in places]
        start[:, : places.size] = equilibrium_derivative(trajectory.setup.network, trajectory.rest, names)
    return start


def input_force(trajectory: Trajectory, change: Array) -> Array:
    """Return (n, …) change of the junction force by a change of the port's input, ``g ψ'(V) δV``."""
    port = trajectory.setup.network.ports[0]
    ((_, ratio),) = port.on.items()
    values = {n: p.value for n, p in trajectory.setup.network.parameters.items()}
    slope = PORT_LAWS[port.law].slope(trajectory.u[:, 0], *(values[n] for n in port.parameters))
    force = (values[ratio] * _factor(trajectory, ratio) if isinstance(ratio, str) else ratio) * np.asarray(slope)
    return force * change if change.ndim == 1 else force[:, None] * change


def _factor(trajectory: Trajectory, ratio: str) -> Array | float:
    """Return (n,) what a ratio is multiplied by during the steps; one where it follows no state."""
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
    """Return the inputs' derivatives by every named parameter of an amplifier block or a source."""
    setup, unmoved = trajectory.setup, np.zeros(trajectory.states.shape[1])
    acting = _by_amplifier(trajectory, names)
    lead = trajectory.lead * trajectory.recording.dt
    for source in setup.sources:
        place = place_of(setup, source)
        for name in (n for n in source.parameters if n in names):
            change = np.imag(source_input(setup, source, trajectory.h, lead, name)) / TINY
            acting.append(_Acting(name, place, _action(trajectory, place, change), unmoved))
    return acting


def _by_amplifier(trajectory: Trajectory, names: Sequence[str]) -> list[_Acting]:
    setup, recording = trajectory.setup, trajectory.recording
    if not any(n in names for b in setup.amplifier for n in b.parameters):
        return []
    command, before = trajectory.driving.fine(recording), recording.input_before
    changes = driven_changes(setup, command, trajectory.h, before, trajectory.run_in, names)
    slope = np.zeros(trajectory.states.shape[1])
    if trajectory.rest is not None and any(b != 0.0 for _, b in changes.values()):
        slope = equilibrium_slope(setup.network, trajectory.rest, 0)
    return [_Acting(n, 0, _action(trajectory, 0, mean_input(c)), slope * b) for n, (c, b) in changes.items()]


def _by_instants(trajectory: Trajectory) -> list[_Acting]:
    """Return derivatives by every instant of the input's jumps: a jump that comes later takes an impulse away."""
    setup, recording = trajectory.setup, trajectory.recording
    command, before = trajectory.driving.fine(recording), recording.input_before
    unmoved = np.zeros(trajectory.states.shape[1])
    acting = []
    for number, slope in enumerate(trajectory.driving.slopes(recording).T):
        fine, _ = driven(setup, command + 1j * TINY * slope[:, None], trajectory.h, before, trajectory.run_in)
        change = _action(trajectory, 0, mean_input(np.imag(fine)) / TINY)
        acting.append(_Acting(f"instant {number}", 0, change, unmoved))
    return acting


def _action(trajectory: Trajectory, place: int, change: Array) -> Array:
    """Return (n, P) ``ψ'(u) δu`` of a change (n,) of one port's input."""
    network = trajectory.setup.network
    port, out = network.ports[place], np.zeros(trajectory.u.shape)
    slope = PORT_LAWS[port.law].slope(trajectory.u[:, place], *(network.parameters[n].value for n in port.parameters))
    out[:, place] = slope * change
    return out


def compile_all() -> None:
    """Compile the forward sensitivities, with arguments of the types that all networks have."""
    network, steps = hrc(1), 4
    program = compile_network(network)
    states, efforts, u = (np.zeros((steps + more, n)) for more, n in ((1, 3), (0, 3), (0, len(network.ports))))
    integrated = Integrated(program, program.theta(network), states, efforts, u, np.full(steps, 1e-5))
    active, none = sweep.by_parameters(np.array([0]), steps), np.zeros(0, dtype=np.int64)
    sweep.sensitivities(integrated, active, np.zeros((3, 1)), none, np.arange(steps + 1))
