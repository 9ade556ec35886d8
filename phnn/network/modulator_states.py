"""Modulator states of a network in torch: their drives, their rates, and their values after a step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from phnn.laws import MEMORY_LAWS
from phnn.laws.other import advanced

if TYPE_CHECKING:
    from phnn.network.system import PortHamiltonianSystem


def between(
    system: PortHamiltonianSystem,
    a: Tensor,  # (..., n) state at the start of a step
    b: Tensor,  # (..., n) and at its end
) -> Tensor:
    """Return (..., n) what laws read during a step: energy variables in its middle, modulator states at its start."""
    middle = 0.5 * (a + b)
    if not system.network.memories:
        return middle
    first = len(system.network.storages)
    return torch.cat([middle[..., :first], a.expand_as(middle)[..., first:]], dim=-1)


def drives(
    system: PortHamiltonianSystem,
    efforts: Tensor,  # (..., n) efforts of the storages, of a state or averaged over a step
    x: Tensor,  # (..., n+M) state that modulated laws read
    u: Tensor,  # (..., P)
    dissipated: Mapping[int, Tensor] | None = None,
) -> Tensor:
    """Return (..., M) what drives every memory.

    Args:
        dissipated: powers (...) of some resistors by their numbers; those of the others are ``ε φ(ε)``.
    """
    epsilon = system.branch_efforts(efforts, x)
    powers, actions = epsilon * system.branch_flows(epsilon, x), system.actions(u)
    network, known = system.network, dissipated or {}
    found = {r.name: known.get(k, powers[..., k]) for k, r in enumerate(network.resistors)}
    found |= {s.name: efforts[..., k] for k, s in enumerate(network.storages)}
    found |= {p.name: actions[..., k] for k, p in enumerate(network.ports)}
    none = torch.zeros_like(efforts[..., 0])
    return torch.stack([sum((found[n] for n in network.drives_of(m)), none) for m in network.memories], dim=-1)


def rates(
    system: PortHamiltonianSystem,
    z: Tensor,  # (..., M) modulator states
    driven: Tensor,  # (..., M) their drives
) -> Tensor:
    """Return (..., M) ``ż``."""
    laws = [(MEMORY_LAWS[m.law], [*map(system.value, m.parameters)]) for m in system.network.memories]
    found = [law.rate(z[..., k], driven[..., k], *values) for k, (law, values) in enumerate(laws)]
    return torch.stack(found, dim=-1)


def ends(
    system: PortHamiltonianSystem,
    z: Tensor,  # (..., M) modulator states at the start of a step
    driven: Tensor,  # (..., M) their mean drives
    h: float | Tensor,  # [s], one for all or shaped to multiply states
) -> Tensor:
    """Return (..., M) modulator states at the end of a step, by the exact flow under constant drives."""
    return advanced(z, h, rates(system, z, driven), decays(system))


def decays(system: PortHamiltonianSystem) -> Tensor:
    """Return (M,) rates at which that flow decays."""
    memories = system.network.memories
    return torch.stack([MEMORY_LAWS[m.law].decay(*map(system.value, m.parameters)) for m in memories])
