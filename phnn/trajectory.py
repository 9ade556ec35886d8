"""Simulate a setup on a recording.

recorded input → reconstruction → amplifier → network (compiled kernel) → sensor → output

The first part takes signals through the measuring chain, with their derivatives by its parameters. What is stated of a
recording's sensor and input becomes blocks of the chain with fixed parameters (`sensing`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.chain import AMPLIFIERS, SENSORS, SOURCES
from phnn.chain.amplifiers import rate
from phnn.errors import InputRefused, SolverFailed, StructureViolated
from phnn.integrate import kernel
from phnn.integrate.program import Program, compile_network
from phnn.integrate.rest import equilibrium
from phnn.integrate.scheme import Scheme
from phnn.integrate.sweep import steady_cycle
from phnn.laws.namespace import TINY
from phnn.laws.wide import has_kernel
from phnn.network.bondgraph.description import integral_unit
from phnn.network.elements import Network
from phnn.parameters import as_table, constant
from phnn.recordings.excitation import Driving, driving_of, made_periodic
from phnn.recordings.recording import Recording
from phnn.recordings.units import times_of_seconds
from phnn.setup import Block, Setup, Source
from phnn.signals.reconstruct import mean_input

Array = NDArray[np.float64]

_LAG = "tau_sensor"
_RATE = Block("rate")


def sensing(setup: Setup, recording: Recording) -> Setup:
    """Return the setup with the known sensor of a recording between the network and its other sensor blocks.

    The sensor belongs to the recording: one model serves recordings by several sensors. So does an input that is the
    displacement of a motion of which the network takes the velocity: its rate then drives the network.
    """
    setup, sensor = _moved(setup, recording), recording.sensor
    blocks = (
        *((_RATE,) if setup.network.senses and not recording.measures else ()),
        *((_RATE,) * sensor.derivative),
        *((Block("lag", (_LAG,)),) if sensor.lag else ()),
        *((Block("rectification"),) if sensor.rectified else ()),
    )
    if not blocks or setup.sensor[: len(blocks)] == blocks:
        return setup
    known = (constant(_LAG, sensor.lag, "s", "time constant of the sensor, as stated"),) if sensor.lag else ()
    return replace(
        setup,
        sensor=(*blocks, *setup.sensor),
        block_parameters=as_table((*(setup.block_parameters or {}).values(), *known)),
    )


def is_displacement(setup: Setup, recording: Recording) -> bool:
    """Return whether the recorded input is the integral over time of what the first port takes, by their units."""
    port = next(iter(setup.network.ports), None)
    return port is not None and recording.units.input == integral_unit(port.unit) != "1"


def _moved(setup: Setup, recording: Recording) -> Setup:
    """Return the setup with the rate of a recorded displacement before its other amplifier blocks, behind a play.

    Raises:
        InputRefused: the displacement is said to be held between the samples, and a jump has no rate; a play is asked
            for where the velocity was recorded.
    """
    plays = tuple(b for b in setup.amplifier if b.kind == "play")
    if _RATE in setup.amplifier:
        return setup
    if not is_displacement(setup, recording):
        if plays and setup.network.senses:
            raise InputRefused(
                f"{recording.source}: the input is a velocity, and a play needs the displacement of the motion: give "
                "that column as input, or a model without play"
            )
        return setup
    if recording.interpolation == "zero_order":
        raise InputRefused(
            f"{recording.source}: input: zero_order: a displacement that is held and jumps has no velocity: "
            f"write input: cubic or linear in recordings.yaml"
        )
    return replace(setup, amplifier=(*plays, _RATE, *(b for b in setup.amplifier if b not in plays)))


def _through(block: Block, fine: Any, h: Array, before: Any, values: Sequence[Any]) -> tuple[Any, Any]:
    law = AMPLIFIERS[block.kind].law
    return law(fine, h, before, *values), law(np.full((1, 3), before), np.ones(1), before, *values)[0, 0]


def _change(moved: tuple[Any, Any]) -> tuple[Array, float]:
    return np.imag(moved[0]) / TINY, float(np.imag(moved[1])) / TINY


def place_of(setup: Setup, source: Source) -> int:
    """Return which port of the network a source acts on."""
    return [p.name for p in setup.network.ports].index(source.port)


def source_input(setup: Setup, source: Source, h: Array, lead: float, perturbed: str = "") -> Any:
    """Return (n,) means of a source over the steps ``h`` (n,).

    Args:
        lead: duration [s] of a run-in, during which sources are silent.
        perturbed: a parameter that takes a complex step; the result is complex then.
    """
    starts = np.concatenate([[0.0], np.cumsum(h)[:-1]]) - lead
    times = starts[:, None] + h[:, None] * np.array([0.0, 0.5, 1.0])
    means = mean_input(SOURCES[source.kind].law(times, *_values(setup, source, perturbed)))
    return np.where(times[:, 1] > 0.0, means, 0.0)


def sensed(
    setup: Setup, recording: Recording, driving: Driving, nodes: NDArray[np.int64], h: Array
) -> tuple[NDArray[np.int64], Array, NDArray[np.int64] | slice]:
    """Return the nodes where the sensor is evaluated, their times [s] from the first node, and the samples among them.

    If a block has a state, these are the nodes of all steps, as fast motion between two samples changes that state.
    Otherwise they are the nodes of the samples. A node at which an imposed flow jumps is there twice, and its sample
    is the one on its side of the jump: the effort jumps too.

    Args:
        nodes: of the samples; h: (n,) steps.
    """
    times = np.concatenate([[0.0], np.cumsum(h)])
    if not any(SENSORS[b.kind].remembers for b in setup.sensor):
        return nodes, times[nodes], slice(None)
    at, after = _beside_jumps(setup, recording, driving)
    every, places = np.sort(np.concatenate([np.arange(times.size), nodes[at]])), nodes.copy()
    places += np.searchsorted(nodes[at], nodes)
    places[at[after]] += 1
    return every, times[every], places


def _beside_jumps(setup: Setup, recording: Recording, driving: Driving) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return (M,) the samples next to a jump of an imposed flow, and whether each lies behind it; none where a further
    block of the sensor has a state, which asks for times that differ."""
    plain = setup.network.senses and not any(SENSORS[b.kind].remembers for b in setup.sensor[1:])
    u = driving.command.u
    if not plain or is_displacement(setup, recording):
        return np.zeros(0, np.int64), np.zeros(0, bool)
    if recording.interpolation == "zero_order":
        held = np.flatnonzero(np.diff(u)) + 1
        at, after = held, np.ones(held.size, bool)
    else:
        jumps = driving.command.breaks.jumps
        at, after = np.concatenate([jumps - 1, jumps]), np.repeat([False, True], jumps.size)
    inside = (at > 0) & (at < u.size - 1) & (np.bincount(at, minlength=u.size)[at] == 1)
    order = np.argsort(at[inside])
    return at[inside][order], after[inside][order]


