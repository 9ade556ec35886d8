"""The integer table that compiled code reads, which inputs its equations contain, and the derivatives that follow.

A single array, because a compiled function is called faster with fewer arrays. Row 0 holds the first row of each kind.
Below, "row" is a row number of this table, "place" an index into the vector ``theta``. "Law" stands for a code with
five places, or a code with the first place and the number of units of a block of weights.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.partition import EXACT, LINEAR_RESISTOR_CODES, LOSSLESS, SCALARS
from phnn.laws import FACTOR_LAWS, MEMORY_LAWS, RESISTOR_LAWS, STORAGE_LAWS

if TYPE_CHECKING:
    from phnn.integrate.program import Program

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

# Kinds of rows, and the content of their columns.
STORAGES = 0  # law (6): in the order of the network
JUNCTIONS = 1  # storage number, unused, whether its effort is linear in its state
LEAVES = 2  # storage number, rule, whether its storage is linear, first and last row of its resistors, links, inlets
LINKS = 3  # junction number; ratio with the sign of J[reducible storage, junction]
LEAF_RESISTORS = 4  # law (6), row of the variable that it reads or -1; ratio
JUNCTION_RESISTORS = 5  # law (6), row of the variable that it reads or -1, first and last row of its branches
BRANCHES = 6  # junction number; ratio
GYRATORS = 7  # junction number, the other junction's number; ratio with the sign of J
PORTS = 8  # law (6)
LEAF_INLETS = 9  # port number; ratio
JUNCTION_INLETS = 10  # port number, junction number; ratio
READS = 11  # number of a reducible storage or -1, of a junction or -1, of a modulator state or -1
FACTORS = (
    12  # law (6), row of the variable that it reads, place of the ratio that it multiplies; first, last row of SCALED
)
MODULATOR_STATES = 13  # law (6), first and last row of its sources; modulator states follow the states of the storages
# One of these, the others being -1: number of a reducible storage (power of its resistors), row of a junction resistor
# (its power), number of a reducible storage (its effort), of a junction (its flow), of a port (its action).
SOURCES = 14
SCALED = 15  # number of a row with a modulated ratio
KINDS = 16
# Columns of a row: the code of its law; the places of its parameters, or of a block of weights and its units; the row
# of the variable that it reads; the ratio that it multiplies; the rows that belong to it.
LAW, PLACE_1, PLACE_2, PLACE_3, PLACE_4, PLACE_5 = range(6)
READ = 6
RATIO_PLACE = 7
FIRST_BRANCH, LAST_BRANCH = 7, 8
FIRST_SCALED, LAST_SCALED = 8, 9
FIRST_SOURCE, LAST_SOURCE = 6, 7
# A junction has the first and the third of these columns, a reducible storage all.
OWN_STORAGE, RULE, IS_LINEAR = range(3)
FIRST_RESISTOR, LAST_RESISTOR, FIRST_LINK, LAST_LINK, FIRST_INLET, LAST_INLET = range(3, 9)
# Of links, branches and gyrators; then of inlets.
TO_JUNCTION, OF_JUNCTION = range(2)
FROM_PORT, INTO_JUNCTION = range(2)
READ_LEAF, READ_JUNCTION, READ_MODULATOR = range(3)
SOURCE_LEAF, SOURCE_RESISTOR, SOURCE_EFFORT, SOURCE_FLOW, SOURCE_PORT = range(5)
# A row with a ratio has its place and its sign in two of the last columns; a row without one has the place -1. The
# columns before are those of row 0.
RATIO, SIGN = 17, 18
# Whether the term of a junction resistor or a gyrator is in the matrix of the constant linear terms.
IN_MATRIX = 19
_COLUMNS = 20

NONE = -1


def stack(rows: Mapping[int, Sequence[Sequence[int]]], ratios: Mapping[int, Sequence[tuple[int, int]]]) -> Integers:
    """The table of the rows of every kind, with the place and sign of the ratios of those kinds that have them."""
    table = np.full((1 + sum(map(len, rows.values())), _COLUMNS), NONE, dtype=np.int64)
    first = 1
    for kind in range(KINDS):
        table[0, kind] = first
        for i, row in enumerate(rows[kind]):
            table[first, : len(row)] = row
            if kind in ratios:
                table[first, RATIO], table[first, SIGN] = ratios[kind][i]
            first += 1
    table[0, KINDS] = first
    return table


def rows_of(table: Integers, kind: int) -> Integers:
    """(…, 20) the rows of one kind."""
    return table[table[0, kind] : table[0, kind + 1]]


# ------------------------------------------------------------------------------------------- inputs of the equations

Inputs = frozenset[int]


class Sparsity(NamedTuple):
    """The inputs of every equation, and properties of the reducible storages' equations.

    Attributes:
        leaves: inputs of the end state, the mean effort and the forces of each reducible storage.
        currents: of each reducible storage's current alone.
        affine: by reducible storage, whether its junctions are linear, and its flow exact with constant thresholds or
            linear and lossless once ratios are known; varies: whether its ratios are modulated.
        plain, others: rows of junction resistors, gyrators and junction inlets: plain ones are linear in one flow or
            action with a constant factor; for the others, their inputs.
        gains: inputs of all modulated ratios.
        modulators: inputs of each modulator state's law, its state included, without its drive;
            sources: of every source except reducible storages.
    """

    leaves: tuple[Inputs, ...]
    currents: tuple[Inputs, ...]
    affine: tuple[bool, ...]
    varies: tuple[bool, ...]
    plain: tuple[int, ...]
    others: Mapping[int, Inputs]
    gains: Inputs
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
        tuple(found.is_affine(leaf) for leaf in leaves),
        tuple(found.varies(leaf) for leaf in leaves),
        tuple(plain),
        {row: frozenset(found.term(row)) for row in terms if row not in plain},
        frozenset().union(*ratios),
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

    def is_affine(self, leaf: int) -> bool:
        """Whether known ratios make the current linear in the unknowns, and the flow exact between constant thresholds,
        or linear and lossless."""
        row, (links, _) = self.leaf_rows[leaf], self._connections(leaf)
        plain = self.table[row[FIRST_RESISTOR], READ] < 0 if row[RULE] == EXACT else row[RULE] == LOSSLESS
        return bool(plain and row[IS_LINEAR] > 0 and all(self.junction_rows[r[TO_JUNCTION], IS_LINEAR] for r in links))

    def varies(self, leaf: int) -> bool:
        """Whether a ratio between a reducible storage and a junction or a port is modulated."""
        links, inlets = self._connections(leaf)
        return bool(self.modulated & {int(r[RATIO]) for r in (*links, *inlets)})

    def _branches(self, row: Integers) -> Integers:
        return self.table[row[FIRST_BRANCH] : row[LAST_BRANCH]]

    def is_plain(self, place: int) -> bool:
        """Whether a term of the junctions is linear in one flow, or in an action, with a constant factor.

        A resistor between junctions takes their difference first, which loses digits as a sum of two terms.
        """
        row, kind = self.table[place], self._kind(place)
        if kind == JUNCTION_RESISTORS:
            rows = self._branches(row)
            linear = row[LAW] in LINEAR_RESISTOR_CODES and row[READ] < 0 and len(rows) == 1
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


# ------------------------------------------------------------------------------- derivatives that are not always zero


class Run(NamedTuple):
    """An integrated program, and how its ports' actions follow the parameters in their laws.

    Attributes:
        states: (n+1, N); efforts: (n, N); h: (n,) sizes of the steps [s].
        actions: (n, P); by_port: (S, n, P) their derivatives.
    """

    states: Array
    efforts: Array
    h: Array
    actions: Array
    by_port: Array


class Pattern(NamedTuple):
    """The nonzero derivatives of a step by states, unknowns and some parameters; inputs are numbered in that order.

    A reducible storage and an input that its equations contain are a *pair*. Pairs are listed storage by storage,
    inputs increasing. Every other list is cut in the same way: entries ``first[k]`` to ``first[k+1]`` belong to element
    ``k``.

    Attributes:
        active: (K,) indices into theta.
        in_ports: (K,) number of a parameter among those in port laws, −1 for the others.
        first, input: of the pairs.
        shifts: (pairs,) whether an input changes the storage's current, except for unknowns of junctions at a constant
            ratio.
        affine, varies: (L,) see `phnn.integrate.program`.
        plain: (R,) rows of the junctions' linear terms; terms: (T,) rows of the others, and their inputs.
        slots: (G,) inputs that change a ratio, the first −1 for none; slot: (I,) the place of an input among them.
        memory, source: inputs of the law of every modulator state and of every source.
    """

    active: Integers
    in_ports: Integers
    first: Integers
    input: Integers
    shifts: NDArray[np.bool_]
    affine: NDArray[np.bool_]
    varies: NDArray[np.bool_]
    plain: Integers
    terms: Integers
    term_first: Integers
    term_input: Integers
    slots: Integers
    slot: Integers
    memory_first: Integers
    memory_input: Integers
    source_first: Integers
    source_input: Integers


@lru_cache(maxsize=256)
def pattern_of(program: Program, active: tuple[int, ...]) -> Pattern:
    """The pattern of a program for the parameters at some entries of theta."""
    table, sparsity, known = program.table, program.sparsity, len(program.states) + len(program.junctions)
    inputs = [*range(known), *(known + place for place in active)]
    in_ports = np.isin(active, rows_of(table, PORTS)[:, PLACE_1 : PLACE_5 + 1])
    first, given = _listed(sparsity.leaves, inputs)
    leaf = np.repeat(np.arange(len(sparsity.leaves)), np.diff(first))
    names = np.array(inputs, dtype=np.int64)[given]
    by_current = [
        (name >= known or sparsity.varies[k]) and name in sparsity.currents[k]
        for k, name in zip(leaf, names, strict=True)
    ]
    ratios = {known + int(place) for place in table[1:, RATIO] if place >= 0}
    slots = [i for i, name in enumerate(inputs) if name in ratios or name in sparsity.gains]
    slot = np.zeros(len(inputs), dtype=np.int64)
    slot[slots] = 1 + np.arange(len(slots))
    return Pattern(
        np.asarray(active, dtype=np.int64),
        np.where(in_ports, np.cumsum(in_ports) - 1, -1),
        first,
        given,
        np.array(by_current, dtype=np.bool_),
        np.array(sparsity.affine, dtype=np.bool_),
        np.array(sparsity.varies, dtype=np.bool_),
        np.array(sparsity.plain, dtype=np.int64),
        np.array(list(sparsity.others), dtype=np.int64),
        *_listed(sparsity.others.values(), inputs),
        np.array([-1, *slots], dtype=np.int64),
        slot,
        *_listed(sparsity.modulators, inputs),
        *_listed(sparsity.sources, inputs),
    )


def _listed(sets: Iterable[frozenset[int]], inputs: list[int]) -> tuple[Integers, Integers]:
    """The start of every set's list, and all lists one after the other: numbers of the inputs in each set."""
    lists = [[i for i, name in enumerate(inputs) if name in found] for found in sets]
    first = np.cumsum([0, *map(len, lists)])
    return first.astype(np.int64), np.array([i for found in lists for i in found], dtype=np.int64)
