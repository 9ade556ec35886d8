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
    rooms: tuple[tuple[str, Mapping[str, Any], Sequence[Any]], ...] = (
        ("storage", STORAGE_LAWS, network.storages),
        ("resistor", RESISTOR_LAWS, network.resistors),
        ("port", PORT_LAWS, network.ports),
        ("modulation", FACTOR_LAWS, network.modulations),
        ("memory", MEMORY_LAWS, network.memories),
    )
    for kind, table, elements in rooms:
        for element in elements:
            name = getattr(element, "name", None) or f"of {element.ratio}"
            if not isinstance(element.law, str):
                if element.parameters:
                    raise StructureViolated(
                        f"{kind} {name}: a law that is a torch module holds its own parameters; "
                        f"leave out {', '.join(element.parameters)}"
                    )
                continue
            if element.law not in table:
                raise StructureViolated(f"{kind} {name}: no law called {element.law!r}; there are {', '.join(table)}")
            wanted = len(table[element.law].example)
            if len(element.parameters) != wanted:
                raise StructureViolated(
                    f"{kind} {name}: the law {element.law} takes {wanted} parameters, "
                    f"{len(element.parameters)} are given"
                )