def measured(setup: Setup, q: Array, times: Array) -> Array:
    """Return (N,) what the sensor makes of the network's output at the samples."""
    for block in setup.sensor:
        q = SENSORS[block.kind].law(q, times, *_values(setup, block))
    return q


def measured_changes(setup: Setup, q: Array, times: Array, changes: Array, names: Sequence[str]) -> Array:
    """Return (N, M) changes of the sensor's output by those of the network's, and by the sensor's own parameters.

    Args:
        q: (N,) the network's output at the samples, of the times ``times`` (N,).
        names: parameters whose changes the first columns are; those of a sensor block are added to theirs.
    """
    y, times = q[:, None], times[:, None]
    for block in setup.sensor:
        kind, values = SENSORS[block.kind], _values(setup, block)
        law = kind.law
        direct = {n: np.imag(law(y, times, *_values(setup, block, n))) / TINY for n in block.parameters if n in names}
        if kind.linear:
            changes = law(changes, times, *values)
        elif not kind.remembers:
            changes = changes * (np.imag(law(y + 1j * TINY, times, *values)) / TINY)
        else:
            changes = np.imag(law(y + 1j * TINY * changes, times, *values)) / TINY
        for name, change in direct.items():
            changes[:, names.index(name)] += change[:, 0]
        y = law(y, times, *values)
    return changes


def _values(setup: Setup, block: Block | Source, perturbed: str = "") -> list[Any]:
    """Return the values of the parameters of a block or source, one of them with a complex step."""
    values = [setup.parameters[p].value for p in block.parameters]
    return [complex(v, TINY) if p == perturbed else v for p, v in zip(block.parameters, values, strict=True)]


