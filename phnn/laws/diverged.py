"""Weights that an optimiser has carried beyond use: not a number, infinite, or too large for any arithmetic."""

from __future__ import annotations

import math

import torch
from torch import nn

from phnn.errors import SolverFailed

# Dimensionless weights are of order one; products of several this large still fit into 32 bits.
LARGEST_WEIGHT = 1e6


def check_weights(module: nn.Module, owner: str = "", largest: float = math.inf) -> None:
    """Refuse parameters of a module that are not finite or not at most ``largest`` in size.

    A NaN would otherwise pass for silence in laws that cut off (``max(NaN, 0)``), and reach results without a name.
    A parameter is looked at again only when it has changed, so that evaluations stay cheap.

    Args:
        module: any module; its buffers are not looked at.
        owner: what stands before a parameter's name in the message.
        largest: bound on every entry.

    Raises:
        SolverFailed: names the parameter, its value and the remedy.
    """
    try:
        state = tuple((id(p), p._version) for p in module.parameters())
    except RuntimeError:
        # Inference tensors count no versions.
        state = None
    if state is not None and module.__dict__.get("_checked") == state:
        return
    for name, parameter in module.named_parameters():
        values = parameter.detach()
        try:
            worst = float(values.abs().amax()) if values.numel() else 0.0
        except RuntimeError:
            # Inside vmap a value has no number; what it maps over is checked outside.
            return
        # Also false for NaN.
        if not (worst <= largest and worst < math.inf):
            raise SolverFailed(
                f"the parameter {owner}{name} is not finite or too large (its largest entry is {worst:g}): a step of "
                "the optimiser was too large; load the last good state and lower the rate of learning"
            )
    object.__setattr__(module, "_checked", state)


def is_finite(values: torch.Tensor) -> bool:
    """Whether all entries are finite; true where that cannot be asked, inside vmap."""
    try:
        return bool(torch.isfinite(values).all())
    except RuntimeError:
        return True
