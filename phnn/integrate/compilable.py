"""Test whether the compiled kernels can solve a network; `phnn.integrate.differentiable` solves the others in torch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from phnn.integrate.table_access import SCALARS
from phnn.laws import FACTOR_LAWS, MEMORY_LAWS, PORT_LAWS, RESISTOR_LAWS, STORAGE_LAWS
from phnn.laws.wide import WIDE_RESISTORS, WIDE_STORAGES, form_of
from phnn.network.elements import Network, WithLaw, fault_of_laws

# For each kind of element: the laws with a few parameters, and the torch modules that pass their weights to the kernel.
LAWS: dict[str, tuple[Mapping[str, Any], Mapping[str, Any]]] = {
    "storage": (STORAGE_LAWS, WIDE_STORAGES),
    "resistor": (RESISTOR_LAWS, WIDE_RESISTORS),
    "port": (PORT_LAWS, {}),
    "modulation": (FACTOR_LAWS, {}),
    "memory": (MEMORY_LAWS, {}),
    "multi_port": ({}, {}),
    "shared_energy": ({}, {}),
}


def can_compile(network: Network) -> bool:
    """Whether the compiled kernels solve a network."""
    return not obstacle(network)


def obstacle(network: Network) -> str:
    """The reason why the compiled kernels cannot solve a network, with the remedy; empty if they can."""
    found = map(_law_obstacle, network.with_laws())
    return fault_of_laws(network) or next(filter(None, found), "") or partly_driven(network, network.storage_names)


def _law_obstacle(one: WithLaw) -> str:
    law = one.element.law
    if not isinstance(law, str):
        known = form_of(law) in LAWS[one.kind][1]
        why = "this torch module has no kernel: take simulate, predict or phnn.train, and no imposed motion"
        return "" if known else f"{one.called}: {why}"
    count = len(one.element.parameters)
    return "" if count <= SCALARS else f"{one.called}: {count} parameters; the kernel passes {SCALARS}"


def partly_driven(network: Network, storages: Iterable[str]) -> str:
    """Message for a modulator state that only some of the resistors on one storage drive; empty if there is no such
    state.

    For each of the given storages, a step knows only the total power that the resistors acting on this storage alone
    dissipate.
    """
    for memory in network.memories:
        drives = network.drives_of(memory)
        for storage in storages:
            resistors = [r.name for r in network.resistors if tuple(r.on) == (storage,)]
            named = [name for name in resistors if name in drives]
            missing = [name for name in resistors if name not in drives]
            if named and missing:
                return (
                    f"modulator state {memory.name}: {named[0]} drives it and {missing[0]}, on the same storage "
                    f"{storage}, does not: name both or neither, or take Scheme.MIDPOINT"
                )
    return ""
