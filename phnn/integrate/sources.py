"""What drives the memories of a network, as rows of the kernel's table."""

from __future__ import annotations

from collections.abc import Sequence

from phnn.errors import StructureViolated
from phnn.integrate.tables import NONE
from phnn.network.elements import Memory, Network

# Columns of a row of sources, see `phnn.integrate.tables`.
_LEAF, _BRANCH, _EFFORT, _FLOW, _PORT = range(5)


def source_rows(network: Network, memory: Memory, leaves: Sequence[str], junctions: Sequence[str]) -> list[list[int]]:
    """The rows of one memory; junction resistors are counted within their kind.

    Raises:
        StructureViolated: only some of the resistors on one leaf drive the memory; what each of them dissipates by
            itself the step does not know.
    """
    on_junctions = [r.name for r in network.resistors if set(r.on) <= set(junctions)]
    ports = [p.name for p in network.ports]
    names = network.drives_of(memory)
    rows: list[list[int]] = []
    for name in names:
        if name in on_junctions:
            rows.append(_row(_BRANCH, on_junctions.index(name)))
        elif name in leaves:
            rows.append(_row(_EFFORT, network.state_names.index(name)))
        elif name in junctions:
            rows.append(_row(_FLOW, junctions.index(name)))
        elif name in ports:
            rows.append(_row(_PORT, ports.index(name)))
        else:
            leaf = next(storage for r in network.resistors if r.name == name for storage in r.on)
            together = [r.name for r in network.resistors if tuple(r.on) == (leaf,)]
            if missing := [other for other in together if other not in names]:
                raise StructureViolated(
                    f"memory {memory.name}: {name} drives it and {missing[0]}, on the same storage {leaf}, does not: "
                    "name both or neither; phnn.integrate.dense tells them apart"
                )
            if name == together[0]:
                rows.append(_row(_LEAF, leaves.index(leaf)))
    return rows


def _row(column: int, value: int) -> list[int]:
    row = [NONE] * 5
    row[column] = value
    return row
