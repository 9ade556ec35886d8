"""Check of the laws that a network names."""

from __future__ import annotations

from phnn.errors import StructureViolated
from phnn.network.elements import Network, WithLaw


def check_laws(network: Network) -> None:
    """Check that every named law exists and is given as many parameters as it takes.

    Raises:
        StructureViolated: names element and law, and what is accepted.
    """
    if fault := fault_of_laws(network):
        raise StructureViolated(fault)


def fault_of_laws(network: Network) -> str:
    """What is wrong with the laws that a network names; empty if nothing is."""
    return next(filter(None, map(_fault, network.with_laws())), "")


def _fault(one: WithLaw) -> str:
    law, given = one.element.law, one.element.parameters
    if not isinstance(law, str):
        remedy = f"a law that is a torch module holds its own parameters; leave out {', '.join(given)}"
        return f"{one.called}: {remedy}" if given else ""
    if law not in one.laws:
        return f"{one.called}: no law called {law!r}; there are {', '.join(one.laws)}"
    wanted = len(one.laws[law].example)
    if len(given) == wanted:
        return ""
    return f"{one.called}: the law {law} takes {wanted} parameters, {len(given)} are given"