# Further cycles in which amplifier and sensor blocks settle: those of the sensor carry all derivatives.
_AMPLIFIED, _SENSED = 16, 4


@dataclass(frozen=True)
class Trajectory:
    """A simulated recording: ``N`` samples and ``n`` steps, those of a run-in among them.

    Attributes:
        setup, recording, scheme, compiled, theta: what was simulated; ``compiled`` is None where torch took the steps.
        driving: the recorded input on the steps.
        h: (n,) steps [s].
        nodes: (N + lead,) step index of every sample.
        lead: samples before the first recorded one, see `phnn.recordings.excitation.Driving`.
        run_in: steps of them that belong to a steady cycle.
        cycle: steps of that cycle, in whose steady state the simulation starts; 0 where it starts otherwise.
        rest: (P,) inputs whose equilibrium the simulation starts from; None where it starts otherwise.
        t: (N,) time of the samples [s].
        y: (N,) sensor output without the displacement zero.
        fine: (n, 3) port input within the steps; u: (n, P) mean inputs.
        states: (n+1, N) states at the nodes, in the order of the network.
        efforts: (n, N) mean efforts of the storages and mean drives of the modulator states.
    """

    setup: Setup
    recording: Recording
    scheme: Scheme
    compiled: Program | None
    theta: Array
    driving: Driving
    h: Array
    nodes: NDArray[np.int64]
    lead: int
    run_in: int
    cycle: int
    rest: Array | None
    t: Array
    y: Array
    fine: Array
    u: Array
    states: Array
    efforts: Array

    @property
    def program(self) -> Program:
        """Return the compiled network.

        Raises:
            StructureViolated: a law has no kernel; names it.
        """
        return self.compiled or compile_network(measured_network(self.setup.network, self.recording))

    @property
    def travel(self) -> int:
        """Return the number of the state of an imposed motion, −1 without one."""
        return -1 if self.compiled is None else self.compiled.travel

    @property
    def output(self) -> int:
        """Return the number of the measured state."""
        network = measured_network(self.setup.network, self.recording)
        return network.state_names.index(network.output)

    @property
    def velocity(self) -> Array:
        """Return (n,) mean rate of the output in the steps [m/s]: its flow, or the change of an undriven storage."""
        try:
            return self.efforts[:, self.program.flow]
        except StructureViolated:
            return np.diff(self.states[:, self.output]) / self.h

    @property
    def signal(self) -> Array:
        """Return (n+1,) what the sensor is given at the nodes: the output state, or the force of an imposed motion."""
        x = self.states[:, self.output]
        return rate(x, np.append(0.0, np.cumsum(self.h))) if self.travel >= 0 else x

    @property
    def mid_displacement(self) -> Array:
        """Return (n,) displacement in the middle of the steps: the output state, or that of an imposed motion."""
        q = self.states[:, self.output if self.travel < 0 else self.travel]
        return 0.5 * (q[1:] + q[:-1])


