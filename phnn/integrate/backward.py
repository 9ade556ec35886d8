"""The test that the continuous adjoint is accurate enough.

The adjoint integrates backwards in time, where a mode that decays forwards grows.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from phnn.errors import InputRefused
from phnn.integrate.method import ADJOINT_METHOD, METHOD

# Largest decay rate × output spacing at which the adjoint's backward integration is still trusted.
ADJOINT_LIMIT = 5.0
_PROBES = 24


def fastest_decay(
    system: nn.Module,
    t: Tensor,  # ()
    x: Tensor,  # (..., n)
) -> float:
    """Fastest decay rate ``max(−Re λ)`` [1/s] of the linearisation at a time, over a batch of states."""
    with torch.enable_grad():
        z = x.detach().requires_grad_(True)
        rate = system(t.detach(), z)
        # Members of a batch do not see each other: one backward pass gives one row for all of them.
        rows = [torch.autograd.grad(rate[..., i].sum(), z, retain_graph=True)[0] for i in range(rate.shape[-1])]
    return float((-torch.linalg.eigvals(torch.stack(rows, dim=-2)).real).max().clamp_min(0.0))


def check_spacing(system: nn.Module, visited: Sequence[tuple[Tensor, Tensor]], t: Tensor) -> None:
    """Refuse output times (N,) between which the backward integration amplifies errors beyond use.

    Args:
        visited: times and states where the forward integration has been.

    Raises:
        InputRefused: with the rate, the spacing, and how to do without the continuous adjoint.
    """
    chosen = torch.linspace(0, len(visited) - 1, min(_PROBES, len(visited))).round().long().tolist()
    rates = [(fastest_decay(system, *visited[k]), float(visited[k][0])) for k in chosen]
    rate, when = max(rates)
    spacing = float((t[1:] - t[:-1]).max())
    if rate * spacing > ADJOINT_LIMIT:
        raise InputRefused(
            f"the continuous adjoint would return wrong gradients: a mode decays at {rate:.3g} 1/s (t = {when:.4g} s) "
            f"while outputs are {spacing:.3g} s apart, a product of {rate * spacing:.3g} where at most "
            f"{ADJOINT_LIMIT:g} is safe; space outputs at most {ADJOINT_LIMIT / rate:.2g} s, use adjoint=False, or "
            f"method={METHOD!r}, whose own adjoint ({ADJOINT_METHOD}) is exact at any spacing"
        )
