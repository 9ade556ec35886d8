"""Blocks of the measuring chain backwards: the command that makes an amplifier block give a voltage, and the
displacement that makes a sensor block report an output.

Signals stand at the nodes of the sub-steps, equally far apart. Derivatives are central differences, an error of second
order in the step, which the iteration on the complete model removes. Amplifier blocks give a voltage ``V``, sensor
blocks an output ``y``:

=======================  ===========================================================================================
static blocks            the block's own characteristic, solved for its argument
``lowpass``              ``u = V + τ V̇``
``second_order_lowpass`` ``u = V + 2ζ τ V̇ + τ² V̈``
``fading``               ``τ u̇ + (1 − a) u = V + τ V̇``
``delay``                ``u(t) = V(t + τ)``, held at the end
``slew_limit``           ``u = V`` where ``|V̇| ≤ S``; elsewhere out of reach
``bouc_wen``             ``u = V``; the iteration finds the rest
``lag``                  ``q = y + τ ẏ``
``clock``                ``q((1 − c s) t) = y(t)``, held at the end
``rectification``        ``q = y``, for outputs that are not negative
``play``                 ``q = y + δ s``, where ``s`` is the direction of motion. It changes sign while ``|ẏ|`` is below
                         a fiftieth of its largest value, for no mass crosses the play at once
=======================  ===========================================================================================

The network alone: the port voltage that a motion takes.

Let ``q`` be the measured displacement, ``p = m q̇`` its momentum and ``V`` the first port, which acts on ``p`` alone,

    ṗ = f_p(x, u) + g(x) ψ(V),      q̇ = p/m.

Then ``q(t)`` is a flat output. All other states obey ``ẋ = f(x, q̇)``, where the voltage does not occur, so that the
network integrates them with its motion imposed, and

    ψ(V) = (m q̈ − f_p(x, u)) / g(x).

For the actuator this is ``V = Σ e_i + (k q + b q̇ + m q̈)/α``. Effects in the network (creep, friction, a second mode, a
bent spring or port, ratios that follow a state) are in ``f``, ``f_p``, ``g`` and ``ψ``.

The motion is imposed by a mass so heavy that no force moves it, and a port that gives it its velocity: the network
keeps its structure, and its own compiled step integrates it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.signal import lfilter, lfiltic

from phnn.chain import AMPLIFIERS, SENSORS, SOURCES
from phnn.chain.amplifiers import slip_step
from phnn.errors import InputRefused, SolverFailed
from phnn.integrate import kernel
from phnn.integrate.cache import entry
from phnn.integrate.program import compile_network
from phnn.integrate.rest import equilibrium, equilibrium_slope
from phnn.laws import PORT_LAWS
from phnn.network.elements import Network, Port, Storage
from phnn.network.roles import motions
from phnn.network.system import PortHamiltonianSystem
from phnn.parameters import as_table, constant
from phnn.setup import Setup
from phnn.signals.least_squares import spline
from phnn.trajectory import place_of, source_input

Array = NDArray[np.float64]


class Signal(NamedTuple):
    """Attributes:
    values: (M,) of the signal.
    lost: (M,) bool: what was asked for lies out of reach there.
    causes: why, in words, for messages.
    """

    values: Array
    lost: NDArray[np.bool_]
    causes: tuple[str, ...] = ()

    def then(self, values: Array, lost: NDArray[np.bool_] | None = None, cause: str = "") -> Signal:
        """Return the signal behind one more stage, which may lose samples for a cause of its own."""
        if lost is None or not lost.any():
            return Signal(values, self.lost, self.causes)
        return Signal(values, self.lost | lost, (*self.causes, cause))


def reachable(values: Array) -> Signal:
    """Return a signal of which nothing is lost."""
    return Signal(values, np.zeros(values.size, dtype=bool))


# Degree of the spline, whose second derivative is a cubic spline, and the fewest samples that it can be put through.
_DEGREE, FEWEST = 5, 6


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


def path_through(samples: Array, dt: float, substeps: int) -> Path:
    """Return the quintic spline through samples, on the sub-steps of a simulation.

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


# The bracket begins at this share of the largest target and doubles, up to this many times that target: a
# characteristic that needs ten times its input to reach a value is taken to end before it.
_FIRST, _FURTHEST = 1e-3, 10.0
# Halvings of the bracket: after 60 it is as narrow as rounding.
_HALVINGS = 60


class Solved(NamedTuple):
    """Attributes:
    x: (N,) arguments; at values out of reach, where the characteristic comes closest.
    missed: (N,) by how much the characteristic falls short of the value; zero where it is reached.
    """

    x: Array
    missed: Array