def simulate(
    setup: Setup,
    recording: Recording,
    substeps: int = 1,
    method: str | None = None,
    initial: Array | None = None,
    scheme: Scheme = Scheme.DISCRETE_GRADIENT,
) -> Trajectory:
    """Simulate a setup on the input of a recording.

    A recording that starts in a steady cycle is led in by one cycle, the fewest periods that are whole samples. The
    network starts it in the steady state (`phnn.integrate.sweep`) that an amplifier brings about, itself in equilibrium
    further cycles, and so does the sensor. Sources are silent before the first recorded sample, so that rest and cycle
    know the recorded input alone. Torch solves the steps of networks with a law that has no kernel.

    Args:
        setup: the model.
        recording: gives input, sampling, start and reconstruction.
        substeps: steps per sample interval.
        method: another reconstruction than the recording's.
        initial: (N,) initial state; without it, the one the recording's start says.
        scheme: the discretisation of the steps.

    Raises:
        SolverFailed: no root of the step equation was found, with the time; no steady cycle, with what moves on.
    """
    setup = sensing(setup, recording)
    network = measured_network(setup.network, recording)
    # The start and the force of an imposed motion are the kernel's alone.
    kernels = bool(network.senses) or all(has_kernel(one.element.law) for one in network.with_laws())
    program = compile_network(network, scheme) if kernels else None
    theta = np.zeros(0) if program is None else program.theta(network)
    driving = driving_of(recording, substeps, method)
    lead, nodes = driving.lead, np.concatenate([[0], np.cumsum(driving.counts)])
    h = np.repeat(recording.dt * driving.lengths / driving.counts, driving.counts)
    run_in = int(nodes[recording.cycle])
    fine, u, held = _port_inputs(setup, network, recording, driving, h, run_in)
    cycle = run_in if initial is None else 0
    x0 = _at_rest(network, held, cycle) if initial is None else initial
    before = lead * recording.dt
    if program is None:
        from phnn.integrate.differentiable import integrated

        states, efforts = integrated(network, x0, u, h, cycle, scheme, -before)
    else:
        if initial is None and program.travel >= 0 and is_displacement(setup, recording):
            x0[program.travel] = driving.fine(recording)[0, 0]
        if cycle:
            try:
                x0 = steady_cycle(program, theta, x0, u[:cycle], h[:cycle])
            except SolverFailed as error:
                raise SolverFailed(f"{recording.name}: {error}") from error
        states, efforts = np.empty((h.size + 1, x0.size)), np.empty((h.size, x0.size))
        done = kernel.march(program, theta, x0, u, h, states, efforts)
        if done < h.size:
            raise SolverFailed(
                f"{recording.name}: no solution of the step at t = {h[:done].sum() - before:.6g} s; "
                "a parameter is probably far from physical: narrow its bounds or use more sub-steps"
            )
    sensor_nodes, times, samples_of = sensed(setup, recording, driving, nodes, h)
    q = states[sensor_nodes, network.state_names.index(network.output)]
    q, times, copied = with_earlier_cycles(setup, q, times - before, run_in, sensor_nodes)
    y = measured(setup, q, times)[copied:][samples_of]
    return Trajectory(
        setup, recording, scheme, program, theta, driving, h, nodes, lead, run_in, cycle,
        None if run_in or initial is not None else held, recording.t, y[lead:], fine, u, states, efforts,
    )  # fmt: skip


def _port_inputs(
    setup: Setup, network: Network, recording: Recording, driving: Driving, h: Array, cycle: int
) -> tuple[Array, Array, Array]:
    """Return the first port's input (n, 3), the means of all ports (n, P), and their inputs before (P,)."""
    fine, before = driven(setup, driving.fine(recording), h, recording.input_before, cycle)
    u, held = np.zeros((fine.shape[0], len(network.ports))), np.zeros(len(network.ports))
    places = [0, *map([p.name for p in network.ports].index, recording.further)]
    u[:, places] = np.column_stack([mean_input(fine), made_periodic(driving.further, cycle)])
    held[places] = [before, *(x[0] for x in recording.further.values())]
    for source in setup.sources:
        u[:, place_of(setup, source)] += source_input(setup, source, h, driving.lead * recording.dt)
    return fine, u, held


def _at_rest(network: Network, held: Array, cycle: int) -> Array:
    """Return (N,) steady state under inputs (P,); without one a cycle is looked for from zero."""
    try:
        return equilibrium(network, held)
    except SolverFailed:
        if not cycle:
            raise
        return np.zeros(len(network.state_names))


def measured_network(network: Network, recording: Recording) -> Network:
    """Return the network with what a recording measures as its output."""
    return replace(network, output=recording.measures, senses="") if recording.measures else network


def check_names(network: Network, recordings: Sequence[Recording]) -> None:
    """Refuse recordings of ports or storages that a network does not have.

    Raises:
        InputRefused: names it, and those that there are.
    """
    ports = [p.name for p in network.ports][1:]
    for recording in recordings:
        for key, names, known in (
            ("ports", list(recording.further), ports),
            ("outputs", [recording.measures] if recording.measures else [], network.storage_names),
        ):
            strange = [n for n in names if n not in known]
            if strange:
                raise InputRefused(
                    f"{recording.source}: {key}: the network has no {strange[0]!r}; it has "
                    f"{', '.join(known) or 'none beside its first port'}: correct recordings.yaml"
                )
        if np.isfinite(recording.y).all():
            _check_dimension(network, recording)


# What a sensor may measure of an output, in powers of time.
_REMEDIES = {-1: "sensor: {derivative: true}", -2: "sensor: {second_derivative: true}"}


