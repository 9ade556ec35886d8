"""Counted violations of passivity: a check of what holds by construction, on states at random."""

from __future__ import annotations

import torch
from torch import Tensor

from phnn.learn.plant import NetworkPlant, Plant
from phnn.models.fully_neural import FullyNeural

# States reach this many times beyond the typical ones.
_BEYOND = 10.0
# What is lost to rounding, relative to the sum of the absolute powers.
_ROUNDING = 1e-12


def violations(plant: Plant, voltage: float, states: int = 10_000, seed: int = 0) -> int | None:
    """How many random states and inputs have ``dH/dt > yᵀu`` by more than rounding; None for a model without energy.

    Args:
        plant: of any kind.
        voltage: typical input [V].
        states: how many are drawn, over three decades of size up to ten times the typical one.
        seed: of the draw.
    """
    random = torch.Generator().manual_seed(seed)
    direction = torch.randn(states, plant.scale.numel(), generator=random, dtype=torch.float64)
    size = _BEYOND * 10.0 ** (-3.0 * torch.rand(states, 1, generator=random, dtype=torch.float64))
    x = direction * size * plant.scale
    u = voltage * torch.randn(states, generator=random, dtype=torch.float64)
    with torch.no_grad():
        gained, supplied, scale = _powers(plant, x, u)
    return None if scale is None else int((gained - supplied > _ROUNDING * scale).sum())


def _powers(plant: Plant, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:
    """(K,) rate of storage, supply, and the sum of the absolute terms."""
    core = plant.core
    if isinstance(plant, NetworkPlant):
        efforts, inputs = plant.system.efforts(x), plant.inputs(u)
        supplied = (plant.system.port_outputs(x, inputs) * inputs).sum(-1)
        terms = efforts * plant.system.rate(efforts, x, inputs)
    elif isinstance(core, FullyNeural):
        efforts = core.efforts(x)
        supplied = (efforts @ core.inlet) * u / core.scales.input / core.scales.time
        terms = efforts * core.rate(efforts, x, plant.inputs(u))
    else:
        return x[:, 0], x[:, 0], None
    return terms.sum(-1), supplied, terms.abs().sum(-1) + supplied.abs()
