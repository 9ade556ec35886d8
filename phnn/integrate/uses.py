"""Which inputs the equations of a step contain: the sparsity of its derivatives.

Inputs are numbered: states ``0…N−1``, memories last, unknowns ``N…N+m−1``, then places in ``theta``. What drives a
memory may be anything that a step contains, so that memories have no set.
"""

from __future__ import annotations

from phnn.integrate.dispatch import SCALARS, STORAGE_SCALARS
from phnn.integrate.tables import (
    BRANCHES,
    FACTORS,
    GYRATORS,
    JUNCTION_INLETS,
    JUNCTION_RESISTORS,
    JUNCTIONS,
    LEAVES,
    MEMORIES,
    PORTS,
    RATIO,
    STORAGES,
    Integers,
    rows_of,
)
from phnn.laws import PORT_LAWS, RESISTOR_LAWS, STORAGE_LAWS


def input_sets(table: Integers) -> tuple[frozenset[int], ...]:
    """One set for every leaf and, last, one for the junctions."""
    uses = _Uses(table)
    leaves = [frozenset(uses.leaf(leaf)) for leaf in range(len(rows_of(table, LEAVES)))]
    return (*leaves, frozenset(uses.junctions()))


class _Uses:
    """Collects the inputs of an equation along whatever it refers to."""

    def __init__(self, table: Integers) -> None:
        self.table = table
        self.storages, self.ports = rows_of(table, STORAGES), rows_of(table, PORTS)
        self.junction_rows, self.leaf_rows = rows_of(table, JUNCTIONS), rows_of(table, LEAVES)
        self.unknown = len(self.storages) + len(rows_of(table, MEMORIES))
        self.theta = self.unknown + len(self.junction_rows)
        self.factors = rows_of(table, FACTORS)

    def _law(self, row: Integers, laws: int, scalars: int = SCALARS) -> set[int]:
        """Places of a law's parameters; weights of neural laws are left to the torch module."""
        return set() if row[0] >= laws else {self.theta + int(p) for p in row[1 : 1 + scalars]}

    def _storage(self, k: int) -> set[int]:
        return self._law(self.storages[k], len(STORAGE_LAWS), STORAGE_SCALARS)

    def _ratio(self, place: int) -> set[int]:
        found = {self.theta + int(place)}
        for row in self.factors[self.factors[:, 6] == place]:
            found |= {self.theta + int(p) for p in row[1:5]} | self._read(row[5])
        return found

    def _flow(self, j: int) -> set[int]:
        storage, linear = self.junction_rows[j, :2]
        # The mean effort itself is the unknown of a linear junction; of others it follows from both end states.
        return {self.unknown + int(j)} | (set() if linear else {int(storage)} | self._storage(storage))

    def _current(self, leaf: int) -> set[int]:
        found: set[int] = set()
        first, last, first_inlet, last_inlet = self.leaf_rows[leaf, 5:9]
        for row in self.table[first:last]:
            found |= self._ratio(row[RATIO]) | self._flow(row[0])
        for row in self.table[first_inlet:last_inlet]:
            found |= self._inlet(row)
        return found

    def _inlet(self, row: Integers) -> set[int]:
        return self._ratio(row[RATIO]) | self._law(self.ports[row[0]], len(PORT_LAWS))

    def _read(self, row: int) -> set[int]:
        if row < 0:
            return set()
        leaf, junction, memory = self.table[row, :3]
        if memory >= 0:
            return {int(memory)}
        if leaf >= 0:
            return {int(self.leaf_rows[leaf, 0])} | self._current(int(leaf))
        storage = int(self.junction_rows[junction, 0])
        return {storage, self.unknown + int(junction)} | self._storage(storage)

    def _resistor(self, row: Integers) -> set[int]:
        return self._law(row, len(RESISTOR_LAWS)) | self._read(row[5])

    def leaf(self, leaf: int) -> set[int]:
        """Inputs of the end state and the mean effort of a leaf, and of what it exerts on its junctions."""
        row = self.leaf_rows[leaf]
        found = {int(row[0])} | self._storage(row[0]) | self._current(leaf)
        for resistor in self.table[row[3] : row[4]]:
            found |= self._resistor(resistor) | self._ratio(resistor[RATIO])
        return found

    def junctions(self) -> set[int]:
        """Inputs of the terms of ``F`` that no leaf contributes."""
        found: set[int] = set()
        for j, row in enumerate(self.junction_rows):
            found |= {int(row[0]), self.unknown + j} | self._storage(row[0])
        for row in rows_of(self.table, JUNCTION_RESISTORS):
            found |= self._resistor(row)
        for row in rows_of(self.table, BRANCHES):
            found |= self._ratio(row[RATIO]) | self._flow(row[0])
        for row in rows_of(self.table, GYRATORS):
            found |= self._ratio(row[RATIO]) | self._flow(row[1])
        for row in rows_of(self.table, JUNCTION_INLETS):
            found |= self._inlet(row)
        return found
