"""Small motions of a network about rest: ``δẋ = A δx + B δu``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phnn.network.elements import Network

Array = NDArray[np.float64]


def linearised_at_rest(network: Network) -> tuple[Array, Array]:
    """``A`` (n, n) and ``B`` (n, P) of the vector field at ``x = 0`` and ``u = 0``, SI; of an input that enters by its
    square, ``B`` is zero."""
    # Imported here: torch takes longer to import than all that a command needs else.
    import torch

    from phnn.network.system import PortHamiltonianSystem

    system = PortHamiltonianSystem(network)
    at_rest = torch.zeros(len(network.state_names), dtype=torch.float64)
    silent = torch.zeros(len(network.ports), dtype=torch.float64)
    found = torch.autograd.functional.jacobian(system.vector_field, (at_rest, silent))
    return np.asarray(found[0].numpy()), np.asarray(found[1].numpy())


def output_gain(network: Network, f: Array) -> Array:
    """(F,) amplitude of the output over that of the first input at frequencies ``f`` [Hz], ``|C (jω − A)⁻¹ B|``; zero
    where the input imposes a motion, and where a law has no finite slope at rest."""
    if network.senses:
        return np.zeros(f.size)
    a, b = linearised_at_rest(network)
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        return np.zeros(f.size)
    # Modal coordinates: one division a frequency and state. Rounding splits equal eigenvalues.
    values, vectors = np.linalg.eig(a)
    ahead = vectors[network.state_names.index(network.output)]
    behind = np.linalg.lstsq(vectors, b[:, 0].astype(complex), rcond=None)[0]
    s = 2j * np.pi * f[:, None]
    return np.asarray(np.abs(np.sum(ahead * behind / (s - values), axis=1)))
