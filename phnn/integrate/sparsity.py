"""The sparsity of a step's derivatives: the inputs that each equation contains.

Inputs are numbered: states ``0…N−1``, modulator states last; unknowns ``N…N+m−1``; then indices into ``theta``. Any
quantity of a step may drive a modulator state.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from phnn.integrate.dispatch import SCALARS
from phnn.integrate.partition import LINEAR_RESISTOR_CODES
from phnn.integrate.tables import (
    EXACT,
    FACTORS,
    FIRST_BRANCH,
    FIRST_LINK,
    FIRST_RESISTOR,
    FROM_PORT,
    GYRATORS,
    IS_LINEAR,
    JUNCTION_INLETS,
    JUNCTION_RESISTORS,
    JUNCTIONS,
    KINDS,
    LAST_BRANCH,
    LAST_INLET,
    LAST_RESISTOR,
    LAW,
    LEAVES,
    LOSSLESS,
    MODULATOR_STATES,
    OF_JUNCTION,
    OWN_STORAGE,
    PLACE_1,
    PORTS,
    RATIO,
    RATIO_PLACE,
    READ,
    RULE,
    SOURCE_FLOW,
    SOURCE_PORT,
    SOURCE_RESISTOR,
    SOURCES,
    STORAGES,
    TO_JUNCTION,
    Integers,
    rows_of,
)
from phnn.laws import FACTOR_LAWS, MEMORY_LAWS, RESISTOR_LAWS, STORAGE_LAWS

Inputs = frozenset[int]


class Sparsity(NamedTuple):
    """The inputs of every equation, and properties of the reducible storages' equations.

    Attributes:
        leaves: inputs of the end state, the mean effort and the forces of each reducible storage.
        currents: of each reducible storage's current alone; thresholds: of the modulated thresholds of its first
            resistor.
        affine: by reducible storage, whether its junctions are linear, and its flow exact or lossless once ratios and
            thresholds are known; varies: whether its ratios are modulated.
        plain, others: rows of junction resistors, gyrators and junction inlets: plain ones are linear in the flows with
            constant factors; for the others, their inputs.
        gains, scaled: inputs of all modulated ratios, and the rows that have them.
        modulators: inputs of each modulator state's law, its state included, without its drive;
            sources: of every source except reducible storages.
    """

    leaves: tuple[Inputs, ...]
    currents: tuple[Inputs, ...]
    thresholds: tuple[Inputs, ...]
    affine: tuple[bool, ...]
    varies: tuple[bool, ...]
    plain: tuple[int, ...]
    others: Mapping[int, Inputs]
    gains: Inputs
    scaled: tuple[int, ...]
    modulators: tuple[Inputs, ...]
    sources: tuple[Inputs, ...]


def sparsity_of(table: Integers) -> Sparsity:
    """Find the inputs of the equations of a table."""
    found = _Finder(table)
    leaves = range(len(rows_of(table, LEAVES)))
    ranges = [range(table[0, k], table[0, k + 1]) for k in (JUNCTION_RESISTORS, GYRATORS, JUNCTION_INLETS)]
    terms = [row for rows in ranges for row in rows]
    plain = [row for row in terms if found.is_plain(row)]
    ratios = (found.ratio(place) for place in found.modulated)
    return Sparsity(
        tuple(frozenset(found.leaf(leaf)) for leaf in leaves),
        tuple(frozenset(found.current(leaf)) for leaf in leaves),
        tuple(frozenset(found.thresholds(leaf)) for leaf in leaves),
        tuple(found.is_affine(leaf) for leaf in leaves),
        tuple(found.varies(leaf) for leaf in leaves),
        tuple(plain),
        {row: frozenset(found.term(row)) for row in terms if row not in plain},
        frozenset().union(*ratios),
        tuple(np.flatnonzero(np.isin(table[:, RATIO], list(found.modulated))).tolist()),
        tuple(frozenset(found.modulator(k)) for k in range(len(rows_of(table, MODULATOR_STATES)))),
        tuple(frozenset(found.source(row)) for row in rows_of(table, SOURCES)),
    )


class _Finder:
    """Collects the inputs of an equation along all its references."""

    def __init__(self, table: Integers) -> None:
        self.table = table
        self.storages, self.ports = rows_of(table, STORAGES), rows_of(table, PORTS)
        self.junction_rows, self.leaf_rows = rows_of(table, JUNCTIONS), rows_of(table, LEAVES)
        self.unknown = len(self.storages) + len(rows_of(table, MODULATOR_STATES))
        self.theta = self.unknown + len(self.junction_rows)
        self.factors = rows_of(table, FACTORS)
        self.modulated = {int(place) for place in self.factors[:, RATIO_PLACE]}

    def _law(self, row: Integers, laws: Mapping[str, Any]) -> set[int]:
        """Indices of a law's parameters; weights of neural laws are left to the torch module."""
        known = list(laws.values())
        return (
            {self.theta + int(p) for p in row[PLACE_1 : PLACE_1 + len(known[row[LAW]].example)]}
            if row[LAW] < len(known)
            else set()
        )

    def _port(self, k: int) -> set[int]:
        """Indices of a port's law and of its padding, which may carry a given derivative of the action."""
        return {self.theta + int(p) for p in self.ports[k][1 : 1 + SCALARS]}

    def _storage(self, k: int) -> set[int]:
        return self._law(self.storages[k], STORAGE_LAWS)

    def ratio(self, place: int) -> set[int]:
        """Inputs of a ratio."""
        found = {self.theta + int(place)}
        for row in self.factors[self.factors[:, RATIO_PLACE] == place]:
            found |= self._law(row, FACTOR_LAWS) | self._read(row[READ])
        return found

    def _flow(self, j: int) -> set[int]:
        storage, linear = self.junction_rows[j, [OWN_STORAGE, IS_LINEAR]]
        # The mean effort of a linear junction is the unknown itself; elsewhere it follows from both end states.
        return {self.unknown + int(j)} | (set() if linear else {int(storage)} | self._storage(storage))

    def current(self, leaf: int) -> set[int]:
        """Inputs of a reducible storage's current."""
        found: set[int] = set()
        links, inlets = self._connections(leaf)
        for row in links:
            found |= self.ratio(row[RATIO]) | self._flow(row[TO_JUNCTION])
        for row in inlets:
            found |= self._inlet(row)
        return found

    def _connections(self, leaf: int) -> tuple[Integers, Integers]:
        """Rows of a reducible storage's links and of its inlets."""
        first, last, first_inlet, last_inlet = self.leaf_rows[leaf, FIRST_LINK : LAST_INLET + 1]
        return self.table[first:last], self.table[first_inlet:last_inlet]

    def _inlet(self, row: Integers) -> set[int]:
        return self.ratio(row[RATIO]) | self._port(row[FROM_PORT])

    def _read(self, row: int) -> set[int]:
        if row < 0:
            return set()
        leaf, junction, memory = self.table[row, :3]
        if memory >= 0:
            return {int(memory)}
        if leaf >= 0:
            return {int(self.leaf_rows[leaf, OWN_STORAGE])} | self.current(int(leaf))
        storage = int(self.junction_rows[junction, OWN_STORAGE])
        return {storage, self.unknown + int(junction)} | self._storage(storage)

    def _resistor(self, row: Integers) -> set[int]:
        return self._law(row, RESISTOR_LAWS) | self._read(row[READ])

    def leaf(self, leaf: int) -> set[int]:
        """Inputs of the end state, the mean effort and the forces of a reducible storage."""
        row = self.leaf_rows[leaf]
        found = {int(row[OWN_STORAGE])} | self._storage(row[OWN_STORAGE]) | self.current(leaf)
        for resistor in self.table[row[FIRST_RESISTOR] : row[LAST_RESISTOR]]:
            found |= self._resistor(resistor) | self.ratio(resistor[RATIO])
        return found

    def thresholds(self, leaf: int) -> set[int]:
        """Inputs of the modulated thresholds of a reducible storage's first resistor."""
        row = self.leaf_rows[leaf]
        follows = row[RULE] == EXACT and self.table[row[FIRST_RESISTOR], READ] >= 0
        return self._resistor(self.table[row[FIRST_RESISTOR]]) if follows else set()

    def is_affine(self, leaf: int) -> bool:
        """Whether known ratios make the current linear in the unknowns, and the flow is exact or lossless."""
        row, (links, _) = self.leaf_rows[leaf], self._connections(leaf)
        # A nonlinear law with a modulated ratio is differentiated in full.
        plain = row[RULE] == EXACT or (row[RULE] == LOSSLESS and (row[IS_LINEAR] > 0 or not self.varies(leaf)))
        return bool(plain and all(self.junction_rows[r[TO_JUNCTION], IS_LINEAR] for r in links))

    def varies(self, leaf: int) -> bool:
        """Whether a ratio between a reducible storage and a junction or a port is modulated."""
        links, inlets = self._connections(leaf)
        return bool(self.modulated & {int(r[RATIO]) for r in (*links, *inlets)})

    def _branches(self, row: Integers) -> Integers:
        return self.table[row[FIRST_BRANCH] : row[LAST_BRANCH]]

    def is_plain(self, place: int) -> bool:
        """Whether a term of the junctions is linear in the flows, or in an action, with a constant factor."""
        row, kind = self.table[place], self._kind(place)
        if kind == JUNCTION_RESISTORS:
            rows = self._branches(row)
            linear = row[LAW] in LINEAR_RESISTOR_CODES and row[READ] < 0
            ends = rows[:, TO_JUNCTION]
        else:
            rows, linear = row[None], True
            ends = row[:2] if kind == GYRATORS else row[:0]
        constant = not self.modulated & {int(r[RATIO]) for r in rows}
        return bool(linear and constant and all(self.junction_rows[j, IS_LINEAR] for j in ends))

    def _kind(self, place: int) -> int:
        return int(np.searchsorted(self.table[0, :KINDS], place, side="right")) - 1

    def term(self, place: int) -> set[int]:
        """Inputs of a junction resistor's, a gyrator's or a junction inlet's term."""
        row, kind = self.table[place], self._kind(place)
        if kind == JUNCTION_INLETS:
            return self._inlet(row)
        if kind == GYRATORS:
            return self.ratio(row[RATIO]) | self._flow(row[OF_JUNCTION])
        found = self._resistor(row)
        for branch in self._branches(row):
            found |= self.ratio(branch[RATIO]) | self._flow(branch[0])
        return found

    def modulator(self, k: int) -> set[int]:
        """Inputs of a modulator state's law without its drive."""
        return {len(self.storages) + k} | self._law(rows_of(self.table, MODULATOR_STATES)[k], MEMORY_LAWS)

    def source(self, row: Integers) -> set[int]:
        """Inputs of a source of a modulator state; those of a reducible storage are listed with the storage."""
        if row[SOURCE_RESISTOR] >= 0:
            return self.term(int(row[SOURCE_RESISTOR]))
        if row[SOURCE_FLOW] >= 0:
            return self._flow(int(row[SOURCE_FLOW]))
        return self._port(row[SOURCE_PORT]) if row[SOURCE_PORT] >= 0 else set()
