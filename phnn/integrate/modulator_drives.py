"""Mean drives of the modulator states in integrated steps, by the torch module."""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor

from phnn.network.system import PortHamiltonianSystem


class Steps(Protocol):
    """All integrated steps, as given to `phnn.integrate.residual`."""

    system: PortHamiltonianSystem
    on: dict[int, list[int]]
    x: Tensor
    h: Tensor
    mean: Tensor
    current: Tensor
    actions: Tensor
    end: dict[int, Tensor]

    def branch_powers(self) -> tuple[Tensor, Tensor]:
        """(n, R) efforts on the resistors that join junctions, and flows."""


def drives_and_sizes(steps: Steps) -> tuple[Tensor, Tensor]:
    """(n, M) mean drives of the modulator states, and the sums of the absolute values of their terms."""
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


def _dissipated(steps: Steps, k: int) -> tuple[Tensor, Tensor]:
    """Mean power ``i ē − ΔH/h`` that the resistors of a reducible storage take, and the size of its terms."""
    received = steps.current[:, k] * steps.mean[:, k]
    end = steps.end[k]
    stored = steps.system.mean_effort(k, steps.x[:, k], end) * (end - steps.x[:, k]) / steps.h
    return received - stored, received.abs() + stored.abs()
