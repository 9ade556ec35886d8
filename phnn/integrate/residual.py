"""The equations of the compiled steps, evaluated by the torch module for all steps at once.

    r_l = x_l⁺ − X_l(x, v̄),     r_j = p_j⁺ − z_j(p, y_j),
    r_F = (z − p)/h − [J ē − Σ_r b_r φ_r(b_rᵀ ē) + g ψ(ū)]     on the junctions,
    r_z = z⁺ − Z(z, s̄)     of modulator states

``X_l`` and ``ē_l`` follow from the constant current by the rule of the reducible storage: the exact flow, Radau's
stages, or the discrete gradient. This module reads the network by its names and through the torch module's matrices,
not through the kernel's table, so that a wrong table is noticed as well.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from phnn.errors import SolverFailed
from phnn.integrate.partition import resistors_of
from phnn.integrate.program import Program
from phnn.integrate.reducible import Surroundings, advanced, shares
from phnn.integrate.stages import gradient_defect
from phnn.integrate.tables import GRADIENT, LOSSLESS
from phnn.network.checks import PowerBalance, evaluation
from phnn.network.modulator_states import ends
from phnn.network.system import PortHamiltonianSystem, combined

if TYPE_CHECKING:
    from phnn.trajectory import Trajectory

# A motion that dies away passes through subnormal numbers, where relative accuracy is lost.
_NOTHING = 1e-180


class Residual(NamedTuple):
    """Residuals of the equations of integrated steps, and the size of the terms that cancel in each.

    Attributes:
        value: (n, N+m) residuals of the states, in the order of the network, and of the junctions' balances [SI].
        scale: (n, N+m) sums of the absolute values of their terms.
    """

    value: Tensor
    scale: Tensor

    def relative(self) -> Tensor:
        """(n, N+m) residuals in units of the scale of their equation: the largest sum of the absolute values of its
        terms in any of the steps. Where a motion rests, the terms of a single step are rounding."""
        # A step that is not finite has a residual that is not, and no scale.
        scale = torch.nan_to_num(self.scale, nan=0.0, posinf=0.0).amax(0)
        return self.value.abs() / (scale + _NOTHING)


class _Steps:
    """All integrated steps, evaluated with the elements of the network."""

    def __init__(
        self, system: PortHamiltonianSystem, program: Program, x: Tensor, ends: Tensor, efforts: Tensor, u: Tensor,
        h: Tensor,
    ) -> None:  # fmt: skip
        self.system, self.program, self.h = system, program, h
        self.storages = len(system.network.storages)
        self.x, self.ends, self.stored = x, ends.detach(), efforts[:, : self.storages].detach()
        self.junctions = [program.states.index(name) for name in program.junctions]
        self.leaves = [program.states.index(name) for name in program.leaves]
        self.on = {k: resistors_of(system.network, program.states[k]) for k in self.leaves}
        self.flow, self.change = {}, {}
        for k in self.junctions:
            self.flow[k], self.change[k] = self._junction(k, ends[:, k], efforts[:, k])
        self.actions = system.actions(u)
        self._middle()
        self.around = Surroundings(system, self.middle, self.branches, h)
        mean = dict(self.flow)
        self.end = {}
        for k in self.leaves:
            self.end[k], mean[k] = self._leaf(k, self.current[:, k])
        self.mean = torch.stack([mean[k] for k in range(self.storages)], dim=-1)

    def _junction(self, k: int, end: Tensor, effort: Tensor) -> tuple[Tensor, Tensor]:
        """Mean effort of a junction at its unknown, and the change of its state."""
        p = self.x[:, k]
        if not self.program.linear[k]:
            return self.system.mean_effort(k, p, end), end - p
        one = torch.ones_like(p)
        return effort, 2.0 * (effort / self.system.mean_effort(k, one, one) - p)

    def _middle(self) -> None:
        """Mid-step variables that laws read, the matrices of every step and the currents into the reducible
        storages."""
        columns = list(self.x.unbind(-1))
        for k in self.junctions:
            columns[k] = columns[k] + 0.5 * self.change[k]
        self._currents(torch.stack(columns, dim=-1))
        # A reducible storage that a law reads has constant ratios: its current is right already.
        for k in self.leaves:
            if not self.on[k]:
                columns[k] = columns[k] + 0.5 * self.h * self.current[:, k]
        self.middle = torch.stack(columns, dim=-1)
        self._currents(self.middle)

    def _currents(self, middle: Tensor) -> None:
        # One matrix for all steps if no ratio is modulated: a copy each would cost the square of the storages.
        fixed = middle.new_zeros(middle.shape[-1])
        self.structure = self.system.structure(middle if self.system.network.modulations else fixed)
        self.branches, self.inputs = self.system.incidences(middle)
        flows = [self.flow.get(k, torch.zeros_like(self.h)) for k in range(self.storages)]
        self.current = combined(torch.stack(flows, dim=-1), self.structure.mT) + combined(self.actions, self.inputs.mT)

    def lost(self, k: int, effort: Tensor) -> Tensor:
        """(n,) flow into the resistors of a reducible storage at an effort."""
        return self.around.lost(k, effort)

    def _leaf(self, k: int, current: Tensor) -> tuple[Tensor, Tensor]:
        """(n,) end state and mean effort of a reducible storage under its constant current."""
        x, rule = self.x[:, k], self.program.rules[self.program.states[k]]
        if rule == LOSSLESS:
            end = x + self.h * current
            return end, self.system.mean_effort(k, x, end)
        if rule == GRADIENT:
            end = self._discrete_gradient(k, x, current)
            return end, self.system.mean_effort(k, x, end)
        # The end state and mean effort are stored: the first of Radau's stages follows from the mean effort.
        one, two = torch.ones_like(self.h), self.ends[:, k]
        stiffness = self.system.mean_effort(k, one, one).detach()
        stages = (4.0 * self.stored[:, k] / stiffness - two) / 3.0, two
        return advanced(self.around, k, rule, x, current, stages)

    def _discrete_gradient(self, k: int, x: Tensor, current: Tensor) -> Tensor:
        """(n,) end state: the kernel has solved the equation; one Newton step carries the derivatives."""
        end = self.ends[:, k].clone().requires_grad_(True)
        with torch.enable_grad():
            lost = self.lost(k, self.system.mean_effort(k, x.detach(), end))
            (slope,) = torch.autograd.grad(lost.sum(), end, retain_graph=True)
        end = end.detach()
        lost = self.lost(k, self.system.mean_effort(k, x, end))
        return end - gradient_defect(end - x, current, self.h, lost) / (1.0 + self.h.detach() * slope)

    def branch_powers(self) -> tuple[Tensor, Tensor]:
        """(n, R) effort on every resistor that joins junctions, and the flow through it; zero for those of reducible
        storages."""
        resistors = self.system.network.resistors
        efforts, flows = [], []
        on = combined(self.mean, self.branches)
        for r, resistor in enumerate(resistors):
            inside = set(resistor.on) <= set(self.program.junctions)
            efforts.append(on[:, r] if inside else torch.zeros_like(self.h))
            flows.append(self.system.branch_flow(r, on[:, r], self.middle) if inside else torch.zeros_like(self.h))
        return columns(efforts, self.h), columns(flows, self.h)


def _drives_and_sizes(steps: _Steps) -> tuple[Tensor, Tensor]:
    """(n, M) mean drives of the modulator states in all steps, and the sums of the absolute values of their terms."""
    network = steps.system.network
    efforts, flows = steps.branch_powers()
    none = torch.zeros_like(steps.h)
    found: dict[str, tuple[Tensor, Tensor]] = {}
    for r, resistor in enumerate(network.resistors):
        power = efforts[:, r] * flows[:, r]
        found[resistor.name] = power, power.abs()
    for k, resistors in steps.on.items():
        # Only the total dissipation of a reducible storage is known; its first resistor stands for all of them.
        for place, r in enumerate(resistors):
            found[network.resistors[r].name] = _dissipated(steps, k) if place == 0 else (none, none)
    for k, storage in enumerate(network.storages):
        found[storage.name] = steps.mean[:, k], steps.mean[:, k].abs()
    for p, port in enumerate(network.ports):
        found[port.name] = steps.actions[:, p], steps.actions[:, p].abs()
    columns = [
        [sum((found[name][i] for name in network.drives_of(m)), none) for m in network.memories] for i in range(2)
    ]
    return torch.stack(columns[0], dim=-1), torch.stack(columns[1], dim=-1)


def _dissipated(steps: _Steps, k: int) -> tuple[Tensor, Tensor]:
    """Mean power ``i ē − ΔH/h`` that the resistors of a reducible storage take, and the size of its terms."""
    received = steps.current[:, k] * steps.mean[:, k]
    end = steps.end[k]
    stored = steps.system.mean_effort(k, steps.x[:, k], end) * (end - steps.x[:, k]) / steps.h
    return received - stored, received.abs() + stored.abs()


def march_residual(
    system: PortHamiltonianSystem,
    program: Program,
    states: Tensor,  # (n+1, N) states in the order of the network
    efforts: Tensor,  # (n, N) mean efforts
    u: Tensor,  # (n, P) mean inputs
    h: Tensor,  # (n,) steps
) -> Residual:
    """The residual of every step, differentiable by all arguments and by the system's parameters.

    Args:
        system: the module of the network that ``program`` was compiled from.
    """
    return steps_residual(system, program, states[:-1], states[1:], efforts, u, h)


@evaluation
def steps_residual(
    system: PortHamiltonianSystem,
    program: Program,
    x: Tensor,  # (n, N) states at the start of the steps
    following: Tensor,  # (n, N) and at their ends
    efforts: Tensor,  # (n, N) mean efforts
    u: Tensor,  # (n, P) mean inputs
    h: Tensor,  # (n,) steps
) -> Residual:
    """The same for steps that need not follow one another, such as those of several integrations."""
    steps = _Steps(system, program, x, following, efforts, u, h)
    through = steps.branch_powers()[1]
    exchanged = combined(steps.mean, steps.structure.mT)
    lost = combined(through, steps.branches.mT)
    driven = combined(steps.actions, steps.inputs.mT)
    # The terms that cancel in a current or a balance, one by one.
    sizes = combined(steps.mean.abs(), steps.structure.abs().mT) + combined(through.abs(), steps.branches.abs().mT)
    sizes = sizes + combined(steps.actions.abs(), steps.inputs.abs().mT)
    values, scales = [], []
    for k in range(steps.storages):
        end = steps.end[k] if k in steps.end else x[:, k] + steps.change[k]
        values.append(following[:, k] - end)
        scales.append(following[:, k].abs() + x[:, k].abs() + h * sizes[:, k])
    if system.network.memories:
        drives, drive_sizes = _drives_and_sizes(steps)
        start, step = x[:, steps.storages :], h.unsqueeze(-1)
        end = ends(system, start, drives, step)
        rounded = (ends(system, start, drives + drive_sizes, step) - end).abs()
        values += (following[:, steps.storages :] - end).unbind(-1)
        scales += (following[:, steps.storages :].abs() + start.abs() + rounded).unbind(-1)
    for k in steps.junctions:
        rate = steps.change[k] / h
        values.append(rate - exchanged[:, k] + lost[:, k] - driven[:, k])
        scales.append(rate.abs() + x[:, k].abs() / h + sizes[:, k])
    return Residual(torch.stack(values, dim=-1), torch.stack(scales, dim=-1).detach())


def check(trajectory: Trajectory, tolerance: float = 1e-10, system: PortHamiltonianSystem | None = None) -> float:
    """The largest relative residual of a simulated recording.

    Args:
        tolerance: accepted residual, relative to the scale of each equation, see `Residual.relative`.
        system: the module to check against; by default one of the trajectory's own network.

    Raises:
        SolverFailed: a step does not satisfy the equations of the module; names the time and the element.
    """
    program = trajectory.program
    system = PortHamiltonianSystem(trajectory.setup.network) if system is None else system
    tensors = _tensors(trajectory)
    with torch.no_grad():
        residual = march_residual(system, program, *tensors)
    if residual.value.numel() == 0:
        return 0.0
    if not bool((residual.relative() <= tolerance).all()):
        residual = residual._replace(scale=residual.scale + rounding(system, program, *tensors))
    # A maximum would not show NaN.
    worst = torch.nan_to_num(residual.relative(), nan=torch.inf)
    n, element = divmod(int(worst.argmax()), worst.shape[1])
    largest = float(worst[n, element])
    if largest > tolerance:
        names = (*program.states, *(f"{name} (balance)" for name in program.junctions))
        time = float(trajectory.h[:n].sum()) - trajectory.lead * trajectory.recording.dt
        raise SolverFailed(
            f"{trajectory.recording.name}: the step at t = {time:.6g} s leaves a relative residual of {largest:.2g} at "
            f"the {names[element]} equation (accepted: {tolerance:.2g}); use smaller steps, and report the network"
        )
    return largest


def rounding(
    system: PortHamiltonianSystem, program: Program, states: Tensor, efforts: Tensor, u: Tensor, h: Tensor
) -> Tensor:
    """(n, N+m) effect of rounding the unknowns on the balances, in units of epsilon."""
    total = torch.zeros(h.shape[0], len(program.states) + len(program.junctions), dtype=h.dtype)
    junctions = [program.states.index(name) for name in program.junctions]
    with torch.enable_grad():
        ends, means = states.clone().requires_grad_(True), efforts.clone().requires_grad_(True)
        value = march_residual(system, program, ends, means, u, h).value
        for column in range(len(program.states), value.shape[1]):
            found = torch.autograd.grad(
                value[:, column].sum(), (ends, means), retain_graph=True, materialize_grads=True
            )
            # A mean effort between two states is rounded by the larger of them.
            by_end, by_mean = found[0][1:] * torch.maximum(states[1:].abs(), states[:-1].abs()), found[1] * efforts
            for k in junctions:
                total[:, column] += (by_mean if program.linear[k] else by_end)[:, k].abs()
    return total


def power_balance(trajectory: Trajectory, system: PortHamiltonianSystem | None = None) -> PowerBalance:
    """The energy balance of every step of a simulated recording, in joules a step.

        stored = H(x⁺) − H(x),   dissipated = h i_l ē_l − ΔH_l on a reducible storage and h ε φ(ε) on junctions,
        supplied = h ψ(ū) gᵀē,   defect = stored − Σ supplied + Σ dissipated

    Returns:
        ``stored`` (n,), ``dissipated`` (n, R) in the order of the network's resistors, ``supplied`` (n, P), ``defect``
        (n,), all at the mean efforts of the steps, with which the balance is exact; nodal efforts give it
        approximately.
    """
    network = trajectory.setup.network
    system = PortHamiltonianSystem(network) if system is None else system
    with torch.no_grad():
        states, efforts, u, h = _tensors(trajectory)
        steps = _Steps(system, trajectory.program, states[:-1], states[1:], efforts, u, h)
        change = system.energies(states).diff(dim=0)
        on, through = steps.branch_powers()
        taken = list((h.unsqueeze(-1) * on * through).unbind(-1))
        for k, resistors in steps.on.items():
            received = h * steps.current[:, k] * steps.stored[:, k] - change[:, k]
            flows = [loss(steps.stored[:, k]) for loss in steps.around.losses(k)]
            for r, share in zip(resistors, shares(flows), strict=True):
                taken[r] = share * received
        supplied = h.unsqueeze(-1) * steps.actions * combined(steps.stored, steps.inputs)
        dissipated = columns(taken, h)
        stored = change.sum(-1)
        return PowerBalance(stored, dissipated, supplied, stored - supplied.sum(-1) + dissipated.sum(-1))


def columns(values: list[Tensor], like: Tensor) -> Tensor:
    """(n, k) array of columns, also for k = 0."""
    return torch.stack(values, dim=-1) if values else like.new_zeros(like.shape[0], 0)


def _tensors(trajectory: Trajectory) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    arrays = (trajectory.states, trajectory.efforts, trajectory.u, trajectory.h)
    states, efforts, u, h = (torch.from_numpy(a) for a in arrays)
    return states, efforts, u, h
