"""The trained model: from voltage to displacement, with the coordinates in which it is trained."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn

from phnn.models.neural_ode import NeuralODE
from phnn.network.elements import Network
from phnn.network.system import PortHamiltonianSystem


class Plant(nn.Module):
    """A state space model ``ẋ = f(x, u)``, ``y = y(x)`` with a single input.

    Attributes:
        core: the module that is trained.
        scale: (n,) typical size of every state.
    """

    core: nn.Module
    scale: Tensor

    def inputs(self, u: Tensor) -> Tensor:  # u: (...) [V]
        """(..., P) inputs of all ports."""
        return u.unsqueeze(-1)

    def rate(self, x: Tensor, u: Tensor) -> Tensor:  # x: (..., n), u: (...) [V]
        """(..., n) ``ẋ``."""
        field: Callable[[Tensor, Tensor], Tensor] = self.core.vector_field  # type: ignore[assignment]
        return field(x, self.inputs(u))

    def measured(self, x: Tensor) -> Tensor:  # x: (..., n)
        """(...) displacement [m]."""
        read: Callable[[Tensor], Tensor] = self.core.measured  # type: ignore[assignment]
        return read(x)

    def trained(self) -> list[nn.Parameter]:
        """What an optimiser moves."""
        return list(self.core.parameters())


class LatentPlant(Plant):
    """A black-box model: its weights are its coordinates, its states are of order one."""

    def __init__(self, core: NeuralODE) -> None:
        super().__init__()
        self.core = core
        self.register_buffer("scale", torch.ones(core.states, dtype=torch.float64))


class NetworkPlant(Plant):
    """A network, trained in the coordinates of its parameters (`phnn.network.bounded`) and in learned laws' weights.

    Args:
        given: a network with starting values, or the system that is trained.
        scale: (n,) typical size of every state.

    Attributes:
        near: times and states last found in torch, by the name of a recording: the next iteration begins there.
    """

    def __init__(self, given: Network | PortHamiltonianSystem, scale: Tensor) -> None:
        super().__init__()
        self.core = self.system = PortHamiltonianSystem(given) if isinstance(given, Network) else given
        self.register_buffer("scale", scale)
        self.near: dict[str, tuple[Tensor, Tensor]] = {}
        self.names = tuple(n for n, p in self.system.network.parameters.items() if not p.fixed)

    @property
    def network(self) -> Network:
        """The network with the present parameter values and laws."""
        return self.system.shown()

    def inputs(self, u: Tensor) -> Tensor:
        """(..., P) the voltage at the first port, the others at zero."""
        others = u.new_zeros(*u.shape, len(self.system.network.ports) - 1)
        return torch.cat([u.unsqueeze(-1), others], dim=-1)

    def measured(self, x: Tensor) -> Tensor:
        """(...) state of the measured storage."""
        return x[..., self.system.state_names.index(self.system.network.output)]

    def trained(self) -> list[nn.Parameter]:
        """Coordinates of the parameters, then weights of the learned laws."""
        own = (*self.system.free.parameters(), *self.system.laws.parameters())
        return [p for p in own if p.requires_grad]

    def slopes(self) -> list[float]:
        """``dθ/dz`` of every coordinate."""
        return [self.system.free.slope(name) for name in self.names]
