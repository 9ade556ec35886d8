"""Conditions that a setup must satisfy so that an effect can act in it; a failure shows the condition's docstring."""

from __future__ import annotations

from phnn.network.bondgraph.description import effort_unit
from phnn.network.roles import hysterons
from phnn.setup import Setup

# Storage laws of a spring to which a nonlinear term can be added.
SPRINGS = ("spring", "quadratic_spring", "cubic_spring")


def always(setup: Setup) -> bool:
    """Any setup."""
    return True


def has_motion(setup: Setup) -> bool:
    """A momentum ``p`` moves the displacement ``q``: forces can act on it."""
    return any({c.to, c.of} == {"q", "p"} for c in setup.network.couplings)


def has_inertia(setup: Setup) -> bool:
    """A mass of constant inertia moves the displacement ``q``."""
    return has_motion(setup) and any(s.name == "p" and s.law == "capacitor" for s in setup.network.storages)


def inertia(setup: Setup) -> str:
    """The parameter by which the momentum ``p`` is a velocity, where `has_inertia` holds."""
    return next(s.parameters[0] for s in setup.network.storages if s.name == "p")


def has_spring(setup: Setup) -> bool:
    """The displacement ``q`` has a spring of its own, not only a storage that keeps the position."""
    stiffness = [s.parameters[0] for s in setup.network.storages if s.name == "q" and s.law in SPRINGS]
    return has_motion(setup) and any(setup.parameters[name].value > 0.0 for name in stiffness)


def has_dead_zones(setup: Setup) -> bool:
    """At least one resistor has a dead zone: there are hysterons."""
    return bool(hysterons(setup.network))


def has_plain_dead_zones(setup: Setup) -> bool:
    """At least one resistor has a dead zone that follows no state yet."""
    return any(r.law == "dead_zone" for r in setup.network.resistors)


def has_transducer(setup: Setup) -> bool:
    """A parameter ``alpha`` is the ratio by which the voltage port acts on the momentum."""
    ports = setup.network.ports
    return has_motion(setup) and any(p.name == "voltage" and p.on.get("p") == "alpha" for p in ports)


def has_tanks(setup: Setup) -> bool:
    """Stores of constant capacity drain into each other through resistors alone."""
    network = setup.network
    return all(s.law == "capacitor" for s in network.storages) and not network.couplings


def sensed_unit(setup: Setup) -> str:
    """SI unit of the sensor's quantity: of a displacement, or of the effort that an imposed motion requires."""
    network = setup.network
    return next((effort_unit(p.unit) for p in network.ports if p.name == network.senses), "m")
