"""The equations of the compiled march, evaluated by the torch module for all steps at once.

    r_l = x_l⁺ − X_l(x, v̄),     r_p = p⁺ − (2 m v̄ − p),
    r_J = 2 (m v̄ − p)/h + Σ_l a_l ē_l(x, v̄) + Σ_r φ_r(v̄) − Σ_j g_j ψ_j(ū_j)

``X_l`` and ``ē_l`` are the exact flow of a leaf with a resistor and the discrete gradient of one without. The
network is read here by its names, not through the kernel's tables, so that a wrong table is noticed as well.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from phnn.errors import SolverFailed
from phnn.integrate.program import Program
from phnn.laws import RESISTOR_LAWS, STORAGE_LAWS
from phnn.laws.leaf import rc_flow
from phnn.network.elements import Ratio, Resistor, Storage
from phnn.network.power import PowerBalance
from phnn.network.system import PortHamiltonianSystem

if TYPE_CHECKING:
    from phnn.simulate import Trajectory

# A motion that dies away passes through the smallest numbers, where relative accuracy is lost.
_NOTHING = 1e-180


class Residual(NamedTuple):
    """What the march leaves of its equations, and the size of the terms that cancel in each.

    Attributes:
        value: (n, L+2) residuals of the leaves, the momentum and, last, the junction [SI].
        scale: (n, L+2) sums of the absolute values of their terms.
    """

    value: Tensor
    scale: Tensor

    def relative(self) -> Tensor:
        """(n, L+2) residual in units of its terms; nothing where a motion has died away altogether."""
        return self.value.abs() / (self.scale + _NOTHING)


class _Steps:
    """All steps of a march, seen through the elements of the network."""

    def __init__(
        self, system: PortHamiltonianSystem, program: Program, states: Tensor, velocity: Tensor, h: Tensor
    ) -> None:
        network = system.network
        self.system, self.v, self.h = system, velocity, h
        self.before = {name: states[:-1, i] for i, name in enumerate(program.leaf_names)}
        self.storages = {s.name: s for s in network.storages}
        (self.junction,) = set(self.storages) - set(program.leaf_names)
        self.resistors = {next(iter(r.on)): r for r in network.resistors if self.junction not in r.on}
        self.on_flow = [r for r in network.resistors if self.junction in r.on]
        self.ratios = {c.to: self.number(c.ratio) for c in network.couplings}
        self.mass = system.value(self.storages[self.junction].parameters[0])

    def number(self, ratio: Ratio) -> Tensor | float:
        return self.system.value(ratio) if isinstance(ratio, str) else ratio

    def parameters(self, element: Storage | Resistor) -> list[Tensor]:
        return [self.system.value(name) for name in element.parameters]

    def modulation(self, resistor: Resistor) -> Tensor:
        """(n,) mid-step value of what a law may read."""
        name = resistor.modulated_by
        if name is None:
            return torch.zeros_like(self.v)
        return self.before[name] + 0.5 * self.h * self.ratios[name] * self.v

    def leaf(self, name: str) -> tuple[Tensor, Tensor]:
        """(n,) end state and mean effort of a leaf under the mid-step velocity."""
        storage, x, current = self.storages[name], self.before[name], self.ratios[name] * self.v
        law, values = STORAGE_LAWS[storage.law], self.parameters(storage)
        if name not in self.resistors:
            end = x + self.h * current
            return end, law.mean_effort(x, end, *values)
        resistor = self.resistors[name]
        thresholds = RESISTOR_LAWS[resistor.law].thresholds
        if thresholds is None:
            raise SolverFailed(f"{resistor.name}: the law {resistor.law} has no exact flow: solve with integrate.dense")
        rho, low, high = thresholds(self.modulation(resistor), *self.parameters(resistor))
        one = torch.ones_like(x)
        return rc_flow(x, current, self.h, 1.0 / law.mean_effort(one, one, *values), rho, low, high)

    def resistor_force(self, resistor: Resistor) -> Tensor:
        """(n,) force of a resistor on the junction."""
        flow = RESISTOR_LAWS[resistor.law].flow
        return flow(self.v, self.modulation(resistor), *self.parameters(resistor))

    def port_forces(self, u: Tensor) -> list[Tensor]:
        """P of (n,) ``g ψ(ū)``."""
        actions = self.system.actions(u)
        ports = self.system.network.ports
        return [self.number(port.on[self.junction]) * actions[:, j] for j, port in enumerate(ports)]


def march_residual(
    system: PortHamiltonianSystem,
    program: Program,
    states: Tensor,  # (n+1, L+1) leaf states and momentum, in the program's order
    velocity: Tensor,  # (n,) mid-step velocities
    u: Tensor,  # (n, P) mean inputs
    h: Tensor,  # (n,) steps
) -> Residual:
    """The residual of every step, differentiable by all arguments and by the system's parameters.

    Args:
        system: the module of the network that ``program`` was compiled from.
    """
    steps = _Steps(system, program, states, velocity, h)
    values, scales = [], []
    forces = [2.0 * steps.mass * velocity / h, -2.0 * states[:-1, -1] / h]
    for i, name in enumerate(program.leaf_names):
        end, mean = steps.leaf(name)
        values.append(states[1:, i] - end)
        scales.append(states[1:, i].abs() + states[:-1, i].abs() + (h * steps.ratios[name] * velocity).abs())
        forces.append(steps.ratios[name] * mean)
    forces += [steps.resistor_force(r) for r in steps.on_flow]
    forces += [-force for force in steps.port_forces(u)]
    kick = 2.0 * steps.mass * velocity
    values += [states[1:, -1] + states[:-1, -1] - kick, torch.stack(forces).sum(0)]
    scales += [states[1:, -1].abs() + states[:-1, -1].abs() + kick.abs(), torch.stack(forces).abs().sum(0)]
    return Residual(torch.stack(values, dim=-1), torch.stack(scales, dim=-1).detach())


def check(trajectory: Trajectory, tolerance: float = 1e-10, system: PortHamiltonianSystem | None = None) -> float:
    """The largest relative residual of a simulated recording.

    Args:
        tolerance: what is accepted, relative to the terms of each equation.
        system: the module to check against; without it, one of the trajectory's own network.

    Raises:
        SolverFailed: a step does not satisfy the equations of the module; names the time and the element.
    """
    program = trajectory.program
    system = PortHamiltonianSystem(trajectory.setup.network) if system is None else system
    with torch.no_grad():
        relative = march_residual(system, program, *_tensors(trajectory)).relative()
    if relative.numel() == 0:
        return 0.0
    # NaN would hide in a maximum.
    worst = torch.nan_to_num(relative, nan=torch.inf)
    n, element = divmod(int(worst.argmax()), worst.shape[1])
    largest = float(worst[n, element])
    if largest > tolerance:
        names = (*program.leaf_names, "momentum", "junction")
        time = float(trajectory.h[:n].sum()) - trajectory.lead * trajectory.recording.dt
        raise SolverFailed(
            f"{trajectory.recording.name}: the step at t = {time:.6g} s leaves a relative residual of {largest:.2g} at "
            f"the {names[element]} equation (accepted: {tolerance:.2g}); use smaller steps, and report the network"
        )
    return largest


def power_balance(trajectory: Trajectory, system: PortHamiltonianSystem | None = None) -> PowerBalance:
    """The energy balance of every step of a simulated recording, in joules a step.

        stored = H(x⁺) − H(x),   dissipated = h a_l v̄ ē_l − ΔH_l on a leaf and h v̄ φ(v̄) on the junction,
        supplied = h v̄ g ψ(ū),   defect = stored − Σ supplied + Σ dissipated

    Returns:
        ``stored`` (n,), ``dissipated`` (n, R) in the order of the network's resistors, ``supplied`` (n, P),
        ``defect`` (n,), all at the mean efforts of the steps, which are exact where efforts at the nodes are not.
    """
    program, network = trajectory.program, trajectory.setup.network
    system = PortHamiltonianSystem(network) if system is None else system
    with torch.no_grad():
        states, velocity, u, h = _tensors(trajectory)
        efforts = torch.from_numpy(trajectory.efforts)
        steps = _Steps(system, program, states, velocity, h)
        energies = system.energies(states[:, network_order(system, program)])
        change = dict(zip(network.state_names, energies.diff(dim=0).unbind(-1), strict=True))
        taken = {}
        for i, name in enumerate(program.leaf_names):
            if name in steps.resistors:
                received = h * steps.ratios[name] * velocity * efforts[:, i]
                taken[steps.resistors[name].name] = received - change[name]
        for resistor in steps.on_flow:
            taken[resistor.name] = h * velocity * steps.resistor_force(resistor)
        dissipated = _columns([taken[r.name] for r in network.resistors], h)
        supplied = _columns([h * velocity * force for force in steps.port_forces(u)], h)
        stored = energies.diff(dim=0).sum(-1)
        return PowerBalance(stored, dissipated, supplied, stored - supplied.sum(-1) + dissipated.sum(-1))


def network_order(system: PortHamiltonianSystem, program: Program) -> list[int]:
    """Where the states of the network, in its own order, stand among those of the program."""
    places = {name: i for i, name in enumerate(program.leaf_names)}
    return [places.get(name, len(places)) for name in system.state_names]


def _columns(columns: list[Tensor], like: Tensor) -> Tensor:
    """(n, k) columns, also where there are none."""
    return torch.stack(columns, dim=-1) if columns else like.new_zeros(like.shape[0], 0)


def _tensors(trajectory: Trajectory) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    return (
        torch.from_numpy(trajectory.states),
        torch.from_numpy(trajectory.velocity),
        torch.from_numpy(trajectory.u),
        torch.from_numpy(trajectory.h),
    )
