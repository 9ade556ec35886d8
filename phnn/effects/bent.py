"""Springs and ports that are bent, or bent further where another effect has bent them already."""

from __future__ import annotations

from dataclasses import replace

from phnn.effects.additions import Placed, with_network
from phnn.network.elements import Port, Storage
from phnn.parameters import as_table
from phnn.setup import Setup


def bent_spring(setup: Setup, law: str, parameters: Placed) -> Setup:
    """The setup with the spring of ``q`` bent by ``quadratic_spring`` or ``cubic_spring``, or by both.

    Args:
        law: of these two; the other one may be there.
        parameters: those of the bend, its reference displacement last.
    """
    network, mine = setup.network, tuple(parameters)

    def bent(spring: Storage) -> Storage:
        stiffness, *before = spring.parameters
        if spring.law == "spring":
            return replace(spring, law=law, parameters=(stiffness, *mine))
        # The law of both takes the quadratic bend first.
        names = (*mine, *before) if law == "quadratic_spring" else (*before, *mine)
        return replace(spring, law="bent_spring", parameters=(stiffness, *names))

    # First, for it refuses parameters that a law has already.
    table = as_table((*network.parameters.values(), *parameters.values()))
    storages = tuple(bent(s) if s.name == "q" else s for s in network.storages)
    return with_network(setup, replace(network, storages=storages, parameters=table))


def bent_port(setup: Setup, law: str, parameters: Placed) -> Setup:
    """The setup with the voltage port bent by ``electrostriction`` or ``polynomial``, or by both.

    Args:
        law: of these two; the other one may be there.
        parameters: those of the bend, its reference voltage last.
    """
    network, mine = setup.network, tuple(parameters)

    def bent(port: Port) -> Port:
        if port.name != "voltage":
            return port
        if port.law == "linear":
            return replace(port, law=law, parameters=mine)
        # The law of both takes that of electrostriction first.
        names = (*mine, *port.parameters) if law == "electrostriction" else (*port.parameters, *mine)
        return replace(port, law="electrostrictive_polynomial", parameters=names)

    # First, for it refuses parameters that a law has already.
    table = as_table((*network.parameters.values(), *parameters.values()))
    return with_network(setup, replace(network, ports=tuple(map(bent, network.ports)), parameters=table))
