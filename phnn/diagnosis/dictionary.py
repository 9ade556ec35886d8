"""Dictionaries of generic local functions: what a missing element at a location could do, without naming any.

Every group belongs to a location and a detail. Its functions use only variables that are local to it (powers of
``q`` at a spring, functions of ``v`` at a damper, …), evaluated on the simulated base trajectory. They enter as
a force on the junction, as a change of the port's voltage, or at the output.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.diagnosis.filters import (
    integral_while_within,
    low_pass,
    play_operator,
    rate,
    rate_limited,
    resonator,
    stop_operator,
)
from phnn.effects import Kind, Scales, kinds
from phnn.network.elements import Network
from phnn.network.roles import capacitances, charges, dampings, hysterons, ratios, thresholds
from phnn.recordings.driving import input_before
from phnn.simulate import Trajectory

Array = NDArray[np.float64]

# Damping ratio of modes at the peaks of the residual's spectrum.
_RATIO = 0.01
FORCE, VOLTAGE, OUTPUT, PARAMETER = "force", "voltage", "output", "parameter"


@dataclass(frozen=True)
class Group:
    """Local functions of one kind.

    Attributes:
        kind: which kind of element, and at which location.
        enters: `FORCE`, `VOLTAGE` or `OUTPUT`; or `PARAMETER`: the functions scale the parameters that ``varies`` finds
            in a network, as a law or a transformer that is modulated would.
        functions: ``(trajectory, scales) -> (n or N, F)``; zero for zero motion.
        axis: name of the variable against which the learned function is drawn, with its unit; empty where the
            functions have memory and no static picture.
        static: ``x -> (len(x), F)`` the same functions of the axis variable alone.
        searched: the functions take frequencies from the residual itself: they tell where something is, not whether.
    """

    kind: Kind
    enters: str
    functions: Callable[[Trajectory, Scales], Array]
    axis: str = ""
    static: Callable[[Array, Scales], Array] | None = None
    varies: Callable[[Network], list[str]] | None = None
    searched: bool = False

    @property
    def location(self) -> str:
        """Canonical location."""
        return self.kind.location

    @property
    def detail(self) -> str:
        """Name of the kind of element."""
        return self.kind.name

    def varied(self, network: Network) -> list[str]:
        """Names of the parameters that its functions scale in a network."""
        return self.varies(network) if self.varies is not None else []


def _elastic(q: Array, scales: Scales) -> Array:
    s = q / scales.displacement
    ramps = [np.maximum(side * s - c, 0.0) for side in (1.0, -1.0) for c in (0.0, 0.25, 0.5, 0.7, 0.85)]
    return np.column_stack([s**2, s**3, s**5, *ramps])


def _dissipative(v: Array, scales: Scales) -> Array:
    w = v / scales.velocity
    slow = scales.slowest / scales.fastest
    speeds = (0.03 * slow, 0.3 * slow, 0.03, 0.3)
    return np.column_stack([*(np.tanh(w / c) for c in speeds), np.abs(w) * w, w**3])


def _memory_times(scales: Scales) -> Array:
    return np.geomspace(0.1 / scales.fastest, scales.duration, 8)


def _memory(trajectory: Trajectory, scales: Scales) -> Array:
    s = trajectory.mid_displacement / scales.displacement
    return np.column_stack([s - low_pass(s, trajectory.h, t, float(s[0])) for t in _memory_times(scales)])


def _after_a_step(t: Array, scales: Scales) -> Array:
    return np.column_stack([np.exp(-t / tau) for tau in _memory_times(scales)])


def _modes(trajectory: Trajectory, scales: Scales) -> Array:
    a = _acceleration(trajectory, scales)
    times = 1.0 / (2.0 * np.pi * scales.fastest * np.array([3.0, 10.0]))
    filtered = [low_pass(low_pass(a, trajectory.h, t, 0.0), trajectory.h, t, 0.0) for t in times]
    return np.column_stack([a, *filtered])


def _ringing(trajectory: Trajectory, scales: Scales) -> Array:
    a = _acceleration(trajectory, scales)
    found = [resonator(a, trajectory.h, f, _RATIO) for f in scales.peaks]
    return np.column_stack(found) if found else np.zeros((a.size, 0))


def _acceleration(trajectory: Trajectory, scales: Scales) -> Array:
    return rate(trajectory.velocity, trajectory.h) / (scales.velocity * scales.fastest)


def _by_displacement(q: Array, scales: Scales) -> Array:
    s = q / scales.displacement
    return np.column_stack([s, s**2])


def _by_speed(v: Array, scales: Scales) -> Array:
    w = np.abs(v) / scales.velocity
    return np.column_stack([w, w / (w + 0.05)])


def _hysteron(trajectory: Trajectory, scales: Scales) -> Array:
    s = trajectory.mid_displacement / scales.displacement
    radii = (0.01, 0.03, 0.06, 0.12, 0.25, 0.5)
    stops = [stop_operator(s, r) for r in radii]
    leaves = [trajectory.efforts[:, i] / scales.voltage for i in _electrical_leaves(trajectory)]
    return np.column_stack([*stops, *leaves])


def _leakage(trajectory: Trajectory, scales: Scales) -> Array:
    times = np.geomspace(1.0 / scales.fastest, scales.duration, 4)
    network, h = trajectory.setup.network, trajectory.h
    widths = {n: network.parameters[r.parameters[1]].value for r in hysterons(network) for n in r.on}
    columns = []
    for i in _electrical_leaves(trajectory):
        e = trajectory.efforts[:, i] / scales.voltage
        columns += [low_pass(e, h, t, float(e[0])) for t in times]
        # What leaked away while a hysteron held is made up for as soon as it gives way.
        limit = widths.get(network.storages[i].name, np.inf) / scales.voltage
        columns.append(integral_while_within(e, h, limit) / scales.duration)
    return np.column_stack(columns) if columns else np.zeros((trajectory.velocity.size, 0))


def _by_charge(trajectory: Trajectory, scales: Scales) -> Array:
    return np.asarray((trajectory.efforts[:, _electrical_leaves(trajectory)] / scales.voltage) ** 2)


def _electrical_leaves(trajectory: Trajectory) -> list[int]:
    network = trajectory.setup.network
    charged = charges(network)
    return [i for i in trajectory.program.dissipative if network.storages[i].name in charged]


def _coupling(u: Array, scales: Scales) -> Array:
    w = u / scales.voltage
    return np.column_stack([w**2, w**3])


def _lag_times(scales: Scales) -> Array:
    return np.array([0.02, 0.1, 0.4, 2.0, 10.0]) / (2.0 * np.pi * scales.fastest)


def _lag_after_a_step(t: Array, scales: Scales) -> Array:
    return np.column_stack([np.exp(-t / tau) for tau in _lag_times(scales)])


def _amplifier_lag(trajectory: Trajectory, scales: Scales) -> Array:
    u, h = trajectory.u[:, 0] / scales.voltage, trajectory.h
    times = _lag_times(scales)
    before = input_before(trajectory.recording, trajectory.recording.u) / scales.voltage
    return np.column_stack([u - low_pass(u, h, t, before) for t in times])


def _amplifier_limit(u: Array, scales: Scales) -> Array:
    w = u / scales.voltage
    return np.column_stack([np.sign(w) * np.maximum(np.abs(w) - c, 0.0) for c in (0.4, 0.6, 0.75, 0.85, 0.92, 0.97)])


def _amplifier_slew(trajectory: Trajectory, scales: Scales) -> Array:
    u, h = trajectory.u[:, 0] / scales.voltage, trajectory.h
    before = input_before(trajectory.recording, trajectory.recording.u) / scales.voltage
    rates = 2.0 * np.pi * scales.fastest * np.array([0.5, 0.9, 2.0, 10.0])
    return np.column_stack([u - rate_limited(u, h, r, before) for r in rates])


def _polarisation(trajectory: Trajectory, scales: Scales) -> Array:
    w = np.abs(trajectory.u[:, 0]) / scales.voltage
    return _slowly(trajectory, scales, *(np.maximum(w - c, 0.0) for c in (0.3, 0.6, 0.85)))


def _warmth(trajectory: Trajectory, scales: Scales) -> Array:
    power = (trajectory.velocity / scales.velocity) ** 2
    return _slowly(trajectory, scales, power)


def _slowly(trajectory: Trajectory, scales: Scales, *driving: Array) -> Array:
    """States that follow what drives them over a good part of the recordings, from none at the start."""
    times = np.geomspace(0.05 * scales.duration, 5.0 * scales.duration, 3)
    return np.column_stack([low_pass(x, trajectory.h, t, 0.0) for x in driving for t in times])


def _sensor_static(q: Array, scales: Scales) -> Array:
    s = q / scales.sensed
    return np.column_stack([s**2, s**3])


def _sensor_memory(trajectory: Trajectory, scales: Scales) -> Array:
    q = trajectory.signal / scales.sensed
    mid = 0.5 * (q[1:] + q[:-1])
    lags = [q - np.append(q[0], low_pass(mid, trajectory.h, t, float(q[0]))) for t in _lag_times(scales)[[0, 2]]]
    samples = trajectory.nodes[trajectory.lead :]
    plays = [q[samples] - play_operator(q[samples], r) for r in (0.002, 0.01, 0.03)]
    return np.column_stack([*(lag[samples] for lag in lags), *plays])


def _sensor_gain(trajectory: Trajectory, scales: Scales) -> Array:
    return _drifts(trajectory.t, scales) * (trajectory.y / scales.sensed)[:, None]


def _sensor_clock(trajectory: Trajectory, scales: Scales) -> Array:
    velocity = np.gradient(trajectory.y, trajectory.t) if trajectory.t.size > 1 else np.zeros_like(trajectory.y)
    return _drifts(trajectory.t, scales) * (velocity / scales.sensed_rate)[:, None]


def _drifts(t: Array, scales: Scales) -> Array:
    x = t / scales.duration
    return np.column_stack([x, x**2])


def _drift(trajectory: Trajectory, scales: Scales) -> Array:
    return _drifts(trajectory.t, scales)


def _lines(trajectory: Trajectory, scales: Scales) -> Array:
    columns = []
    for line in (50.0, 60.0, 100.0, 120.0):
        if line * 2.2 < 1.0 / trajectory.recording.dt:
            columns += [np.sin(2 * np.pi * line * trajectory.t), np.cos(2 * np.pi * line * trajectory.t)]
        else:
            columns += [np.zeros_like(trajectory.t)] * 2
    return np.column_stack(columns)


def _of_displacement(law: Callable[[Array, Scales], Array]) -> Callable[[Trajectory, Scales], Array]:
    return lambda trajectory, scales: law(trajectory.mid_displacement, scales)


def _of_velocity(law: Callable[[Array, Scales], Array]) -> Callable[[Trajectory, Scales], Array]:
    return lambda trajectory, scales: law(trajectory.velocity, scales)


def _of_voltage(law: Callable[[Array, Scales], Array]) -> Callable[[Trajectory, Scales], Array]:
    return lambda trajectory, scales: law(trajectory.u[:, 0], scales)


def _of_output(law: Callable[[Array, Scales], Array]) -> Callable[[Trajectory, Scales], Array]:
    return lambda trajectory, scales: law(trajectory.y, scales)


_Q, _V, _U, _T = "displacement [m]", "velocity [m/s]", "voltage [V]", "time after a step [s]"

GROUPS = (
    Group(kinds.ELASTIC, FORCE, _of_displacement(_elastic), _Q, _elastic),
    Group(kinds.DISSIPATIVE, FORCE, _of_velocity(_dissipative), _V, _dissipative),
    Group(kinds.DAMPING_BY_DISPLACEMENT, PARAMETER, _of_displacement(_by_displacement), _Q,
        _by_displacement, dampings,
    ),
    Group(kinds.MEMORY, FORCE, _memory, _T, _after_a_step),
    Group(kinds.MODE, FORCE, _modes),
    Group(kinds.RINGING_MODE, FORCE, _ringing, searched=True),
    Group(kinds.SHAPE, FORCE, _hysteron),
    Group(kinds.THRESHOLD_BY_DISPLACEMENT, PARAMETER, _of_displacement(_by_displacement), _Q,
        _by_displacement, thresholds,
    ),
    Group(kinds.THRESHOLD_BY_RATE, PARAMETER, _of_velocity(_by_speed), _V, _by_speed, thresholds),
    Group(kinds.CAPACITANCE_BY_CHARGE, PARAMETER, _by_charge, "", None, capacitances),
    Group(kinds.LEAKAGE, FORCE, _leakage),
    Group(kinds.FORCE_BY_VOLTAGE, FORCE, _of_voltage(_coupling), _U, _coupling),
    Group(kinds.RATIO_BY_DISPLACEMENT, PARAMETER, _of_displacement(_by_displacement), _Q,
        _by_displacement, ratios,
    ),
    Group(kinds.RATIO_BY_PAST_VOLTAGE, PARAMETER, _polarisation, "", None, ratios),
    Group(kinds.LAG, VOLTAGE, _amplifier_lag, _T, _lag_after_a_step),
    Group(kinds.LIMIT, VOLTAGE, _of_voltage(_amplifier_limit), _U, _amplifier_limit),
    Group(kinds.SLEW, VOLTAGE, _amplifier_slew),
    Group(kinds.RATIO_BY_WARMTH, PARAMETER, _warmth, "", None, ratios),
    Group(kinds.SENSOR_NONLINEAR, OUTPUT, _of_output(_sensor_static), _Q, _sensor_static),
    Group(kinds.LAG_OR_PLAY, OUTPUT, _sensor_memory),
    Group(kinds.GAIN_DRIFT, OUTPUT, _sensor_gain),
    Group(kinds.CLOCK, OUTPUT, _sensor_clock),
    Group(kinds.DRIFT, OUTPUT, _drift, "time [s]", _drifts),
    Group(kinds.LINES, OUTPUT, _lines),
)  # fmt: skip
