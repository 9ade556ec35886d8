"""Two port-Hamiltonian networks joined through power-conjugate ports: again one network, passive where both are.

What the ports exchange leaves one system as it enters the other: the joint ``J`` is skew, ``D`` and ``H`` are of both
(van der Schaft & Jeltsema 2014, "Port-Hamiltonian Systems Theory").
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, NamedTuple

from phnn.errors import StructureViolated
from phnn.network.elements import Coupling, ModulatorState, Network, Port, Ratio, Resistor, Storage
from phnn.network.relabel import relabelled
from phnn.parameters import Parameter, as_table

Kind = Literal["feedback"] | Storage | Resistor


def interconnect(
    one: Network,
    port: str,
    other: Network,
    other_port: str,
    kind: Kind = "feedback",
    parameters: tuple[Parameter, ...] = (),
) -> Network:
    """Join a port of one network with a port of another.

        feedback:          u₁ = −y₂,  u₂ = y₁          (a force port with a velocity port)
        a `Storage`:       ẋ_s = y₁ + y₂,  u₁ = u₂ = −H_s'(x_s)          (two force ports through a spring)
        a `Resistor`:      u₁ = u₂ = −φ(y₁ + y₂)          (two force ports through a damper; its ``on`` is left empty)

    Two force ports on masses cannot be joined rigidly: their momenta would depend on each other. A spring between them
    says how stiff the joint is.

    Args:
        one: keeps its output, and its storages stay the last ones.
        port, other_port: names of the ports, which are ports no longer.
        kind: how they are joined.
        parameters: of the storage or resistor between.

    Returns:
        A network with the storages of ``other``, the storage between and those of ``one``, and the ports that are left.

    Raises:
        StructureViolated: no such port, a port with a law that is not linear, names that both networks use, a product
            of two named ratios, or a memory that the joined port or no resistor at all drives.
    """
    near, far = _port(one, port), _port(other, other_port)
    _check_names(one, other)
    between = _between(near, far, kind)
    return Network(
        (*other.storages, *between.storages, *one.storages),
        (*other.resistors, *one.resistors, *between.resistors),
        (*other.couplings, *one.couplings, *between.couplings),
        (*(p for p in one.ports if p is not near), *(p for p in other.ports if p is not far)),
        as_table((*one.parameters.values(), *other.parameters.values(), *parameters)),
        one.output,
        (*one.modulations, *other.modulations),
        (*_own(one), *_own(other)),
        one.senses if one.senses != port else "",
    )


class _Between(NamedTuple):
    """The elements that join two ports."""

    storages: tuple[Storage, ...] = ()
    resistors: tuple[Resistor, ...] = ()
    couplings: tuple[Coupling, ...] = ()


def _between(near: Port, far: Port, kind: Kind) -> _Between:
    """What joins two ports; see `interconnect`."""
    if isinstance(kind, Storage):
        ratios = [*near.on.items(), *far.on.items()]
        return _Between((kind,), couplings=tuple(Coupling(kind.name, k, ratio) for k, ratio in ratios))
    if isinstance(kind, Resistor):
        return _Between(resistors=(replace(kind, on={**near.on, **far.on}),))
    if kind == "feedback":
        pairs = ((to, a, of, b) for to, a in far.on.items() for of, b in near.on.items())
        return _Between(couplings=tuple(_coupling(to, a, of, b) for to, a, of, b in pairs))
    raise StructureViolated(f"kind = {kind!r}: write feedback, or give the Storage or Resistor between the ports")


def renamed(network: Network, prefix: str) -> Network:
    """The network with a prefix to the names of its storages, resistors, ports, modulator states and parameters."""

    def labelled(name: str) -> str:
        return prefix + name

    return relabelled(network, labelled, labelled)


def _own(network: Network) -> tuple[ModulatorState, ...]:
    """The modulator states, with the drives of their own network and no resistor of another."""
    for memory in network.memories:
        if not network.drives_of(memory):
            raise StructureViolated(f"memory {memory.name} is driven by nothing: leave it out before joining")
    return tuple(replace(m, of=network.drives_of(m)) for m in network.memories)


def _port(network: Network, name: str) -> Port:
    for port in network.ports:
        if port.name == name:
            if port.law != "linear":
                raise StructureViolated(
                    f"the port {name} has the law {port.law}: only linear ports exchange the power of their "
                    "conjugates; join another port"
                )
            return port
    raise StructureViolated(f"no port called {name!r}: there are {', '.join(p.name for p in network.ports) or 'none'}")


def _check_names(one: Network, other: Network) -> None:
    for what, these, those in (
        ("storage", one.storage_names, other.storage_names),
        ("memory", [m.name for m in one.memories], [m.name for m in other.memories]),
        ("resistor", [r.name for r in one.resistors], [r.name for r in other.resistors]),
        ("port", [p.name for p in one.ports], [p.name for p in other.ports]),
        ("parameter", one.parameters, other.parameters),
    ):
        shared = sorted(set(these) & set(those))
        if shared:
            raise StructureViolated(f"both networks have a {what} {shared[0]}: give one a prefix with renamed()")


def _coupling(to: str, a: Ratio, of: str, b: Ratio) -> Coupling:
    """``J[to, of] = a b``."""
    if not isinstance(a, str) and not isinstance(b, str):
        return Coupling(to, of, a * b)
    number, name = (a, b) if isinstance(b, str) else (b, a)
    if isinstance(number, str) or abs(number) != 1.0:
        raise StructureViolated(
            f"the product {a}*{b} arises between {to} and {of}: introduce a parameter for it, or join the ports "
            "through a storage, which takes each ratio by itself"
        )
    return Coupling(to, of, name) if number > 0.0 else Coupling(of, to, name)
