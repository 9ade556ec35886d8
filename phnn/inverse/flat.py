"""The network alone: the port voltage that a motion takes.

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

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray

from phnn.chain import SOURCES
from phnn.errors import InputRefused, SolverFailed
from phnn.integrate import kernel
from phnn.integrate.program import compile_network
from phnn.integrate.rest import equilibrium, equilibrium_slope
from phnn.inverse.blocks import Path, Solved, solve_rising
from phnn.laws import PORT_LAWS
from phnn.network.elements import Network, Port, Storage
from phnn.network.roles import motions
from phnn.network.system import PortHamiltonianSystem
from phnn.parameters import as_table, constant
from phnn.passage import place_of, source_input
from phnn.setup import Setup

Array = NDArray[np.float64]

_IMPOSED, _HEAVY = "imposed_motion", "imposed_mass"
# How many times as heavy as the mass itself: forces of the network are lost in rounding beside it.
_TIMES = 1e30
# Newton's method for the voltage at rest: iterations, and the share of the displacement that counts as zero.
_ITERATIONS, _ROUNDING = 40, 1e-13


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
        port, found = network.ports[0], motions(network)
        if not found or found[0].displacement != network.output or set(port.on) != {found[0].momentum}:
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
        """Place of the momentum among the states."""
        return self.setup.network.state_names.index(motions(self.setup.network)[0].momentum)

    @cached_property
    def mass(self) -> Storage:
        """The storage of the momentum."""
        return self.setup.network.storages[self.momentum]

    @property
    def output(self) -> int:
        """Place of the displacement among the states."""
        return self.setup.network.state_names.index(self.setup.network.output)

    @cached_property
    def imposed(self) -> Network:
        """The network with a heavy mass and a port that moves it."""
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
        """The constant voltage under which the network rests at a displacement, and (N,) its state.

        Zero voltage and an empty network with that displacement where the voltage does not tell it.
        """
        network, program = self.setup.network, compile_network(self.setup.network)
        u, x = np.zeros(len(network.ports)), np.zeros(len(network.state_names))
        x[self.output] = q
        try:
            for _ in range(_ITERATIONS):
                found = equilibrium(program, network, u)
                miss, slope = found[self.output] - q, equilibrium_slope(program, network, u, 0)[self.output]
                if not np.isfinite(miss) or slope == 0.0:
                    return 0.0, x
                if abs(miss) <= _ROUNDING * abs(q):
                    return float(u[0]), found
                u[0] -= miss / slope
        except SolverFailed:
            return 0.0, x
        return float(u[0]), found

    def voltage(self, path: Path, before: Array | None = None) -> Solved:
        """(n+1,) port voltage at the nodes of a motion, and by how much a bent port misses the action it needs.

        Args:
            path: the displacement and its derivatives.
            before: (n+1,) an estimate of the voltage, for modulator states that it drives; zero without it.

        Raises:
            SolverFailed: a step with the imposed motion has no solution.
        """
        x = self._states(path, before)
        system, u = PortHamiltonianSystem(self.setup.network), self._inputs(path.times)
        port = self.setup.network.ports[0]
        values = [self.setup.network.parameters[n].value for n in port.parameters]
        with torch.no_grad():
            states, inputs = torch.from_numpy(x), torch.from_numpy(u)
            force = system.rate(system.efforts(states), states, inputs)[:, self.momentum].numpy()
            gain = system.incidences(states)[1][..., self.momentum, 0].numpy()

        def action(voltage: Array) -> Array:
            return np.asarray(PORT_LAWS[port.law].action(voltage, *values)) + 0.0 * voltage

        wanted = (self._inertia * path.acceleration - force) / gain + action(np.zeros(1))[0]
        if port.law == "linear":
            return Solved(wanted, np.zeros_like(wanted))
        return solve_rising(action, wanted)

    def _states(self, path: Path, before: Array | None) -> Array:
        """(n+1, N) states at the nodes while the displacement is imposed."""
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

    def _inputs(self, times: Array) -> Array:
        """(n+1, P) inputs of the ports at the nodes, the first one zero."""
        u = np.zeros((times.size, len(self.setup.network.ports)))
        for source in self.setup.sources:
            values = [self.setup.parameters[name].value for name in source.parameters]
            u[:, place_of(self.setup, source)] += SOURCES[source.kind](times, *values)
        return u
