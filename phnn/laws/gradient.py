"""Effort and mean effort of a scalar energy that is known only as a torch function ``H(x)``.

    E(x) = H'(x),        ē(a, b) = (H(b) − H(a))/(b − a) = ∫₀¹ E(a + τ (b − a)) dτ

The quotient keeps the power balance exactly but cancels when ``b → a``; the integral, by Gauss–Legendre
quadrature, is accurate exactly there. Both are used where they are good.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

# Relative differences |b − a|/max(|a|, |b|) below which the quotient's slope, and its value, have lost too
# many digits: an error of eps/δ² in the slope and of eps/δ in the value.
_SLOPE_LOST = 1e-3
_VALUE_LOST = 1e-5
_ANY = 1e-100
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


def effort(energy: Callable[[Tensor], Tensor], x: Tensor) -> Tensor:
    """Return ``H'(x)`` of an elementwise energy, itself differentiable where gradients are enabled."""
    wanted = torch.is_grad_enabled()
    # A graph that x carries must be kept, not detached; inside a no-grad solve there is none to keep.
    z = x if wanted and x.requires_grad else x.detach().requires_grad_(True)
    with torch.enable_grad():
        (slope,) = torch.autograd.grad(energy(z).sum(), z, create_graph=wanted)
    return slope


def mean_effort(energy: Callable[[Tensor], Tensor], a: Tensor, b: Tensor) -> Tensor:
    """Return ``(H(b) − H(a))/(b − a)`` from the start to the end of a step, without cancellation as ``b → a``."""
    difference = b - a
    size = torch.maximum(a.abs(), b.abs()).detach()
    close = difference.detach().abs() <= _SLOPE_LOST * size
    tiny = difference.detach().abs() <= _VALUE_LOST * size
    # Each form is evaluated only on arguments that are good for it: an inf in the unused branch of a `where`
    # would turn into NaN on the way back.
    apart = torch.where(close, a + torch.where(size > 0.0, size, _ANY), b)
    quotient = (energy(apart) - energy(a)) / (apart - a)
    nearby = torch.where(close, difference, torch.zeros_like(difference))
    nodes = 0.5 * (1.0 + torch.as_tensor(_NODES, dtype=a.dtype, device=a.device))
    weights = 0.5 * torch.as_tensor(_WEIGHTS, dtype=a.dtype, device=a.device)
    integral = effort(energy, a.unsqueeze(-1) + nearby.unsqueeze(-1) * nodes) @ weights
    with torch.no_grad():
        resolved = close & ~tiny
        safe = torch.where(resolved, difference, torch.ones_like(difference))
        value = (energy(a + safe) - energy(a)) / safe
        correction = torch.where(resolved, value - integral, torch.zeros_like(integral))
    return torch.where(close, integral + correction, quotient)
