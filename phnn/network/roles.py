"""The roles of a network's parts, derived from how they are joined and never from their names; its small motions.

A *motion* is a displacement and the momentum that moves it: ``q̇ = ∂H/∂p``, ``ṗ = −∂H/∂q + …``. Any storage whose
derivative is the velocity of one inertia alone, with ratio one, is the displacement of that inertia.

A motion is *imposed* where a port gives its velocity and the effort at that port is measured, see
`phnn.network.bondgraph.description`; it then counts as the measured one.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.network.elements import Network, Ratio, Resistor

Array = NDArray[np.float64]

# Resistor laws of hysterons: nothing flows between two thresholds. Their second parameter is the dead zone.
DEAD_ZONES = ("dead_zone", "following_dead_zone", "rate_dependent_dead_zone", "thermal_dead_zone")
# A charge and a flux are coupled as a displacement and a momentum are; these units tell them apart.
_ELECTRICAL = ("C", "A s", "V s", "Wb")


@dataclass(frozen=True)
class Motion:
    """A displacement and the momentum that moves it, by the names of their storages."""

    displacement: str
    momentum: str


@dataclass(frozen=True)
class Imposed:
    """A motion that a port imposes, by the names of its storages.

    Attributes:
        contact: its effort is the force, of which the output is the integral; motion: what the port moves.
    """

    contact: str
    motion: Motion


def imposed(network: Network) -> Imposed | None:
    """Return the motion or current that is imposed while its effort is measured; None if the output is a storage."""
    if not network.senses:
        return None
    contact = next(n for p in network.ports if p.name == network.senses for n in p.on)
    moved = [c.to if c.of == contact else c.of for c in network.couplings if contact in (c.to, c.of)]
    (momentum,) = (n for n in moved if n != network.output)
    follows = _flows(network)
    travels = [s.name for s in network.storages if follows.get(s.name) == momentum and s.name not in _held(network)]
    return Imposed(contact, Motion(travels[0], momentum))


def auxiliary(network: Network) -> set[str]:
    """Return the constants of the storages through which a motion is imposed, which nobody has stated."""
    given = imposed(network)
    names = () if given is None else (given.contact, network.output, given.motion.momentum, given.motion.displacement)
    constants = {n for s in network.storages if s.name in names for n in s.parameters}
    return {n for n in constants if network.parameters[n].fixed}


def measured_displacement(network: Network) -> str:
    """Return the storage whose motion is measured: the output, or the displacement that is imposed."""
    given = imposed(network)
    return network.output if given is None else given.motion.displacement


def motions(network: Network) -> tuple[Motion, ...]:
    """Return every inertia that has a displacement, the measured one first, then in the order of the network."""
    follows = _flows(network)
    # A charge follows a flux as a displacement follows a velocity.
    electrical = {s.name for s in network.storages if s.unit in _ELECTRICAL}
    held, measured, given = _held(network), measured_displacement(network), imposed(network)
    if given is not None:
        held |= {given.contact, network.output}
    displacements: dict[str, str] = {}
    for storage in network.storages:
        momentum = follows.get(storage.name)
        if momentum is None or storage.name in held or electrical & {storage.name, momentum}:
            continue
        if momentum not in displacements or storage.name == measured:
            displacements[momentum] = storage.name
    ordered = [Motion(q, p) for p, q in displacements.items()]
    return tuple(sorted(ordered, key=lambda m: m.displacement != measured))


def _held(network: Network) -> set[str]:
    """Return the storages on which resistors and ports act: their derivative is no velocity alone."""
    return {name for r in network.resistors for name in r.on} | {name for p in network.ports for name in p.on}


def _flows(network: Network) -> dict[str, str]:
    """Return the storage to the one whose co-energy is all of its derivative, as a displacement follows a velocity."""
    sources: dict[str, list[tuple[str, Ratio]]] = {}
    for c in network.couplings:
        sources.setdefault(c.to, []).append((c.of, c.ratio))
        # J[to, of] = ratio and J[of, to] = −ratio.
        sources.setdefault(c.of, []).append((c.to, c.ratio if isinstance(c.ratio, str) else -c.ratio))
    return {name: only[0][0] for name, only in sources.items() if len(only) == 1 and only[0][1] == 1.0}


def drive_ratio(network: Network, momentum: str) -> str | None:
    """Return the parameter that is the ratio by which the recorded input acts on an inertia; None where none is."""
    ratio = network.ports[0].on.get(momentum) if network.ports else None
    return ratio if isinstance(ratio, str) else None


def dampings(network: Network) -> list[str]:
    """Return the coefficients of linear dampers: resistors on what moves."""
    inertias = {m.momentum for m in motions(network)}
    return _named(r.parameters[0] for r in network.resistors if r.law == "linear" and inertias & set(r.on))


def thresholds(network: Network) -> list[str]:
    """Return the widths of the dead zones of hysterons."""
    return _named(r.parameters[1] for r in hysterons(network))


def capacitances(network: Network) -> list[str]:
    """Return the capacitances of the hysterons."""
    charged = charges(network)
    return _named(n for s in network.storages if s.name in charged for n in s.parameters)


def ratios(network: Network) -> list[str]:
    """Return the ratios by which the recorded input acts on what moves."""
    return _named(n for m in motions(network) if (n := drive_ratio(network, m.momentum)) is not None)


def hysterons(network: Network) -> list[Resistor]:
    """Return the resistors with a dead zone."""
    return [r for r in network.resistors if r.law in DEAD_ZONES]


def charges(network: Network) -> list[str]:
    """Return the storages of the hysterons, which a dead zone discharges."""
    return _named(name for r in hysterons(network) for name in r.on)


def _named(names: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(names))


# Matrices that are solved together, so that long recordings need little memory.
_TOGETHER = 4096


def linearised_at_rest(network: Network) -> tuple[Array, Array]:
    """Return ``A`` (n, n) and ``B`` (n, P) of small motions about rest, ``δẋ = A δx + B δu``, SI; of an input that
    enters by its square, ``B`` is zero."""
    # Imported here: torch takes longer to import than everything else that a command needs.
    import torch

    from phnn.network.system import PortHamiltonianSystem

    system = PortHamiltonianSystem(network)
    at_rest = torch.zeros(len(network.state_names), dtype=torch.float64)
    silent = torch.zeros(len(network.ports), dtype=torch.float64)
    jacobians = torch.autograd.functional.jacobian(system.vector_field, (at_rest, silent))
    return np.asarray(jacobians[0].numpy()), np.asarray(jacobians[1].numpy())


def output_gain(network: Network, f: Array) -> Array:
    """Return (F,) amplitude of the output over that of a force at frequencies ``f`` [Hz], ``|C (jω − A)⁻¹ B|``.

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
    gains = [np.linalg.solve(p, np.broadcast_to(entry[:, None], (len(p), entry.size, 1)))[:, output, 0] for p in parts]
    return np.abs(np.concatenate(gains)) if gains else np.zeros(0)
