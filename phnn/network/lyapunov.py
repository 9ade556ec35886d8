"""The forced equilibria of hysteron actuators and the Lyapunov function that shows their stability (paper, Sec. 2.3).

    x* = [Q*, q*, 0],   h_i⁻¹(Q_i*/C_i) = 0,   q* = (α/k)(V − Σ_i Q_i*/C_i) − F/k                       (12)
    H_L(x) = ½ (x − x*)ᵀ 𝓗 (x − x*)                                                                     (15)
    Ḣ_L(x) = −Σ_i (Q_i − Q_i*)/C_i h_i⁻¹(Q_i/C_i) − b (p/m)²                                            (17)

They are written for any separable energy and any resistors on a constant ``J`` and ``g``. There (15) becomes the
Bregman divergence of ``H`` and, with the branch efforts ``ε = Bᵀ∇H``, the difference of ``ẋ`` and ``0 = ẋ*`` gives

    H_L(x) = H(x) − H(x*) − ∇H(x*)ᵀ(x − x*),        Ḣ_L(x) = −Σ_r (ε_r − ε_r*) (φ_r(ε_r) − φ_r(ε_r*)).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from phnn.errors import InputRefused, StructureViolated
from phnn.network.elements import Network
from phnn.network.system import PortHamiltonianSystem

# Share of its flow at twice the effort below which a resistor counts as silent: charges on the edge of a dead zone are
# rounded, and so may lie outside of it.
_SILENT = 1e-12
# A linear spring takes up a force to rounding.
_LINEAR = 1e-9


def shifted_energy(
    system: PortHamiltonianSystem,
    x: Tensor,  # (..., n)
    x_star: Tensor,  # (..., n) an equilibrium
) -> Tensor:
    """(...) ``H_L(x)`` of (15) [J]: zero at ``x*``, positive elsewhere where the energies are strictly convex (16).

    Raises:
        InputRefused: a state of the wrong shape.
        StructureViolated: a network with modulator states.
    """
    _refuse_memories(system.network)
    # H(x) − H(x*) is the discrete gradient times the way, and nothing cancels where both are large and close.
    return ((system.mean_efforts(x_star, x) - system.efforts(x_star)) * (x - x_star)).sum(-1)


def shifted_losses(
    system: PortHamiltonianSystem,
    x: Tensor,  # (..., n)
    x_star: Tensor,  # (..., n) an equilibrium under the present inputs
) -> Tensor:
    """(..., R) ``(ε_r − ε_r*)(φ_r(ε_r) − φ_r(ε_r*))`` of every resistor [W]; those of hysterons are the terms of (18).

    None is negative where a law is monotone, or vanishes exactly on one interval to which ``ε_r*`` belongs.

    Raises:
        InputRefused: a state of the wrong shape.
        StructureViolated: a ratio follows a state, so that the shifted balance has further terms, or a network with
            modulator states.
    """
    _refuse_memories(system.network)
    if system.network.modulations:
        ratio = system.network.modulations[0].ratio
        raise StructureViolated(
            f"the ratio {ratio!r} follows a state: a shifted balance needs constant J and g, leave out the modulation"
        )
    epsilon, epsilon_star = (system.branch_efforts(system.efforts(z), z) for z in (x, x_star))
    flows = system.branch_flows(epsilon, x) - system.branch_flows(epsilon_star, x_star)
    return (epsilon - epsilon_star) * flows


def shifted_rate(
    system: PortHamiltonianSystem,
    x: Tensor,  # (..., n)
    x_star: Tensor,  # (..., n) an equilibrium under the present inputs
) -> Tensor:
    """(...) ``Ḣ_L(x)`` of (17) [W], by the terms and with the errors of `shifted_losses`."""
    return -shifted_losses(system, x, x_star).sum(-1)


@torch.no_grad()
def forced_equilibrium(
    network: Network,
    u: Tensor,  # (..., P) constant inputs
    charges: Tensor,  # (..., h) charges of the hysterons, in the order of the network
) -> Tensor:
    """(..., n) the equilibrium (12) at which the hysterons keep some charges, one of as many as there are charges.

    Hysterons are the storages with a resistor of their own beside the momentum, whatever their laws; the displacement
    of the one linear spring follows from the balance of forces on the momentum.

    Raises:
        InputRefused: a wrong shape, an input that is not finite, or a charge under which its hysteron is not silent,
            ``h_i⁻¹(Q_i*/C_i) ≠ 0``.
        StructureViolated: not one momentum that ports, one linear spring and hysterons act on.
    """
    _refuse_memories(network)
    system, roles = PortHamiltonianSystem(network), _roles(network)
    if charges.shape[-1:] != (len(roles.hysterons),):
        names = ", ".join(network.state_names[k] for k in roles.hysterons) or "none"
        raise InputRefused(
            f"charges have shape {tuple(charges.shape)}: the last dimension must be {len(roles.hysterons)}, the "
            f"number of hysterons ({names})"
        )
    # Refuses a wrong number of ports, too.
    if not bool(torch.isfinite(system.actions(u)).all()):
        raise InputRefused(f"the inputs are not finite ({u.tolist()}): an equilibrium needs finite, constant ones")
    batch = torch.broadcast_shapes(u.shape[:-1], charges.shape[:-1])
    x = charges.new_zeros(*batch, len(network.storages))
    x[..., list(roles.hysterons)] = charges.expand(*batch, -1)
    u = u.expand(*batch, -1)
    force = system.vector_field(x, u)[..., roles.momentum]
    ratio = system.structure(x)[..., roles.spring, roles.momentum]
    x[..., roles.spring] = force / (ratio * system.efforts(torch.ones_like(x))[..., roles.spring])
    _check_silent(system, x)
    taken = ratio * system.efforts(x)[..., roles.spring]
    if not bool(((taken - force).abs() <= _LINEAR * force.abs()).all()):
        name = network.storages[roles.spring].name
        raise StructureViolated(f"the effort of {name} is not proportional to it: (12) needs a linear spring")
    return x


def _refuse_memories(network: Network) -> None:
    """What follows a memory has no constant equilibrium: it moves on while the energy variables are at rest."""
    if network.memories:
        raise StructureViolated(
            f"the modulator state {network.memories[0].name!r} still moves at a forced equilibrium: take the network "
            "without it, with parameters as they are at one value of this state"
        )


class _Roles(NamedTuple):
    """Places of the storages in the state."""

    momentum: int
    spring: int
    hysterons: tuple[int, ...]


def _roles(network: Network) -> _Roles:
    """Which storage is what, in a network of the kind of Proposition 1."""
    names = network.state_names
    edges = {frozenset((c.to, c.of)) for c in network.couplings}
    loaded = {name for r in network.resistors for name in r.on}
    # Two storages alone are coupled with each other: the ports, and by custom the order, say which one is the momentum.
    hubs = [n for n in names if edges == {frozenset((n, other)) for other in names if other != n}]
    hubs = [n for n in hubs if all(set(p.on) == {n} for p in network.ports)]
    if not hubs or network.modulations or any(len(r.on) != 1 for r in network.resistors):
        raise StructureViolated(
            f"(12) is known where one momentum is coupled with all other storages, and these with nothing else; ports "
            f"act on it, every resistor on one storage, and no ratio follows a state (storages: {', '.join(names)})"
        )
    momentum = hubs[-1]
    springs = [n for n in names if n not in loaded and n != momentum]
    if len(springs) != 1:
        raise StructureViolated(
            f"(12) needs exactly one spring without a resistor; here {len(springs)} storages are without "
            f"({', '.join(springs) or 'none'})"
        )
    hysterons = tuple(k for k, n in enumerate(names) if n not in (momentum, springs[0]))
    return _Roles(names.index(momentum), names.index(springs[0]), hysterons)


def _check_silent(system: PortHamiltonianSystem, x: Tensor) -> None:
    """Refuse a state (..., n) at which a resistor is not silent."""
    epsilon = system.branch_efforts(system.efforts(x), x)
    flows = system.branch_flows(epsilon, x)
    # Not finite fails the comparison as well.
    loud = ~(flows.abs() <= _SILENT * system.branch_flows(2.0 * epsilon, x).abs())
    if not bool(loud.any()):
        return
    *member, r = torch.nonzero(loud)[0].tolist()
    resistor = system.network.resistors[r]
    (name,) = resistor.on
    charge = x[(*member, system.state_names.index(name))].item()
    raise InputRefused(
        f"{resistor.name}: the charge {name} = {charge:g} drives a flow of {flows[(*member, r)].item():g} and so does "
        "not stay: give one inside the dead zone"
    )
