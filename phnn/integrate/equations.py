"""The equations of a step of any port-Hamiltonian system in torch, under every `phnn.integrate.scheme.Scheme`.

The unknown is the end state ``x⁺``. The residual of a storage with a discrete gradient is ``x⁺ − x − h [J ē − Σ_r b_r
φ_r(b_rᵀ ē, q̄_r) + g ψ(ū)]``. That of a reducible storage is ``x⁺ − X(x, i)`` with the end state ``X`` that its rule
gives under its current ``i``. That of a modulator state is ``z⁺ − Z(z, s̄)`` with its exact flow. Modulating variables
are taken at mid-step, modulator states at the start of the step.

All steps of any integration satisfy these equations, compiled ones too. They are evaluated by the names of the network
and by the matrices of the torch module, not by the kernel's table, so that `check` notices a wrong table.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from phnn.errors import SolverFailed
from phnn.integrate.roots import radau_defects
from phnn.integrate.scheme import EXACT, NEAR_REST, PATH, Scheme, reducible, resistors_of
from phnn.laws import RESISTOR_LAWS
from phnn.laws.leaf import rc_flow, relaxation
from phnn.laws.wide import is_passive_by_form
from phnn.network.checks import PowerBalance, drives_of, ends_of, evaluation, middle_of
from phnn.network.system import PortHamiltonianSystem, combined

if TYPE_CHECKING:
    from phnn.trajectory import Trajectory

# A motion that dies away passes through subnormal numbers, where relative accuracy is lost.
_NOTHING = 1e-180
# Steps of a recording whose derivatives give the scale of a residual.
_SCALED = 2000

_RULES: WeakKeyDictionary[PortHamiltonianSystem, dict[Scheme, dict[int, int]]] = WeakKeyDictionary()


class Means(NamedTuple):
    """Mean efforts, mid-step variables, currents and end states of a step.

    Attributes:
        efforts: (..., n) mean efforts.
        middle: (..., N) variables that laws read: energy variables at mid-step, modulator states at the start.
        currents, ends: by number of a reducible storage, (...) the current into it and its end state.
    """

    efforts: Tensor
    middle: Tensor
    currents: dict[int, Tensor]
    ends: dict[int, Tensor]


def reducible_rules(system: PortHamiltonianSystem, scheme: Scheme) -> dict[int, int]:
    """Return the storages that a scheme advances by another rule than the discrete gradient, with these rules."""
    known = _RULES.setdefault(system, {})
    if scheme not in known:
        rules = reducible(system.network, scheme)
        known[scheme] = {system.state_names.index(name): rule for name, rule in rules.items()}
    return known[scheme]


def means(
    system: PortHamiltonianSystem, scheme: Scheme, x: Tensor, x_next: Tensor, u: Tensor, h: float | Tensor
) -> Means:
    """Return the mean efforts of a step from ``x`` (..., N) to ``x_next``; arguments as of `step_residual`."""
    middle, rules = middle_of(system, x, x_next), reducible_rules(system, scheme)
    if not rules:
        return Means(system.mean_efforts(x, x_next), middle, {}, {})
    none = torch.zeros_like(middle[..., 0])
    unshared = [
        none if k in rules else none + system.mean_effort(k, x[..., k], x_next[..., k])
        for k in range(len(system.network.storages))
    ]
    # Storages that share an energy are never reducible.
    efforts = list(system.with_shared(torch.stack(unshared, dim=-1), x, x_next).unbind(-1))
    inflow = combined(torch.stack(efforts, dim=-1), system.structure(middle).mT)
    inflow = inflow + combined(system.actions(u), system.incidences(middle)[1].mT)
    currents, ends = {k: inflow[..., k] for k in rules}, {}
    for k, rule in rules.items():
        ends[k], efforts[k] = advanced(
            system, k, rule, x[..., k], currents[k], x_next[..., k], middle, _of_one_storage(h)
        )
    return Means(torch.stack(efforts, dim=-1), middle, currents, ends)


def _of_one_storage(h: float | Tensor) -> float | Tensor:
    """Reshape a step that multiplies states, so that it multiplies one of them."""
    return h[..., 0] if isinstance(h, Tensor) and h.ndim else h


@evaluation
def step_residual(
    system: PortHamiltonianSystem,
    x: Tensor,  # (..., N) state at the start of the step
    x_next: Tensor,  # (..., N) and at its end
    u: Tensor,  # (..., P) mean input of the step
    h: float | Tensor,  # [s], one for all or shaped to multiply states
    scheme: Scheme = Scheme.DISCRETE_GRADIENT,
) -> Tensor:
    """Return the (..., N) residual of the step equations, zero at their solution; steps in a batch are independent."""
    return _residual(system, means(system, scheme, x, x_next, u, h), x, x_next, u, h)


def _residual(
    system: PortHamiltonianSystem, step: Means, x: Tensor, x_next: Tensor, u: Tensor, h: float | Tensor
) -> Tensor:
    """Return the residual of `step_residual` from the means of the step."""
    first = len(system.network.storages)
    residual = x_next[..., :first] - x[..., :first] - h * system.rate(step.efforts, step.middle, u)
    if step.ends:
        columns = list(residual.unbind(-1))
        for k, end in step.ends.items():
            columns[k] = x_next[..., k] - end
        residual = torch.stack(columns, dim=-1)
    if not system.network.memories:
        return residual
    drives = drives_of(system, step.efforts, step.middle, u, _powers(system, step, x, h))
    end = ends_of(system, x[..., first:], drives, h)
    return torch.cat([residual, x_next[..., first:] - end], dim=-1)


def _powers(system: PortHamiltonianSystem, step: Means, x: Tensor, h: float | Tensor) -> dict[int, Tensor]:
    """Return the power (...) ``i ē − ΔH/h`` dissipated on each reducible storage, under its first resistor's number."""
    powers = {}
    for k, end in step.ends.items():
        start = x[..., k]
        stored = system.mean_effort(k, start + 0.0 * end, end) * (end - start) / _of_one_storage(h)
        for place, r in enumerate(resistors_of(system.network, system.state_names[k])):
            total = step.currents[k] * step.efforts[..., k] - stored
            powers[r] = total if place == 0 else torch.zeros_like(end)
    return powers