def solve_rising(function: Callable[[Array], Array], target: Array) -> Solved:
    """Solve ``f(x) = target`` elementwise for an ``f`` that rises, or rests, from zero on to both sides.

    Args:
        function: (N,) values of (N,) arguments, elementwise.
        target: (N,) values that are wanted.
    """
    at_zero = function(np.zeros_like(target))
    reach = max(float(np.abs(target).max(initial=0.0)), float(np.abs(at_zero).max(initial=0.0)), np.finfo(float).tiny)
    upwards = target >= at_zero
    side = np.where(upwards, 1.0, -1.0)
    near, far = np.zeros_like(target), np.full_like(target, _FIRST * reach)
    short = _short(function, side, far, target)
    while short.any() and float(far.max()) < _FURTHEST * reach:
        near, far = np.where(short, far, near), np.where(short, np.minimum(2.0 * far, _FURTHEST * reach), far)
        short = _short(function, side, far, target)
    # A characteristic that ends gives what it has, with the least argument that gives it.
    wanted = np.where(short, function(side * far), target)
    missed = np.where(short, target - wanted, 0.0)
    near = np.where(short, 0.0, near)
    for _ in range(_HALVINGS):
        middle = 0.5 * (near + far)
        below = _short(function, side, middle, wanted)
        near, far = np.where(below, middle, near), np.where(below, far, middle)
    return Solved(side * far, missed)


def _short(function: Callable[[Array], Array], side: Array, size: Array, target: Array) -> NDArray[np.bool_]:
    """Return where the characteristic has not yet come as far as the target."""
    return np.asarray(side * (function(side * size) - target) < 0.0)


# Share of a limit by which a signal may exceed it in rounding; share of a signal's range that counts as reached.
_ROUNDING, _REACHED = 1e-9, 1e-6


def command(setup: Setup, voltage: Signal, h: float) -> Signal:
    """Return the command at the nodes that makes the amplifier give a voltage at its end.

    Args:
        voltage: at the nodes; h: their interval [s].

    Raises:
        InputRefused: a block that has no inverse; names it.
    """
    for block in reversed(setup.amplifier):
        values = [setup.parameters[name].value for name in block.parameters]
        if not AMPLIFIERS[block.kind].remembers:
            voltage = _static(partial(_amplified, block.kind, values), voltage, "amplifier", block.kind)
        elif block.kind in _AMPLIFIER_INVERSES:
            voltage = _AMPLIFIER_INVERSES[block.kind](voltage, h, *values)
        else:
            raise InputRefused(
                f"the amplifier block {block.kind} has no inverse: give a model whose input is a voltage or a force"
            )
    return voltage


def _amplified(kind: str, values: list[float], u: Array) -> Array:
    """Return (N,) the voltage that an amplifier block without a memory makes of commands (N,)."""
    return np.asarray(AMPLIFIERS[kind].law(u[:, None], np.ones(1), 0.0, *values))[:, 0]


def _static(characteristic: Callable[[Array], Array], wanted: Signal, stage: str, kind: str) -> Signal:
    """Return the argument of a characteristic that gives a signal."""
    solution = solve_rising(characteristic, wanted.values)
    lost = np.abs(solution.missed) > _REACHED * np.abs(wanted.values).max(initial=0.0)
    return wanted.then(solution.x, lost, f"the {stage}'s {kind.replace('_', ' ')}")


def _lowpass(voltage: Signal, h: float, tau: float) -> Signal:
    return voltage.then(voltage.values + tau * _rate(voltage.values, h))


def _fading(voltage: Signal, h: float, share: float, tau: float) -> Signal:
    """Return ``τ u̇ + (1 − a) u = V + τ V̇`` by the trapezoidal rule, from the equilibrium of the first voltage."""
    of_voltage = 1.0 + 2.0 * tau / h * np.array([1.0, -1.0])
    of_command = of_voltage - share
    rest = lfiltic(of_voltage, of_command, [voltage.values[0] / (1.0 - share)], voltage.values[:1])
    return voltage.then(np.asarray(lfilter(of_voltage, of_command, voltage.values, zi=rest)[0]))


def _second_order(voltage: Signal, h: float, tau: float, zeta: float) -> Signal:
    rate = _rate(voltage.values, h)
    return voltage.then(voltage.values + 2.0 * zeta * tau * rate + tau * tau * _rate(rate, h))


def _delay(voltage: Signal, h: float, tau: float) -> Signal:
    last = voltage.values.size - 1.0
    places = np.minimum(np.arange(voltage.values.size) + tau / h, last)
    return voltage.then(np.asarray(spline(voltage.values)(places)))


def _slew_limit(voltage: Signal, h: float, limit: float) -> Signal:
    fast = np.abs(np.diff(voltage.values)) > limit * h * (1.0 + _ROUNDING)
    lost = np.append(fast, False) | np.insert(fast, 0, False)
    return voltage.then(voltage.values, lost, "the amplifier's slew limit")


