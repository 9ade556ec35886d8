"""The linearisation of a network about rest."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from phnn.network.elements import Network
from phnn.network.system import PortHamiltonianSystem

Array = NDArray[np.float64]

# Frequencies over which an integrator is told from a slow relaxation, in cycles per duration, and the growth of the
# gain from one to the other: 1000 for an integrator, 1 for what settles.
_SLOW, _SLOWER, _GROWS = 1e-3, 1e-6, 100.0


def linearised_at_rest(network: Network) -> tuple[Array, Array]:
    """``A = ∂ẋ/∂x`` (n, n) and ``B = ∂ẋ/∂u`` (n, P) at ``x = 0, u = 0``, SI."""
    system = PortHamiltonianSystem(network)
    x = torch.zeros(len(network.state_names), dtype=torch.float64)
    u = torch.zeros(len(network.ports), dtype=torch.float64)
    a, b = torch.autograd.functional.jacobian(system.vector_field, (x, u))
    return a.numpy(), b.numpy()


def integrates(network: Network, duration: float) -> bool:
    """Whether a small constant first input moves the output on and on, as a force does with a carriage on a rail.

    The gain ``|C (iω − A)⁻¹ B|`` from the first port to the output grows as ``1/ω`` where it does.

    Args:
        duration: longest time of interest [s]; a relaxation within a thousand durations is no integrator.
    """
    if network.senses or not network.ports:
        return False
    a, b = linearised_at_rest(network)
    output, identity = network.state_names.index(network.output), np.eye(a.shape[0])

    def gain(cycles: float) -> float:
        response = np.linalg.solve(2j * np.pi * cycles / duration * identity - a, b[:, 0])
        return float(abs(response[output]))

    return gain(_SLOWER) > _GROWS * gain(_SLOW)