# ---------------------------------------------------------------------------------------------- derivatives of a step


@evaluation
def linearised(
    system: PortHamiltonianSystem,
    x: Tensor,  # (..., N) state at the start of the step
    z: Tensor,  # (..., N) and at its end
    u: Tensor,  # (..., P)
    h: float | Tensor,
    scheme: Scheme = Scheme.DISCRETE_GRADIENT,
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the (..., N) residual and its (..., N, N) derivatives by the end and by the start of the step.

    The residual is differentiable by all but the two states, where gradients are enabled.
    """
    if has_closed_form(system):
        step = means(system, scheme, x, z, u, h)
        residual = _residual(system, step, x, z, u, h)
        with torch.no_grad():
            return residual, *_closed_form(system, x, z, step, h, reducible_rules(system, scheme))
    with torch.enable_grad():
        end, start = z.detach().requires_grad_(True), x.detach().requires_grad_(True)
        residual = step_residual(system, start, end, u, h, scheme)
        # Members of a batch are independent, so that one backward pass gives one row for all of them.
        each = torch.eye(residual.shape[-1]).to(residual)
        rows = [torch.autograd.grad(residual, (end, start), e.expand_as(residual), retain_graph=True) for e in each]
    by_next, by_start = (torch.stack(r, dim=-2) for r in zip(*rows, strict=True))
    return residual, by_next, by_start


def has_closed_form(system: PortHamiltonianSystem) -> bool:
    """Return whether `_closed_form` serves: no ratio or resistor follows a state, and multi-ports know their slopes."""
    network = system.network
    together = [m.law for m in network.multi_ports] + [e.law for e in network.shared_energies]
    follows = network.modulations or network.memories or any(r.modulated_by for r in network.resistors)
    return not follows and all(map(is_passive_by_form, together))


def _closed_form(
    system: PortHamiltonianSystem, x: Tensor, z: Tensor, step: Means, h: float | Tensor, rules: dict[int, int]
) -> tuple[Tensor, Tensor]:
    """Return the (..., N, N) derivatives of a step's residual by its end and by its start, products of laws' slopes."""
    network, structure = system.network, system.interconnection(step.middle)
    one, size = torch.eye(x.shape[-1]).to(x), h.unsqueeze(-1) if isinstance(h, Tensor) and h.ndim else h

    def efforts(a: Tensor, b: Tensor) -> list[Tensor]:
        return [system.mean_effort(k, a[..., k], b[..., k]) for k in range(x.shape[-1]) if k not in rules]

    by_start, by_end = (torch.diag_embed(slopes) for slopes in _slopes(efforts, x, z))
    for places, law in system.shared:
        for total, of_law in zip((by_start, by_end), law.effort_slopes(x[..., places], z[..., places]), strict=True):
            total[..., torch.tensor(places).unsqueeze(-1), places] += of_law
    ends = {}
    for k, rule in rules.items():
        # The efforts of other storages drive it; its end and its mean effort follow from its states and its current.
        of_leaf = _leaf_slopes(system, k, rule, x[..., k], z[..., k], step, _of_one_storage(h))
        of_end, of_start = ((structure[..., k : k + 1, :] @ by).squeeze(-2) for by in (by_end, by_start))
        end, effort = ((i * of_end + b * one[k], i * of_start + a * one[k]) for a, i, b in of_leaf)
        ends[k] = end
        by_end[..., k, :], by_start[..., k, :] = effort
    by_effort, by_middle = structure.expand_as(by_end), torch.zeros_like(by_end)
    if network.resistors:

        def flows(epsilon: Tensor) -> list[Tensor]:
            return [system.branch_flow(r, e, step.middle) for r, e in enumerate(epsilon.unbind(-1))]

        branches = system.incidences(step.middle)[0]
        (slopes,) = _slopes(flows, combined(step.efforts, branches))
        by_effort = by_effort - (branches * slopes.unsqueeze(-2)) @ branches.mT
    for port in system.multi_ports:
        b = port.columns(system.ratios(step.middle))
        slopes = b @ port.law.flow_slopes(combined(step.efforts, b), step.middle[..., port.reads])
        by_effort = by_effort - slopes[..., : b.shape[-1]] @ b.mT
        by_middle[..., port.reads] -= slopes[..., b.shape[-1] :]
    by_next = one - size * (by_effort @ by_end + 0.5 * by_middle)
    by_first = -one - size * (by_effort @ by_start + 0.5 * by_middle)
    for k, (of_end, of_start) in ends.items():
        by_next[..., k, :], by_first[..., k, :] = one[k] - of_end, -of_start
    return by_next, by_first


def _slopes(values: Callable[..., list[Tensor]], *given: Tensor) -> tuple[Tensor, ...]:
    """Return derivatives (..., K) by tensors (..., K) of values whose k-th depends on their k-th columns alone."""
    with torch.enable_grad():
        at = [g.detach().requires_grad_(True) for g in given]
        # A constant law has a slope too.
        total = torch.stack([v.sum() for v in values(*at)] + [0.0 * a.sum() for a in at]).sum()
        return torch.autograd.grad(total, at)


def _leaf_slopes(
    system: PortHamiltonianSystem, k: int, rule: int, x: Tensor, end: Tensor, step: Means, h: float | Tensor
) -> list[list[Tensor]]:
    """Return derivatives (..., 1) of the end and the mean effort of a reducible storage, by start, current and end."""
    with torch.enable_grad():
        current = step.currents[k]
        at = [v.detach().expand_as(current).clone().requires_grad_(True) for v in (x, current, end)]
        both = advanced(system, k, rule, at[0], at[1], at[2], step.middle, h)
        slopes = [torch.autograd.grad(v.sum(), at, retain_graph=True, materialize_grads=True) for v in both]
    return [[slope.unsqueeze(-1) for slope in by] for by in slopes]


# ------------------------------------------------------------------------------------------------- reducible storages


def advanced(
    system: PortHamiltonianSystem,
    k: int,
    rule: int,
    x: Tensor,  # (...) state at the start of the step
    current: Tensor,  # (...) constant inflow
    end: Tensor,  # (...) state at the end of the step
    middle: Tensor,  # (..., N) state that laws read
    h: float | Tensor,  # [s], a number or (...)
) -> tuple[Tensor, Tensor]:
    """Return the end state and mean effort (...) of ``ẋ = i − Σ_r b_r φ_r(b_r s x)`` under a constant current.

    Args:
        rule: ``EXACT`` for the flow `phnn.laws.leaf.rc_flow`, which the compiled kernels call too; ``PATH`` for the
            closed form of a law of the path; or ``RADAU`` (`phnn.integrate.roots`), which reads the end state that it
            returns: both are equal at the solution alone.
    """
    network, small = system.network, torch.full_like(current, NEAR_REST)
    x, stiffness = x + 0.0 * current, system.mean_effort(k, small, small) / NEAR_REST
    first, *others = resistors_of(network, system.state_names[k])
    resistor = network.resistors[first]
    if rule == PATH:
        path = RESISTOR_LAWS[resistor.law].path
        assert path is not None
        return path(x, current, h, stiffness, *map(system.value, resistor.parameters))
    if rule == EXACT:
        one, thresholds = torch.ones_like(current), RESISTOR_LAWS[resistor.law].thresholds
        if thresholds is None:
            raise SolverFailed(f"{resistor.name}: the law {resistor.law} has no exact flow: take Scheme.RADAU")
        name = resistor.modulated_by
        q = torch.zeros_like(one) if name is None else middle[..., system.state_names.index(name)]
        rho, low, high = thresholds(q, *map(system.value, resistor.parameters))
        leak = sum((system.branch_flow(r, one, middle) for r in others), torch.zeros_like(one))
        relaxed = *relaxation(h * (rho + leak) * stiffness), *relaxation(h * leak * stiffness)
        return rc_flow(x, current, h + 0.0 * one, stiffness, rho, low, high, leak, *relaxed)
    # Both stages: the second is the end, the first follows from the second defect; the first defect is left.
    branches = system.incidences(middle)[0][..., k, :]
    lost = _flows_of(system, k, stiffness * end, branches, middle).sum(0)
    one = x + (2.5 * (end - x) - h * (current - lost)) / 4.5
    lost = torch.stack([_flows_of(system, k, stiffness * one, branches, middle).sum(0), lost])
    defect = radau_defects(one - x, end - x, current, h, *lost)[0]
    return end - 0.75 * defect, stiffness * (0.75 * one + 0.25 * end)


def _flows_of(system: PortHamiltonianSystem, k: int, effort: Tensor, branches: Tensor, middle: Tensor) -> Tensor:
    """Return (R, ...) ``b φ(b ε)`` of the resistors on a storage alone."""
    on = resistors_of(system.network, system.state_names[k])
    return torch.stack([branches[..., r] * system.branch_flow(r, branches[..., r] * effort, middle) for r in on])


# ------------------------------------------------------------------------------ balance and check of integrated steps


@evaluation
def step_balance(
    system: PortHamiltonianSystem, x: Tensor, x_next: Tensor, u: Tensor, h: float | Tensor, scheme: Scheme
) -> PowerBalance:
    """Return mean powers of steps at their mean efforts, at which energy balances exactly [W]; arguments as of
    `step_residual`. Resistors on one reducible storage share its loss in proportion to their flows."""
    step = means(system, scheme, x, x_next, u, h)
    one = _of_one_storage(h)
    balance = system.power(step.efforts, step.middle, u, (system.energy(x_next) - system.energy(x)) / one)
    columns, powers = list(balance.dissipated.unbind(-1)), _powers(system, step, x, h)
    branches = system.incidences(step.middle)[0]
    for k in step.ends:
        on = resistors_of(system.network, system.state_names[k])
        flows = _flows_of(system, k, step.efforts[..., k], branches[..., k, :], step.middle).abs()
        total = flows.sum(0)
        for r, flow in zip(on, flows, strict=True):
            columns[r] = powers[on[0]] * torch.where(total > 0.0, flow / total, 1.0 / len(on))
    lost = torch.stack(columns, dim=-1) if columns else balance.dissipated
    defect = balance.stored - balance.supplied.sum(-1) + lost.sum(-1)
    return PowerBalance(balance.stored, lost, balance.supplied, defect)


def power_balance(trajectory: Trajectory, system: PortHamiltonianSystem | None = None) -> PowerBalance:
    """Return the energy balance of every step of a simulated recording, in joules a step; see `step_balance`."""
    with torch.no_grad():
        system, (x, x_next, u, h) = _steps(trajectory, system)
        balance = step_balance(system, x, x_next, u, h, trajectory.scheme)
        return PowerBalance(*(h.reshape(-1, *[1] * (v.ndim - 1)) * v for v in balance))


def check(trajectory: Trajectory, tolerance: float = 1e-10, system: PortHamiltonianSystem | None = None) -> float:
    """Return the largest residual of a simulated recording, relative to the scale of each equation.

    The scale is the effect of the states' own size, the largest in any step: where a motion rests, it is rounding. Of a
    long recording some steps are enough for it, evenly spread and those with the largest states: derivatives cost far
    more than residuals, and fewer steps can only make the scale smaller.

    Args:
        tolerance: accepted residual.
        system: the module to check against; by default one of the trajectory's own network.

    Raises:
        SolverFailed: a step does not satisfy the equations of the module; names the time and the element.
    """
    system, (x, x_next, u, h) = _steps(trajectory, system)
    if not x.numel():
        return 0.0
    with torch.no_grad():
        residual = step_residual(system, x, x_next, u, h, trajectory.scheme)
    # A step that is not finite has a residual that is not, and no scale; a maximum would not show NaN.
    largest_states = torch.nan_to_num(x_next.abs(), nan=0.0, posinf=0.0).argmax(0)
    spread = torch.linspace(0, len(x) - 1, min(len(x), _SCALED)).long()
    some = torch.cat([spread, largest_states]).unique()
    x, x_next = x[some], x_next[some]
    _, by_next, by_start = linearised(system, x, x_next, u[some], h[some], trajectory.scheme)
    scale = combined(x_next.abs(), by_next.abs().mT) + combined(x.abs(), by_start.abs().mT) + x.abs()
    scale = torch.nan_to_num(scale, nan=0.0, posinf=0.0).amax(0) + _NOTHING
    worst = torch.nan_to_num(residual.abs() / scale, nan=torch.inf)
    n, element = divmod(int(worst.argmax()), worst.shape[1])
    largest = float(worst[n, element])
    if largest > tolerance:
        time = float(trajectory.h[:n].sum()) - trajectory.lead * trajectory.recording.dt
        raise SolverFailed(
            f"{trajectory.recording.name}: the step at t = {time:.6g} s leaves a relative residual of {largest:.2g} at "
            f"the {system.state_names[element]} equation (accepted: {tolerance:.2g}); use smaller steps, and report "
            "the network"
        )
    return largest


def _steps(
    trajectory: Trajectory, system: PortHamiltonianSystem | None
) -> tuple[PortHamiltonianSystem, tuple[Tensor, Tensor, Tensor, Tensor]]:
    """Return the module of a trajectory, and the starts (N, n), ends, inputs (N, P) and sizes (N, 1) of its steps."""
    states, u, h = (torch.from_numpy(a) for a in (trajectory.states, trajectory.u, trajectory.h))
    given = PortHamiltonianSystem(trajectory.setup.network) if system is None else system
    return given, (states[:-1], states[1:], u, h.unsqueeze(-1))
