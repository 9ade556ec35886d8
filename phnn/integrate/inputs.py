"""Checks of the arguments of a solve: shapes, types and values of initial states, inputs and steps."""

from __future__ import annotations

import torch
from torch import Tensor

from phnn.errors import InputRefused
from phnn.network.checks import check_state
from phnn.network.system import PortHamiltonianSystem


def port_inputs(system: PortHamiltonianSystem, u: Tensor, batch_dimensions: int) -> Tensor:
    """(N, ..., P) inputs of all ports; inputs without a batch dimension serve every member of the batch."""
    count = len(system.network.ports)
    if u.ndim == 1 and count >= 1:
        u = torch.cat([u.unsqueeze(-1), u.new_zeros(u.shape[0], count - 1)], dim=-1)
    return u.reshape(u.shape[0], *[1] * batch_dimensions, u.shape[-1]) if u.ndim == 2 else u


def check(system: PortHamiltonianSystem, x0: Tensor, u: Tensor, h: Tensor) -> None:
    """Refuse an unsuitable initial state (..., n), inputs of all ports (N, ..., P) or steps (...)."""
    refused = h.detach()[~((h > 0.0) & (h < torch.inf))]
    if refused.numel():
        raise InputRefused(f"a step is {float(refused[0]):g} s: give positive, finite steps")
    check_state(x0, system.state_names)
    numbers = next(system.parameters(), x0.new_zeros(0, dtype=torch.float64)).dtype
    refuse_unfit("initial state", x0, numbers)
    refuse_unfit("mean input", u, numbers)
    system.actions(u[:1])
    fits = u.ndim == x0.ndim + 1 and all(a in (1, b) for a, b in zip(u.shape[1:-1], x0.shape[:-1], strict=True))
    if not fits:
        raise InputRefused(f"inputs of shape {tuple(u.shape)} do not fit an initial state {tuple(x0.shape)}")


def refuse_unfit(name: str, value: Tensor, numbers: torch.dtype = torch.float64) -> None:
    """Refuse a tensor that is not finite, or not of the numbers of its system."""
    if value.dtype != numbers:
        to = ".double()" if numbers == torch.float64 else ".float()"
        raise InputRefused(f"the {name} is {value.dtype}, and the system {numbers}: convert it with {to}")
    if not bool(torch.isfinite(value).all()):
        where = tuple(torch.nonzero(~torch.isfinite(value))[0].tolist())
        raise InputRefused(f"the {name} is not finite at index {where}: remove or repair that sample")
