"""What is trained: a model of the path from voltage to displacement, with the coordinates it is trained in."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor, nn

from phnn.models.fully_neural import FullyNeural
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

    def write(self) -> None:
        """Carry moved coordinates into the model."""

    def collect(self) -> None:
        """Carry the model's gradients to the coordinates."""


class LatentPlant(Plant):
    """A black-box or fully neural model: its weights are its coordinates, its states are of order one."""

    def __init__(self, core: FullyNeural | NeuralODE) -> None:
        super().__init__()
        self.core = core
        self.register_buffer("scale", torch.ones(core.states, dtype=torch.float64))


class NetworkPlant(Plant):
    """A network: its physical parameters span decades and are moved in their estimation coordinates ``z``.

    ``log θ`` for positive parameters, ``θ/typical`` for others, within the bounds of `phnn.parameters`. The system
    itself keeps physical values, so that every solver, the adjoint method included, sees an ordinary module; gradients
    by ``z`` follow by the chain rule after each backward pass. Weights of learned laws are dimensionless as they are.

    Args:
        network: with starting values.
        scale: (n,) typical size of every state.
    """

    def __init__(self, network: Network, scale: Tensor) -> None:
        super().__init__()
        self.core = self.system = PortHamiltonianSystem(network)
        self.register_buffer("scale", scale)
        self.names = tuple(n for n, p in network.parameters.items() if not p.fixed)
        start = [network.parameters[n].to_coordinate(network.parameters[n].value) for n in self.names]
        self.z = nn.Parameter(torch.tensor(start, dtype=torch.float64))

    @property
    def network(self) -> Network:
        """The network with the present parameter values and laws."""
        return self.system.as_network()

    def inputs(self, u: Tensor) -> Tensor:
        """(..., P) the voltage at the first port, the others at zero."""
        others = u.new_zeros(*u.shape, len(self.system.network.ports) - 1)
        return torch.cat([u.unsqueeze(-1), others], dim=-1)

    def measured(self, x: Tensor) -> Tensor:
        """(...) state of the measured storage."""
        return x[..., self.system.state_names.index(self.system.network.output)]

    def trained(self) -> list[nn.Parameter]:
        """Coordinates, and weights of the learned laws."""
        return [self.z, *self.system.laws.parameters()] if self.names else list(self.system.laws.parameters())

    @torch.no_grad()
    def write(self) -> None:
        """Set the physical parameters, within their bounds."""
        bounds = [self.system.network.parameters[n].coordinate_bounds for n in self.names]
        self.z.copy_(torch.from_numpy(np.clip(self.z.numpy(), [b[0] for b in bounds], [b[1] for b in bounds])))
        for name, z in zip(self.names, self.z.tolist(), strict=True):
            p = self.system.network.parameters[name]
            self.system.free[name].fill_(min(max(p.from_coordinate(z), p.lower), p.upper))

    @torch.no_grad()
    def collect(self) -> None:
        """``dL/dz = dL/dθ · dθ/dz``."""
        slopes = self.slopes()
        self.z.grad = torch.zeros_like(self.z)
        for k, name in enumerate(self.names):
            found = self.system.free[name].grad
            if found is not None:
                self.z.grad[k] = found * slopes[k]
                self.system.free[name].grad = None

    def slopes(self) -> list[float]:
        """``dθ/dz`` of every coordinate."""
        parameters = self.system.network.parameters
        return [parameters[n].slope(float(self.system.free[n].detach())) for n in self.names]