def _unslipped_loop(voltage: Any, weight: Any, travel: Any, exponent: Any, back: Any, lean: Any) -> Any:
    out = voltage.copy()
    state = 0.0
    for n in range(1, voltage.size):
        for _ in range(_REPEATED):
            end = slip_step(state, out[n] - out[n - 1], travel, exponent, back, lean)
            before, out[n] = out[n], voltage[n] + weight * end
            if out[n] == before:
                break
        state = end
    return out


_unslipped = entry(_unslipped_loop)


def _rate(values: Array, h: float) -> Array:
    return np.asarray(np.gradient(values, h, edge_order=2 if values.size > 2 else 1))


_AMPLIFIER_INVERSES: dict[str, Callable[..., Any]] = {
    "lowpass": _lowpass,
    "second_order_lowpass": _second_order,
    "fading": _fading,
    "delay": _delay,
    "slew_limit": _slew_limit,
    "bouc_wen": lambda voltage, h, *values: voltage,
    "slipping": lambda voltage, h, *values: voltage.then(_unslipped(voltage.values, *values)),
}


# Most repetitions of ``u = V + w s(u)``, of which each leaves the share by which the state slows the input down.
_REPEATED = 60
# Share of the largest speed below which a play is crossed.
_CROSSING = 0.02
# Share of the range of an output that may lie below zero and still count as none: rounding, and corrections.
_BELOW = 1e-3


def displacement(setup: Setup, output: Signal, dt: float, strict: bool = True) -> Signal:
    """Return the displacement at the samples that makes the sensor report an output.

    Args:
        output: at the samples; dt: their interval [s].
        strict: refuse an output that a block cannot report, where a corrected one is taken as near as it can be.

    Raises:
        InputRefused: a block that has no inverse, or an output that it cannot report; names it.
    """
    t: Array = dt * np.arange(output.values.size, dtype=np.float64)
    for block in reversed(setup.sensor):
        values = [setup.parameters[name].value for name in block.parameters]
        if block.kind in _SENSOR_INVERSES:
            y = output.values
            if strict and block.kind == "rectification" and y.min() < -_BELOW * np.ptp(y):
                worst = int(np.argmin(y))
                raise InputRefused(
                    f"the model's sensor reports |q|, and the reference is {y[worst]:.4g} m at t = {t[worst]:.6g} s: "
                    "give a reference that is not negative"
                )
            output = output.then(_SENSOR_INVERSES[block.kind](y, t, *values))
        elif not SENSORS[block.kind].remembers:
            output = _static(partial(_sensed, block.kind, t, values), output, "sensor", block.kind)
        else:
            raise InputRefused(f"the sensor block {block.kind} has no inverse: give a model without it")
    return output


def _sensed(kind: str, t: Array, values: list[float], q: Array) -> Array:
    return np.asarray(SENSORS[kind].law(q, t, *values))


def _lag(y: Array, t: Array, tau: float) -> Array:
    return y + tau * path_through(y, t[1] - t[0], 1).velocity


def _clock(y: Array, t: Array, change: float, scale: float) -> Array:
    places = np.minimum(np.arange(y.size) / (1.0 - change * scale), y.size - 1.0)
    return np.asarray(spline(y)(places))


def _play(y: Array, t: Array, width: float) -> Array:
    rate = path_through(y, t[1] - t[0], 1).velocity
    slow = _CROSSING * np.abs(rate).max()
    return y + width * rate / np.sqrt(rate**2 + slow**2) if slow > 0.0 else y


_SENSOR_INVERSES: dict[str, Callable[..., Any]] = {
    "lag": _lag,
    "clock": _clock,
    "rectification": lambda y, t: np.maximum(y, 0.0),
    "play": _play,
}


_IMPOSED, _HEAVY = "imposed_motion", "imposed_mass"
# How many times as heavy as the mass itself: forces of the network are lost in rounding beside it.
_TIMES = 1e30
# Newton's method for the voltage at rest: iterations, and the share of the displacement that counts as zero.
_ITERATIONS, _ZERO = 40, 1e-13


