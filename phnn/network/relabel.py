"""A network under other names."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from phnn.network.elements import Coupling, Network, Ratio

Label = Callable[[str], str]


def relabelled(network: Network, element: Label, parameter: Label) -> Network:
    """The same network with every name replaced.

    Args:
        element: gives the name of a storage, resistor, port or memory; parameter: that of a parameter. Two names must
            not become one.
    """

    def ratio(given: Ratio) -> Ratio:
        return parameter(given) if isinstance(given, str) else given

    def parameters(given: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(parameter(n) for n in given)

    def vector(on: Mapping[str, Ratio]) -> dict[str, Ratio]:
        return {element(n): ratio(r) for n, r in on.items()}

    return Network(
        tuple(replace(s, name=element(s.name), parameters=parameters(s.parameters)) for s in network.storages),
        tuple(
            replace(
                r, name=element(r.name), on=vector(r.on), parameters=parameters(r.parameters),
                modulated_by=None if r.modulated_by is None else element(r.modulated_by),
            )
            for r in network.resistors
        ),
        tuple(Coupling(element(c.to), element(c.of), ratio(c.ratio)) for c in network.couplings),
        tuple(
            replace(p, name=element(p.name), on=vector(p.on), parameters=parameters(p.parameters))
            for p in network.ports
        ),
        {parameter(n): replace(p, name=parameter(n)) for n, p in network.parameters.items()},
        element(network.output),
        tuple(
            replace(m, ratio=parameter(m.ratio), by=element(m.by), parameters=parameters(m.parameters))
            for m in network.modulations
        ),
        tuple(
            replace(m, name=element(m.name), parameters=parameters(m.parameters), of=tuple(element(n) for n in m.of))
            for m in network.memories
        ),
        element(network.senses) if network.senses else "",
    )  # fmt: skip
