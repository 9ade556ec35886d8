"""Forced equilibria of hysteron actuators and the Lyapunov function of the paper, Sec. 2.3.

    x* = [Q*, q*, 0],   h_i⁻¹(Q_i*/C_i) = 0,   q* = (α/k)(V − Σ_i Q_i*/C_i) − F/k                       (12)
    H_L(x) = ½ (x − x*)ᵀ 𝓗 (x − x*)                                                                     (15)
    Ḣ_L(x) = −Σ_i (Q_i − Q_i*)/C_i h_i⁻¹(Q_i/C_i) − b (p/m)²                                            (17)

For any separable energy and any resistors on a constant ``J`` and ``g``, (15) is the Bregman divergence of ``H`` and,
with the branch efforts ``ε = Bᵀ∇H``,

    H_L(x) = H(x) − H(x*) − ∇H(x*)ᵀ(x − x*),        Ḣ_L(x) = −Σ_r (ε_r − ε_r*) (φ_r(ε_r) − φ_r(ε_r*)).
"""

from __future__ import annotations

import torch
from torch import Tensor

from phnn.network import Network, PortHamiltonianSystem


def shifted_energy(system: PortHamiltonianSystem, x: Tensor, x_star: Tensor) -> Tensor:
    """(...) ``H_L(x)`` of (15)."""
    # H(x) − H(x*) is the discrete gradient times the way, and nothing cancels where both are large and close.
    return ((system.mean_efforts(x_star, x) - system.efforts(x_star)) * (x - x_star)).sum(-1)


def shifted_losses(system: PortHamiltonianSystem, x: Tensor, x_star: Tensor) -> Tensor:
    """(..., R) the terms of (18), one for each resistor; ``x*`` is an equilibrium under the present inputs."""
    epsilon, epsilon_star = (system.branch_efforts(system.efforts(z), z) for z in (x, x_star))
    return (epsilon - epsilon_star) * (system.branch_flows(epsilon, x) - system.branch_flows(epsilon_star, x_star))


def shifted_rate(system: PortHamiltonianSystem, x: Tensor, x_star: Tensor) -> Tensor:
    """(...) ``Ḣ_L(x)`` of (17)."""
    return -shifted_losses(system, x, x_star).sum(-1)


@torch.no_grad()
def forced_equilibrium(network: Network, u: Tensor, charges: Tensor) -> Tensor:
    """(..., n) the equilibrium (12) at inputs (..., P) and charges (..., h) of the hysterons.

    The momentum is what everything is coupled with, the spring the other storage without a resistor of its own.
    """
    system, names = PortHamiltonianSystem(network), list(network.state_names)
    (momentum,) = {n for p in network.ports for n in p.on}
    loaded = {n for r in network.resistors for n in r.on}
    (spring,) = (n for n in names if n not in loaded and n != momentum)
    hysterons = [k for k, n in enumerate(names) if n not in (momentum, spring)]
    p, q = names.index(momentum), names.index(spring)
    batch = torch.broadcast_shapes(u.shape[:-1], charges.shape[:-1])
    x = charges.new_zeros(*batch, len(names))
    x[..., hysterons] = charges.expand(*batch, -1)
    force, ratio = system.vector_field(x, u.expand(*batch, -1))[..., p], system.structure(x)[..., q, p]
    x[..., q] = force / (ratio * system.efforts(torch.ones_like(x))[..., q])
    return x
