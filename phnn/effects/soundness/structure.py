"""Checks that a setup is port-Hamiltonian, and that its compiled simulation agrees with the torch module."""

from __future__ import annotations

import numpy as np
import torch

from phnn.effects.soundness.homes import Home, simulated
from phnn.integrate.residual import check, power_balance
from phnn.laws import STORAGE_LAWS
from phnn.network import Network, PortHamiltonianSystem
from phnn.setup import Setup

# Largest relative residual of the compiled simulation in the torch module's equations, and rounding of its structure.
_RESIDUAL, _ROUNDING = 1e-10, 1e-12
# Every seventh state of a simulation is checked.
_EVERY = 7


def sources(network: Network) -> list[bool]:
    """The storages whose energy is not bounded below."""
    return [not STORAGE_LAWS[s.law].bounded for s in network.storages]


def faults(setup: Setup, home: Home) -> list[str]:
    """The defects of a setup's structure on a home's recording, each as half a sentence; empty if there are none.

    Weights aside, the network must be passive: ``J = −Jᵀ``, ``D = Dᵀ ≥ 0``, energies not negative, and in every step
    the ports supply the energy that is stored and dissipated.
    """
    trajectory = simulated(setup, home)
    if not np.isfinite(trajectory.y).all():
        return ["its output is not finite"]
    system = PortHamiltonianSystem(setup.network)
    x, unbounded = torch.from_numpy(trajectory.states)[::_EVERY], torch.tensor(sources(setup.network))
    with torch.no_grad():
        j, d, held = system.structure(x), system.dissipation(x), system.energies(x)
    lost = torch.linalg.eigvalsh(d) + _ROUNDING * d.abs().amax((-2, -1))[:, None]
    balance = power_balance(trajectory, system)
    size = balance.supplied.abs().sum(-1) + balance.dissipated.abs().sum(-1) + held.abs().max()
    sound = {
        "the compiled simulation does not solve the network's equations": check(trajectory, system=system) < _RESIDUAL,
        "J is not skew-symmetric": torch.equal(j, -j.mT),
        "D is not symmetric": torch.equal(d, d.mT),
        "D has a negative eigenvalue": bool((lost >= 0.0).all()),
        "an energy is negative": bool((held[:, ~unbounded] >= 0.0).all()),
        "power is not balanced": bool((balance.defect.abs() <= _ROUNDING * size).all()),
        "a resistor feeds energy in": bool((balance.dissipated >= -_ROUNDING * size[:, None]).all()),
    }
    return [text for text, holds in sound.items() if not holds]
