"""Small motions of a network about rest: ``δẋ = A δx + B δu``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phnn.network.elements import Network

Array = NDArray[np.float64]

# Matrices that are solved together, so that long recordings need little memory.
_TOGETHER = 4096


def linearised_at_rest(network: Network) -> tuple[Array, Array]:
    """``A`` (n, n) and ``B`` (n, P) of the vector field at ``x = 0`` and ``u = 0``, SI; of an input that enters by its
    square, ``B`` is zero."""
    # Imported here: torch takes longer to import than everything else that a command needs.
    import torch

    from phnn.network.system import PortHamiltonianSystem

    system = PortHamiltonianSystem(network)
    at_rest = torch.zeros(len(network.state_names), dtype=torch.float64)
    silent = torch.zeros(len(network.ports), dtype=torch.float64)
    found = torch.autograd.functional.jacobian(system.vector_field, (at_rest, silent))
    return np.asarray(found[0].numpy()), np.asarray(found[1].numpy())


def output_gain(network: Network, f: Array) -> Array:
    """(F,) amplitude of the output over that of a force at frequencies ``f`` [Hz], ``|C (jω − A)⁻¹ B|``.

    The force enters at the first port in newtons, otherwise at the first port. The amplitude is zero where the input
    imposes a motion, and where a law has no finite slope at rest.
    """
    if network.senses:
        return np.zeros(f.size)
    a, b = linearised_at_rest(network)
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        return np.zeros(f.size)
    entry = b[:, next((i for i, p in enumerate(network.ports) if p.unit == "N"), 0)]
    output = network.state_names.index(network.output)
    s, one = 2j * np.pi * f, np.eye(a.shape[0])
    parts = (s[i : i + _TOGETHER, None, None] * one - a for i in range(0, f.size, _TOGETHER))
    found = [np.linalg.solve(p, np.broadcast_to(entry[:, None], (len(p), entry.size, 1)))[:, output, 0] for p in parts]
    return np.abs(np.concatenate(found)) if found else np.zeros(0)
