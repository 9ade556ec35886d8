"""The sources that drive the modulator states of a network, as rows of the kernel's table."""

from __future__ import annotations

from collections.abc import Sequence

from phnn.integrate.tables import (
    NONE,
    SOURCE_EFFORT,
    SOURCE_FLOW,
    SOURCE_LEAF,
    SOURCE_PORT,
    SOURCE_RESISTOR,
)
from phnn.network.elements import ModulatorState, Network


def source_rows(
    network: Network, memory: ModulatorState, leaves: Sequence[str], junctions: Sequence[str]
) -> list[list[int]]:
    """The rows of one modulator state's sources; junction resistors are counted within their kind."""
    on_junctions = [r.name for r in network.resistors if set(r.on) <= set(junctions)]
    ports = [p.name for p in network.ports]
    names = network.drives_of(memory)
    rows: list[list[int]] = []
    for name in names:
        if name in on_junctions:
            rows.append(_row(SOURCE_RESISTOR, on_junctions.index(name)))
        elif name in leaves:
            rows.append(_row(SOURCE_EFFORT, network.state_names.index(name)))
        elif name in junctions:
            rows.append(_row(SOURCE_FLOW, junctions.index(name)))
        elif name in ports:
            rows.append(_row(SOURCE_PORT, ports.index(name)))
        else:
            leaf = next(storage for r in network.resistors if r.name == name for storage in r.on)
            # All resistors of the storage drive the modulator state, or none does: see `phnn.integrate.compilable`.
            together = [r.name for r in network.resistors if tuple(r.on) == (leaf,)]
            if name == together[0]:
                rows.append(_row(SOURCE_LEAF, leaves.index(leaf)))
    return rows


def _row(column: int, value: int) -> list[int]:
    row = [NONE] * 5
    row[column] = value
    return row
