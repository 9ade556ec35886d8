"""Springs and ports that are bent, or bent further where another effect has bent them already."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from phnn.network.elements import Network, Port, Storage
from phnn.parameters import Parameter, as_table


def bent_spring(network: Network, law: str, extra: Sequence[Parameter]) -> Network:
    """The network with the spring of ``q`` bent by one of two laws, or by both if it is bent already."""

    def bent(spring: Storage) -> Storage:
        stiffness, *before = spring.parameters
        mine = [p.name for p in extra]
        if spring.law == "spring":
            return replace(spring, law=law, parameters=(stiffness, *mine))
        # The law of both takes the quadratic bend first.
        names = (*mine, *before) if law == "quadratic_spring" else (*before, *mine)
        return replace(spring, law="bent_spring", parameters=(stiffness, *names))

    # First, for it refuses parameters that a law has already.
    parameters = as_table((*network.parameters.values(), *extra))
    storages = tuple(bent(s) if s.name == "q" else s for s in network.storages)
    return replace(network, storages=storages, parameters=parameters)


def bent_port(network: Network, law: str, extra: Sequence[Parameter]) -> Network:
    """The network with the voltage port bent by ``electrostriction`` or ``polynomial``, or by both.

    Args:
        law: of these two; the other one may be there.
        extra: the parameters that take part in it, constants last.
    """

    def bent(port: Port) -> Port:
        mine = tuple(p.name for p in extra)
        if port.name != "voltage":
            return port
        if port.law == "linear":
            return replace(port, law=law, parameters=mine)
        # The law of both takes that of electrostriction first.
        names = (*mine, *port.parameters) if law == "electrostriction" else (*port.parameters, *mine)
        return replace(port, law="electrostrictive_polynomial", parameters=names)

    # First, for it refuses parameters that a law has already.
    parameters = as_table((*network.parameters.values(), *extra))
    return replace(network, ports=tuple(map(bent, network.ports)), parameters=parameters)
