"""Weights that an optimiser has carried beyond use: not a number, infinite, or too large for any arithmetic."""

from __future__ import annotations

import math
import sys

import torch
from torch import nn

from phnn.errors import InputRefused, SolverFailed

# Dimensionless weights are of order one; products of several this large still fit into 32 bits.
LARGEST_WEIGHT = 1e6


def check_weights(module: nn.Module, owner: str = "", largest: float = math.inf) -> None:
    """Refuse parameters of a module that are not finite or not at most ``largest`` in size.

    A NaN would otherwise pass for silence in laws that cut off (``max(NaN, 0)``), and reach results without a name.

    Args:
        module: any module; its buffers are not looked at.
        owner: what stands before a parameter's name in the message.
        largest: bound on every entry.

    Raises:
        SolverFailed: names the parameter, its value and the remedy.
        InputRefused: a parameter is in 16 bits, which hold no product of several weights.
    """
    if torch.compiler.is_compiling():
        return
    named = [(name, p.detach()) for name, p in module.named_parameters() if p.numel()]
    try:
        # Also false for NaN. Versions count no change by way of ``.data``, so that nothing is remembered.
        if not named or _largest([values for _, values in named]) <= min(largest, sys.float_info.max):
            return
    except RuntimeError:
        # Inside vmap a value has no number; what it maps over is checked outside.
        return
    for name, values in named:
        if values.dtype not in (torch.float32, torch.float64):
            raise InputRefused(f"the parameter {owner}{name} is {values.dtype}: convert with .double() or .float()")
        worst = _largest([values])
        if not worst <= min(largest, sys.float_info.max):
            raise SolverFailed(
                f"the parameter {owner}{name} is not finite or too large (its largest entry is {worst:g}): a step of "
                "the optimiser was too large; load the last good state and lower the rate of learning"
            )


def _largest(tensors: list[torch.Tensor]) -> float:
    """Return the largest absolute entry; NaN where an entry is, or where a tensor is not in 32 or 64 bits."""
    if any(t.dtype not in (torch.float32, torch.float64) for t in tensors):
        return math.nan
    return float(torch.cat([t.reshape(-1) for t in tensors]).abs().amax())


def is_finite(values: torch.Tensor) -> bool:
    """Return whether all entries are finite; true where that cannot be asked, inside vmap."""
    try:
        return bool(torch.isfinite(values).all())
    except RuntimeError:
        return True
