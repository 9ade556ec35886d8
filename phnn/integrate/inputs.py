"""Checks of the arguments of a solve: shapes, types and values of initial states, inputs and steps."""

from __future__ import annotations

import torch
from torch import Tensor

from phnn.errors import InputRefused
from phnn.network.system import PortHamiltonianSystem


def port_inputs(system: PortHamiltonianSystem, u: Tensor, batch_dimensions: int) -> Tensor:
    """(N, ..., P) inputs of all ports; inputs without a batch dimension serve every member of the batch."""
    count = len(system.network.ports)
    if u.ndim == 1 and count >= 1:
        u = torch.cat([u.unsqueeze(-1), u.new_zeros(u.shape[0], count - 1)], dim=-1)
    return u.reshape(u.shape[0], *[1] * batch_dimensions, u.shape[-1]) if u.ndim == 2 else u


def check(system: PortHamiltonianSystem, x0: Tensor, u: Tensor, h: float) -> None:
    """Refuse an unsuitable initial state, inputs of all ports (N, ..., P) or step."""
    if not 0.0 < h < float("inf"):
        raise InputRefused(f"the step is {h:g} s: give a positive, finite step")
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


def refuse_unfit_march(system: PortHamiltonianSystem, u: Tensor, h: Tensor, x0: Tensor) -> None:
    """Refuse unsuitable shapes, types or values of inputs (n, P), steps (n,) or an initial state (N,)."""
    states, ports = len(system.state_names), len(system.network.ports)
    for name, tensor, shape in (("initial state", x0, (states,)), ("mean input", u, (u.shape[0], ports))):
        if tuple(tensor.shape) != shape:
            raise InputRefused(f"the {name} has shape {tuple(tensor.shape)}: this network needs {shape}")
    for name, tensor in (("initial state", x0), ("mean input", u), ("step", h)):
        refuse_unfit(name, tensor)
    if not bool((h > 0.0).all()):
        raise InputRefused(f"a step is {float(h.min()):g} s: give positive steps")
