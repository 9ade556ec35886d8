"""The equations of a step of any port-Hamiltonian system in torch, under every `phnn.integrate.scheme.Scheme`.

The unknown is the end state ``x⁺``. The residual of a storage with a discrete gradient is ``x⁺ − x − h [J ē − Σ_r b_r
φ_r(b_rᵀ ē, q̄_r) + g ψ(ū)]``. That of a reducible storage is ``x⁺ − X(x, i)`` with the end state ``X`` that its rule
gives under its current ``i``. That of a modulator state is ``z⁺ − Z(z, s̄)`` with its exact flow.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from phnn.integrate.partition import reducible, resistors_of
from phnn.integrate.reducible import Surroundings, advanced
from phnn.integrate.scheme import Scheme
from phnn.laws.wide import is_passive_by_form
from phnn.network import modulator_states
from phnn.network.checks import evaluation
from phnn.network.incidence import combined
from phnn.network.system import PortHamiltonianSystem

_KNOWN: WeakKeyDictionary[PortHamiltonianSystem, dict[Scheme, dict[int, int]]] = WeakKeyDictionary()
_SLOPES: WeakKeyDictionary[PortHamiltonianSystem, dict[Scheme, bool]] = WeakKeyDictionary()


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
    """Numbers of the storages that a scheme advances by another rule than the discrete gradient, and these rules."""
    known = _KNOWN.setdefault(system, {})
    if scheme not in known:
        found = reducible(system.network, scheme)
        known[scheme] = {system.state_names.index(name): rule for name, rule in found.items()}
    return known[scheme]


def means(
    system: PortHamiltonianSystem, scheme: Scheme, x: Tensor, x_next: Tensor, u: Tensor, h: float | Tensor
) -> Means:
    """The mean efforts of a step from ``x`` (..., N) to ``x_next``; arguments as of `step_residual`."""
    middle, rules = modulator_states.between(system, x, x_next), reducible_rules(system, scheme)
    if not rules:
        return Means(system.mean_efforts(x, x_next), middle, {}, {})
    none = torch.zeros_like(middle[..., 0])
    efforts = [
        none if k in rules else none + system.mean_effort(k, x[..., k], x_next[..., k])
        for k in range(len(system.network.storages))
    ]
    branches, inputs = system.incidences(middle)
    # Storages that share an energy are never reducible.
    efforts = list(system.with_shared(torch.stack(efforts, dim=-1), x, x_next).unbind(-1))
    inflow = combined(torch.stack(efforts, dim=-1), system.structure(middle).mT) + combined(
        system.actions(u), inputs.mT
    )
    around = Surroundings(system, middle, branches, _of_one_storage(h))
    currents = {k: inflow[..., k] for k in rules}
    ends = {}
    for k, rule in rules.items():
        ends[k], efforts[k] = advanced(around, k, rule, x[..., k], currents[k])
    return Means(torch.stack(efforts, dim=-1), middle, currents, ends)


def _of_one_storage(h: float | Tensor) -> float | Tensor:
    """A step shaped to multiply states, reshaped to multiply one of them."""
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
    """(..., N) residual of the step equations: zero at their solution. Batched states give all steps at once."""
    found, first = means(system, scheme, x, x_next, u, h), len(system.network.storages)
    moved = x_next[..., :first] - x[..., :first] - h * system.rate(found.efforts, found.middle, u)
    if found.ends:
        columns = list(moved.unbind(-1))
        for k, end in found.ends.items():
            columns[k] = x_next[..., k] - end
        moved = torch.stack(columns, dim=-1)
    if not system.network.memories:
        return moved
    drives = modulator_states.drives(system, found.efforts, found.middle, u, _powers(system, found, x, h))
    end = modulator_states.ends(system, x[..., first:], drives, h)
    return torch.cat([moved, x_next[..., first:] - end], dim=-1)


def _powers(system: PortHamiltonianSystem, found: Means, x: Tensor, h: float | Tensor) -> dict[int, Tensor]:
    """(...) power dissipated on each reducible storage, under the number of its first resistor."""
    powers = {}
    for k, end in found.ends.items():
        total = dissipated(system, found, k, x[..., k], _of_one_storage(h))
        for place, r in enumerate(resistors_of(system.network, system.state_names[k])):
            powers[r] = total if place == 0 else torch.zeros_like(end)
    return powers


def dissipated(system: PortHamiltonianSystem, found: Means, k: int, start: Tensor, h: float | Tensor) -> Tensor:
    """(...) mean power ``i ē − ΔH/h`` that the resistors of a reducible storage take."""
    end = found.ends[k]
    stored = system.mean_effort(k, start + 0.0 * end, end) * (end - start) / h
    return found.currents[k] * found.efforts[..., k] - stored


def linearised(
    system: PortHamiltonianSystem,
    x: Tensor,  # (..., N) state at the start of the step
    z: Tensor,  # (..., N) and at its end
    u: Tensor,  # (..., P)
    h: float | Tensor,
    scheme: Scheme = Scheme.DISCRETE_GRADIENT,
) -> tuple[Tensor, Tensor, Tensor]:
    """(..., N) residual and its (..., N, N) derivatives by the end and by the start of the step.

    The residual is differentiable by all but the two states, where gradients are enabled.
    """
    if has_slopes(system, scheme):
        residual = step_residual(system, x, z, u, h, scheme)
        with torch.no_grad():
            return residual, *closed_form(system, x, z, h)
    with torch.enable_grad():
        end, start = z.detach().requires_grad_(True), x.detach().requires_grad_(True)
        residual = step_residual(system, start, end, u, h, scheme)
        # Members of a batch are independent, so that one backward pass gives one row for all of them.
        each = torch.eye(residual.shape[-1]).to(residual)
        rows = [torch.autograd.grad(residual, (end, start), e.expand_as(residual), retain_graph=True) for e in each]
    by_next, by_start = (torch.stack(r, dim=-2) for r in zip(*rows, strict=True))
    return residual, by_next, by_start


def has_slopes(system: PortHamiltonianSystem, scheme: Scheme) -> bool:
    """Whether `closed_form` has the derivatives of the steps: in networks with laws on several variables that know
    their slopes, and beside them resistors and storages that follow one variable each."""
    network = system.network
    if scheme not in _SLOPES.setdefault(system, {}):
        together = [m.law for m in network.multi_ports] + [e.law for e in network.shared_energies]
        others = network.modulations or network.memories or any(r.modulated_by for r in network.resistors)
        known = together and all(is_passive_by_form(law) for law in together)
        _SLOPES[system][scheme] = bool(known and not others and not reducible_rules(system, scheme))
    return _SLOPES[system][scheme]


@evaluation
def closed_form(system: PortHamiltonianSystem, x: Tensor, z: Tensor, h: float | Tensor) -> tuple[Tensor, Tensor]:
    """(..., N, N) derivatives of a step's residual by its end and by its start, as products of the laws' slopes."""
    middle, network = 0.5 * (x + z), system.network
    efforts, branches = system.mean_efforts(x, z), system.incidences(middle)[0]
    by_start, by_end = (torch.diag_embed(s) for s in _elementwise(system.mean_effort, x, z))
    for places, law in system.shared:
        for total, own in zip((by_start, by_end), law.effort_slopes(x[..., places], z[..., places]), strict=True):
            total[..., torch.tensor(places).unsqueeze(-1), places] += own
    by_effort = system.interconnection(middle).expand_as(by_end)
    by_middle = torch.zeros_like(by_end)
    if network.resistors:
        epsilon = combined(efforts, branches)
        (slopes,) = _elementwise(lambda r, e: system.branch_flow(r, e, middle), epsilon)
        by_effort = by_effort - (branches * slopes.unsqueeze(-2)) @ branches.mT
    for port in system.multi_ports:
        b = port.columns(system.ratios(middle))
        slopes = b @ port.law.flow_slopes(combined(efforts, b), middle[..., port.reads])
        by_effort = by_effort - slopes[..., : b.shape[-1]] @ b.mT
        by_middle[..., port.reads] -= slopes[..., b.shape[-1] :]
    h, one = (h.unsqueeze(-1) if isinstance(h, Tensor) and h.ndim else h), torch.eye(x.shape[-1]).to(x)
    half = 0.5 * by_middle
    return one - h * (by_effort @ by_end + half), -one - h * (by_effort @ by_start + half)


def _elementwise(law: Callable[..., Tensor], *given: Tensor) -> list[Tensor]:
    """(..., K) derivatives of functions ``law(k, …)`` of the k-th column of every given tensor, by each of these."""
    with torch.enable_grad():
        at = [[v.detach().requires_grad_(True) for v in t.unbind(-1)] for t in given]
        values = [law(k, *one) for k, one in enumerate(zip(*at, strict=True))]
        flat = [v for columns in at for v in columns]
        found = torch.autograd.grad([v.sum() for v in values], flat, materialize_grads=True)
    return [torch.stack(found[i : i + len(values)], dim=-1) for i in range(0, len(found), len(values))]
