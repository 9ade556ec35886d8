"""What the parts of a network do, read from how they are joined and never from their names.

A *motion* is a displacement and the momentum that moves it: ``q̇ = ∂H/∂p``, ``ṗ = −∂H/∂q + …``. Any storage whose
derivative is the velocity of one inertia alone, with ratio one, is the displacement of that inertia.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from phnn.network.elements import Network, Ratio, Resistor

# Resistor laws of hysterons: nothing flows between two thresholds. Their second parameter is the dead zone.
DEAD_ZONES = ("dead_zone", "following_dead_zone", "rate_dependent_dead_zone", "thermal_dead_zone")
# A charge and a flux are coupled as a displacement and a momentum are; these units tell them apart.
_ELECTRICAL = ("C", "A s", "V s", "Wb")


@dataclass(frozen=True)
class Motion:
    """A displacement and the momentum that moves it, by the names of their storages."""

    displacement: str
    momentum: str


def motions(network: Network) -> tuple[Motion, ...]:
    """Every inertia that has a displacement, the measured one first, then in the order of the network."""
    follows = _velocities(network)
    held = {name for r in network.resistors for name in r.on} | {name for p in network.ports for name in p.on}
    found: dict[str, str] = {}
    for storage in network.storages:
        momentum = follows.get(storage.name)
        if momentum is None or storage.name in held:
            continue
        if momentum not in found or storage.name == network.output:
            found[momentum] = storage.name
    ordered = [Motion(q, p) for p, q in found.items()]
    return tuple(sorted(ordered, key=lambda m: m.displacement != network.output))


def _velocities(network: Network) -> dict[str, str]:
    """Storage to the one whose effort, a velocity, is all of its derivative."""
    sources: dict[str, list[tuple[str, Ratio]]] = {}
    for c in network.couplings:
        sources.setdefault(c.to, []).append((c.of, c.ratio))
        # J[to, of] = ratio and J[of, to] = −ratio.
        sources.setdefault(c.of, []).append((c.to, c.ratio if isinstance(c.ratio, str) else -c.ratio))
    electrical = {s.name for s in network.storages if s.unit in _ELECTRICAL}
    single = {name: found[0] for name, found in sources.items() if len(found) == 1 and name not in electrical}
    return {name: of for name, (of, ratio) in single.items() if ratio == 1.0 and of not in electrical}


def drive_ratio(network: Network, momentum: str) -> str | None:
    """The parameter that is the ratio by which the recorded input acts on an inertia; None where none is."""
    ratio = network.ports[0].on.get(momentum) if network.ports else None
    return ratio if isinstance(ratio, str) else None


def dampings(network: Network) -> list[str]:
    """Coefficients of linear dampers: resistors on what moves."""
    inertias = {m.momentum for m in motions(network)}
    return _named(r.parameters[0] for r in network.resistors if r.law == "linear" and inertias & set(r.on))


def thresholds(network: Network) -> list[str]:
    """Widths of the dead zones of hysterons."""
    return _named(r.parameters[1] for r in hysterons(network))


def capacitances(network: Network) -> list[str]:
    """Capacitances of the hysterons."""
    charged = charges(network)
    return _named(n for s in network.storages if s.name in charged for n in s.parameters)


def ratios(network: Network) -> list[str]:
    """Ratios by which the recorded input acts on what moves."""
    return _named(n for m in motions(network) if (n := drive_ratio(network, m.momentum)) is not None)


def hysterons(network: Network) -> list[Resistor]:
    """Resistors with a dead zone."""
    return [r for r in network.resistors if r.law in DEAD_ZONES]


def charges(network: Network) -> list[str]:
    """Storages of the hysterons, which a dead zone discharges."""
    return _named(name for r in hysterons(network) for name in r.on)


def _named(names: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(names))
