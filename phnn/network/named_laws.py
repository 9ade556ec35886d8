"""Check of the laws that a network names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from phnn.errors import StructureViolated
from phnn.laws import FACTOR_LAWS, MEMORY_LAWS, PORT_LAWS, RESISTOR_LAWS, STORAGE_LAWS
from phnn.network.elements import Network


def check_laws(network: Network) -> None:
    """Check that every named law exists and is given as many parameters as it takes.

    Raises:
        StructureViolated: names element and law, and what is accepted.
    """
    if fault := fault_of_laws(network):
        raise StructureViolated(fault)


def fault_of_laws(network: Network) -> str:
    """What is wrong with the laws that a network names; empty if nothing is."""
    rooms: tuple[tuple[str, Mapping[str, Any], Sequence[Any]], ...] = (
        ("storage", STORAGE_LAWS, network.storages),
        ("resistor", RESISTOR_LAWS, network.resistors),
        ("port", PORT_LAWS, network.ports),
        ("modulation", FACTOR_LAWS, network.modulations),
        ("memory", MEMORY_LAWS, network.memories),
    )
    found = (_fault(kind, table, element) for kind, table, elements in rooms for element in elements)
    return next(filter(None, found), "")


def _fault(kind: str, table: Mapping[str, Any], element: Any) -> str:
    where = f"{kind} {getattr(element, 'name', None) or f'of {element.ratio}'}"
    given = len(element.parameters)
    if not isinstance(element.law, str):
        names = ", ".join(element.parameters)
        return f"{where}: a law that is a torch module holds its own parameters; leave out {names}" if given else ""
    if element.law not in table:
        return f"{where}: no law called {element.law!r}; there are {', '.join(table)}"
    wanted = len(table[element.law].example)
    if given == wanted:
        return ""
    return f"{where}: the law {element.law} takes {wanted} parameters, {given} are given"