def _check_dimension(network: Network, recording: Recording) -> None:
    """Refuse an output whose unit is not that of what the network gives. Numbers without a unit may be anything."""
    measured, derivative = measured_network(network, recording), recording.sensor.derivative
    units = {s.name: s.unit for s in measured.storages}
    orders = derivative + bool(measured.senses)
    recorded, unit = recording.units.output, units[measured.output]
    order = times_of_seconds(recorded, unit)
    if order == -orders or recorded == "1" or unit in ("", "1"):
        return
    what = f"the effort at {measured.senses}" if measured.senses else f"its output {measured.output}"
    if order is not None and not measured.senses and order in _REMEDIES:
        remedy = f"if the column is right, say {_REMEDIES[order]}"
    else:
        others = [n for n, u in units.items() if times_of_seconds(recorded, u) == 0 and n != measured.output]
        kind = f"name another output, such as `output: {others[0]}` in the network" if others else "correct the column"
        remedy = f"{kind}, or take a source of flow as the output where its effort was measured"
    per = {0: "", 1: " per second", 2: " per second squared"}.get(orders, "")
    raise InputRefused(
        f"{recording.source}: the output column is in {recorded}, but {what} in the network is in {unit}{per}: {remedy}"
    )


def driven(setup: Setup, fine: Any, h: Array, before: Any, cycle: int) -> tuple[Any, Any]:
    """Return the voltage (n, 3) behind all amplifier blocks, periodic if there is a cycle, and the one before.

    Args:
        fine: (n, 3) command at the start, middle and end of the steps ``h`` (n,).
        before: the constant command before them, under which all blocks are in equilibrium.
    """
    fine, h, first = _with_run_in(setup, fine, h, cycle)
    for block in setup.amplifier:
        fine, before = _through(block, fine, h, before, _values(setup, block))
    return made_periodic(fine[first:], cycle), before


def driven_changes(
    setup: Setup, fine: Array, h: Array, before: float, cycle: int, names: Sequence[str]
) -> dict[str, tuple[Array, float]]:
    """Return changes of the same by the named parameters of the blocks."""
    fine, h, first = _with_run_in(setup, fine, h, cycle)
    changes: dict[str, tuple[Array, float]] = {}
    for block in setup.amplifier:
        values = _values(setup, block)
        if changes and not AMPLIFIERS[block.kind].remembers:
            slope, earlier = _change(_through(block, fine + 1j * TINY, h, before + 1j * TINY, values))
            changes = {n: (slope * c, earlier * b) for n, (c, b) in changes.items()}
        else:
            moved = {n: (fine + 1j * TINY * c, before + 1j * TINY * b) for n, (c, b) in changes.items()}
            changes = {n: _change(_through(block, f, h, b, values)) for n, (f, b) in moved.items()}
        for n in (n for n in block.parameters if n in names):
            direct, known = _change(_through(block, fine, h, before, _values(setup, block, n))), changes.get(n)
            changes[n] = direct if known is None else (direct[0] + known[0], direct[1] + known[1])
        fine, before = _through(block, fine, h, before, values)
    return {n: (made_periodic(c[first:], cycle), b) for n, (c, b) in changes.items()}


def _with_run_in(setup: Setup, fine: Any, h: Array, cycle: int) -> tuple[Any, Array, int]:
    """Return the command behind cycles in which the blocks come to theirs, its steps, and how many are of these."""
    copies = _AMPLIFIED if cycle and setup.amplifier else 0
    longer = np.concatenate([*[made_periodic(fine, cycle)[:cycle]] * copies, fine])
    return longer, np.concatenate([*[h[:cycle]] * copies, h]), copies * cycle


def with_earlier_cycles(
    setup: Setup, q: Array, times: Array, cycle: int, sensor_nodes: NDArray[np.int64]
) -> tuple[Array, Array, int]:
    """Prepend earlier cycles to the sensor's input if a block of the sensor has a state.

    Args:
        q: (M, …) the network's output at ``sensor_nodes`` (M,) and ``times`` (M,) [s].

    Returns:
        The longer output and times, and how many entries were prepended.
    """
    first = (
        int(np.searchsorted(sensor_nodes, cycle))
        if cycle and any(SENSORS[b.kind].remembers for b in setup.sensor)
        else 0
    )
    if not first:
        return q, times, 0
    duration = times[first] - times[0]
    before = [times[:first] - k * duration for k in range(_SENSED, 0, -1)]
    return np.concatenate([*[q[:first]] * _SENSED, q]), np.concatenate([*before, times]), _SENSED * first
