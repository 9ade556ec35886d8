"""Nonlinear springs and ports: an effect makes one nonlinear, or adds a term to one that is nonlinear already."""

from __future__ import annotations

from dataclasses import replace

from phnn.effects.additions import Placed, with_network
from phnn.network.elements import Port, Storage
from phnn.parameters import as_table
from phnn.setup import Setup


def bent_spring(setup: Setup, law: str, parameters: Placed) -> Setup:
    """The setup whose spring of ``q`` follows ``quadratic_spring`` or ``cubic_spring``, or both.

    Args:
        law: the law to add; the spring may have the other one already.
        parameters: those of the law, its reference displacement last.
    """
    network, mine = setup.network, tuple(parameters)

    def bent(spring: Storage) -> Storage:
        stiffness, *before = spring.parameters
        if spring.law == "spring":
            return replace(spring, law=law, parameters=(stiffness, *mine))
        # The combined law takes the quadratic parameters first.
        names = (*mine, *before) if law == "quadratic_spring" else (*before, *mine)
        return replace(spring, law="bent_spring", parameters=(stiffness, *names))

    # First, as it refuses parameters that a law has already.
    table = as_table((*network.parameters.values(), *parameters.values()))
    storages = tuple(bent(s) if s.name == "q" else s for s in network.storages)
    return with_network(setup, replace(network, storages=storages, parameters=table))


def bent_port(setup: Setup, law: str, parameters: Placed) -> Setup:
    """The setup whose voltage port follows ``electrostriction`` or ``polynomial``, or both.

    Args:
        law: the law to add; the port may have the other one already.
        parameters: those of the law, its reference voltage last.
    """
    network, mine = setup.network, tuple(parameters)

    def bent(port: Port) -> Port:
        if port.name != "voltage":
            return port
        if port.law == "linear":
            return replace(port, law=law, parameters=mine)
        # The combined law takes the parameter of electrostriction first.
        names = (*mine, *port.parameters) if law == "electrostriction" else (*port.parameters, *mine)
        return replace(port, law="electrostrictive_polynomial", parameters=names)

    # First, as it refuses parameters that a law has already.
    table = as_table((*network.parameters.values(), *parameters.values()))
    return with_network(setup, replace(network, ports=tuple(map(bent, network.ports)), parameters=table))