@dataclass(frozen=True)
class FlatNetwork:
    """The inverse of a setup's network.

    Raises:
        InputRefused: the network has no such output; names the cause and a remedy.
    """

    setup: Setup

    def __post_init__(self) -> None:
        network = self.setup.network
        if network.senses:
            raise InputRefused(
                f"the model's input is the motion imposed at {network.senses}, and its output a force: there is no "
                "voltage to find; give the model of an actuator"
            )
        if not network.ports:
            raise InputRefused("the model has no input port: give the model of an actuator")
        port, moving = network.ports[0], motions(network)
        if not moving or moving[0].displacement != network.output or set(port.on) != {moving[0].momentum}:
            raise InputRefused(
                f"the port {port.name} does not push the mass whose displacement {network.output} is measured, so that "
                f"the motion does not tell the input: give a model whose first port acts on that mass alone"
            )
        if self.mass.law != "capacitor":
            raise InputRefused(
                f"the mass of {self.mass.name} is no constant but the law {self.mass.law}: give a model with a mass"
            )

    @cached_property
    def momentum(self) -> int:
        """Return the place of the momentum among the states."""
        return self.setup.network.state_names.index(motions(self.setup.network)[0].momentum)

    @cached_property
    def mass(self) -> Storage:
        """Return the storage of the momentum."""
        return self.setup.network.storages[self.momentum]

    @property
    def output(self) -> int:
        """Return the place of the displacement among the states."""
        return self.setup.network.state_names.index(self.setup.network.output)

    @cached_property
    def imposed(self) -> Network:
        """Return the network with a heavy mass and a port that moves it."""
        network = self.setup.network
        heavy = constant(_HEAVY, _TIMES * self._inertia, "kg", "mass that no force of the network moves")
        storages = list(network.storages)
        storages[self.momentum] = replace(self.mass, parameters=(heavy.name,))
        return replace(
            network,
            storages=tuple(storages),
            ports=(*network.ports, Port(_IMPOSED, {self.mass.name: 1.0}, unit="N")),
            parameters=as_table((*network.parameters.values(), heavy)),
        )

    @property
    def _inertia(self) -> float:
        return self.setup.network.parameters[self.mass.parameters[0]].value

    def at_rest(self, q: float) -> tuple[float, Array]:
        """Return the constant voltage under which the network rests at a displacement, and (N,) its state.

        Zero voltage and an empty network with that displacement where the voltage does not tell it.
        """
        network = self.setup.network
        u, x = np.zeros(len(network.ports)), np.zeros(len(network.state_names))
        x[self.output] = q
        try:
            for _ in range(_ITERATIONS):
                state = equilibrium(network, u)
                miss, slope = state[self.output] - q, equilibrium_slope(network, u, 0)[self.output]
                if not np.isfinite(miss) or slope == 0.0:
                    return 0.0, x
                if abs(miss) <= _ZERO * abs(q):
                    return float(u[0]), state
                u[0] -= miss / slope
        except SolverFailed:
            return 0.0, x
        return float(u[0]), state

    def voltage(self, path: Path, before: Array | None = None) -> Solved:
        """Return (n+1,) port voltage at the nodes of a motion, and by how much a bent port misses the action it needs.

        Args:
            path: the displacement and its derivatives.
            before: (n+1,) an estimate of the voltage, for modulator states that it drives; zero without it.

        Raises:
            SolverFailed: a step with the imposed motion has no solution.
        """
        x = self._states(path, before)
        system, u = PortHamiltonianSystem(self.setup.network), np.zeros((x.shape[0], len(self.setup.network.ports)))
        for source in self.setup.sources:
            given = [self.setup.parameters[name].value for name in source.parameters]
            u[:, place_of(self.setup, source)] += SOURCES[source.kind].law(path.times, *given)
        port = self.setup.network.ports[0]
        values = [self.setup.network.parameters[n].value for n in port.parameters]
        with torch.no_grad():
            states, inputs = torch.from_numpy(x), torch.from_numpy(u)
            force = system.rate(system.efforts(states), states, inputs)[:, self.momentum].numpy()
            gain = system.incidences(states)[1][..., self.momentum, 0].numpy()

        def action(voltage: Array) -> Array:
            return np.asarray(PORT_LAWS[port.law].action(voltage, *values)) + 0.0 * voltage

        wanted = (self._inertia * path.acceleration - force) / gain + action(np.zeros(1))[0]
        return Solved(wanted, np.zeros_like(wanted)) if port.law == "linear" else solve_rising(action, wanted)

    def _states(self, path: Path, before: Array | None) -> Array:
        """Return (n+1, N) states at the nodes while the displacement is imposed."""
        network, heavy = self.imposed, _TIMES * self._inertia
        program = compile_network(network)
        h = np.full(path.q.size - 1, path.h)
        u = np.zeros((h.size, len(network.ports)))
        if before is not None:
            u[:, 0] = 0.5 * (before[1:] + before[:-1])
        for source in self.setup.sources:
            u[:, place_of(self.setup, source)] += source_input(self.setup, source, h, 0.0)
        u[:, -1] = heavy * np.diff(path.node_velocity) / path.h
        x0 = self.at_rest(float(path.q[0]))[1]
        x0[self.momentum] = heavy * path.node_velocity[0]
        states, efforts = np.empty((h.size + 1, x0.size)), np.empty((h.size, x0.size))
        done = kernel.march(program, program.theta(network), x0, u, h, states, efforts)
        if done < h.size:
            raise SolverFailed(
                f"no solution of the step with the imposed motion at t = {path.times[done]:.6g} s: smooth the reference"
            )
        states[:, self.momentum] = self._inertia * path.velocity
        return states
