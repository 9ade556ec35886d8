"""A system together with the input that drives it, as the function of time and state that solvers call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from phnn.errors import InputRefused

if TYPE_CHECKING:
    from phnn.network.system import PortHamiltonianSystem


class DrivenSystem(nn.Module):
    """``ẋ = f(x, u(t))``, sharing the parameters of the system.

    Args:
        system: the system that is driven.
        u: time () to input (..., k), or () for a single port. A module's parameters become this module's, so that
            the adjoint method differentiates by them; tensors that a plain function carries do not.
        ports: names of the k ports that ``u`` fills, the others stay at zero; all ports where left out.

    Raises:
        InputRefused: a port that the network does not have, or an input of the wrong shape.
    """

    def __init__(
        self, system: PortHamiltonianSystem, u: Callable[[Tensor], Tensor], ports: Sequence[str] | None = None
    ) -> None:
        super().__init__()
        self.system = system
        self.u = u
        known = [p.name for p in system.network.ports]
        names = known if ports is None else list(ports)
        for name in names:
            if name not in known:
                raise InputRefused(f"no port called {name!r}: this network has {', '.join(known) or 'none'}")
        self.ports = tuple(names)
        self._places = None if names == known else tuple(known.index(name) for name in names)
        self._count = len(known)

    def input(
        self,
        t: Tensor,  # ()
    ) -> Tensor:
        """(..., P) the inputs of all ports at a time."""
        value = self.u(t)
        if value.ndim == 0 and len(self.ports) == 1:
            value = value.unsqueeze(-1)
        if value.shape[-1:] != (len(self.ports),):
            raise InputRefused(
                f"the input function returned shape {tuple(value.shape)} at t = {float(t):g} s: its last dimension "
                f"must be {len(self.ports)} ({', '.join(self.ports)}); name the ports it fills with ports=(...)"
            )
        if self._places is None:
            return value
        full = value.new_zeros(*value.shape[:-1], self._count)
        return full.index_copy(-1, torch.tensor(self._places, device=value.device), value)

    def forward(
        self,
        t: Tensor,  # ()
        x: Tensor,  # (..., n)
    ) -> Tensor:
        """(..., n) ``ẋ`` at a time and state."""
        return self.system.vector_field(x, self.input(t))
