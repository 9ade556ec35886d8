"""Translation of a network to the integer table that the compiled kernels read, and the actions of its ports.

The table is a single array, because a compiled function is called faster with fewer arrays: one row an element, all
kinds one after the other; row 0 holds the first row of each kind. Below, "row" is a row number of this table, "place"
an index into the vector ``theta``. "Law" stands for a code with five places, or a code with the first place and the
number of units of a block of weights.

`phnn.integrate.scheme` decides which storages are junctions and which are reducible. The actions ``ψ_p(u_p)`` depend on
the inputs and parameters alone and on no state: they are computed for all steps before the integration begins.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.errors import StructureViolated
from phnn.integrate.scheme import (
    EXACT,
    LINEAR_RESISTOR_CODES,
    LOSSLESS,
    SCALARS,
    WIDE,
    Scheme,
    junctions_of,
    merged_couplings,
    obstacle,
    resistors_of,
    rule_of,
)
from phnn.laws import FACTOR_LAWS, MEMORY_LAWS, PORT_LAWS, RESISTOR_LAWS, STORAGE_LAWS
from phnn.laws.namespace import TINY
from phnn.laws.wide import form_of
from phnn.network.elements import ModulatorState, Network, Ratio, Resistor, Storage, is_linear
from phnn.network.roles import imposed

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
FACTORS = 12  # law (6), row of the variable that it reads, place of the ratio that it multiplies
MODULATOR_STATES = 13  # law (6), first and last row of its sources; modulator states follow the states of the storages
# One of these, the others being -1: number of a reducible storage (power of its resistors), row of a junction resistor
# (its power), number of a reducible storage (its effort), of a junction (its flow), of a port (its action).
SOURCES = 14
SCALED = 15  # row whose ratio is modulated
KINDS = 16
# Columns of a row: the code of its law; the places of its parameters, or of a block of weights and its units; the row
# of the variable that it reads; the ratio that it multiplies; the rows that belong to it.
LAW, PLACE_1, PLACE_2, _, _, PLACE_5 = range(6)
READ = 6
RATIO_PLACE = 7
FIRST_BRANCH, LAST_BRANCH = 7, 8
FIRST_SOURCE, LAST_SOURCE = 6, 7
# A junction has the first and the third of these columns, a reducible storage all.
OWN_STORAGE, RULE, IS_LINEAR = range(3)
FIRST_RESISTOR, LAST_RESISTOR, FIRST_LINK, LAST_LINK, FIRST_INLET, LAST_INLET = range(3, 9)
# Of links, branches and gyrators; then of inlets.
TO_JUNCTION, OF_JUNCTION = range(2)
FROM_PORT, INTO_JUNCTION = range(2)
READ_LEAF, READ_JUNCTION, READ_MODULATOR = range(3)
SOURCE_LEAF, SOURCE_RESISTOR, SOURCE_EFFORT, SOURCE_FLOW, SOURCE_PORT = range(5)
# A row with a ratio has its place and its sign in the last two columns; a row without one has the place -1.
RATIO, SIGN = 17, 18
_COLUMNS = 19

NONE = -1


def stack(rows: Mapping[int, Sequence[Sequence[int]]], ratios: Mapping[int, Sequence[tuple[int, int]]]) -> Integers:
    """Return the table of the rows of every kind, with place and sign of the ratios of those kinds that have them."""
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
    """Return (…, 19) the rows of one kind."""
    return table[table[0, kind] : table[0, kind + 1]]


def has_one_link(table: Integers) -> NDArray[np.bool_]:
    """Return (L,) which reducible storages are coupled to one junction alone, and to no port."""
    leaves = rows_of(table, LEAVES)
    return (leaves[:, LAST_LINK] - leaves[:, FIRST_LINK] == 1) & (leaves[:, LAST_INLET] == leaves[:, FIRST_INLET])


# Kinds of rows that belong to a reducible storage, in the order of its columns.
_OWNED = (LEAF_RESISTORS, LINKS, LEAF_INLETS)
_MOST_KNOWN = 512
_KNOWN: dict[Any, tuple[Any, Program]] = {}


@dataclass(frozen=True, eq=False)
class Program:
    """The tables of a network and how its parameters fill ``theta``.

    Attributes:
        names: parameter names in the order of ``theta``; constants and the weights of neural laws follow.
        constants: values of those constants.
        modules: (kind, element) of the neural laws in the order of their weights.
        states: names of the storages, then of the modulator states; junctions, leaves: names of the junctions and of
            the reducible storages.
        table: for the kernel, see above.
        output: index of the measured storage.
        scheme: how the steps are discretised.
        moving, travel, contact: indices of the momentum and the displacement of an imposed motion, and of the contact
            through which the source moves it; -1 if no motion is imposed.
        sparsity: which inputs the equations of a step contain.
    """

    names: tuple[str, ...]
    constants: tuple[float, ...]
    modules: tuple[tuple[str, str], ...]
    states: tuple[str, ...]
    junctions: tuple[str, ...]
    leaves: tuple[str, ...]
    table: Integers
    output: int
    sparsity: Sparsity
    scheme: Scheme = Scheme.DISCRETE_GRADIENT
    moving: int = NONE
    travel: int = NONE
    contact: int = NONE

    @cached_property
    def flow(self) -> int:
        """Return the index of the storage whose effort is the flow through the measured one: the mass beside a
        displacement. For an imposed motion, the storage that is moved."""
        if self.moving >= 0:
            return self.moving
        output = self.states[self.output]
        if output in self.junctions:
            return self.output
        leaf = rows_of(self.table, LEAVES)[self.leaves.index(output)]
        if leaf[FIRST_LINK] == leaf[LAST_LINK]:
            raise StructureViolated(f"nothing flows into {output}: couple it to another storage")
        return self.states.index(self.junctions[self.table[leaf[FIRST_LINK], TO_JUNCTION]])

    @cached_property
    def held(self) -> Integers:
        """Return (4,) the contact of an imposed motion, see `phnn.integrate.kernel.Room`."""
        t, gyrators = self.table, range(self.table[0, GYRATORS], self.table[0, GYRATORS + 1])
        if self.contact < 0:
            return np.full(4, NONE)
        pair = [self.junctions.index(self.states[k]) for k in (self.contact, self.moving)]
        rows = [next(r for r in gyrators if t[r, :2].tolist() == ends) for ends in (pair, pair[::-1])]
        return np.array(pair + rows)

    @cached_property
    def rules(self) -> dict[str, int]:
        """Return the rule that advances each reducible storage, see `phnn.integrate.scheme`."""
        return dict(zip(self.leaves, rows_of(self.table, LEAVES)[:, RULE].tolist(), strict=True))

    @cached_property
    def dissipative(self) -> tuple[int, ...]:
        """Return the reducible storages that have resistors of their own."""
        return tuple(self.states.index(name) for name, rule in self.rules.items() if rule != LOSSLESS)

    def theta(self, network: Network) -> NDArray[np.float64]:
        """(M,) parameter values of a network with this structure, constants and the weights of neural laws appended."""
        return self.filled({n: p.value for n, p in network.parameters.items()}, network)

    def filled(self, values: Mapping[str, float], network: Network) -> NDArray[np.float64]:
        """Return (M,) the same, with some parameter values replaced by name."""
        laws: dict[tuple[str, str], Any] = {("storage", s.name): s.law for s in network.storages}
        laws |= {("resistor", r.name): r.law for r in network.resistors}
        weights = [laws[key].weights().detach().numpy() for key in self.modules]
        return np.concatenate([np.array([*(values[n] for n in self.names), *self.constants]), *weights])


def compile_network(network: Network, scheme: Scheme = Scheme.DISCRETE_GRADIENT) -> Program:
    """Return the kernel's program of a network under a scheme.

    Raises:
        StructureViolated: an unknown law, or a torch module without weights for the kernel, which
            `phnn.integrate.differentiable` solves in torch; see `phnn.integrate.scheme.can_compile`.
    """
    # Networks that differ only in parameter values share their elements.
    n = network
    elements = (
        n.storages, n.resistors, n.couplings, n.ports, n.modulations, n.memories, n.multi_ports, n.shared_energies,
    )  # fmt: skip
    key = (*map(id, elements), tuple(network.parameters), network.output, network.senses, scheme)
    if key not in _KNOWN:
        if reason := obstacle(network):
            raise StructureViolated(reason)
        if len(_KNOWN) >= _MOST_KNOWN:
            _KNOWN.clear()
        # The elements are kept with the program, so that no other object can reuse their identity.
        _KNOWN[key] = (elements, _Builder(network, scheme).program())
    return _KNOWN[key][1]


class _Builder:
    """Gives every element its row, and every name, constant and weight its index in ``theta``."""

    def __init__(self, network: Network, scheme: Scheme) -> None:
        self.network, self.scheme = network, scheme
        self.names = tuple(network.parameters)
        # Laws with fewer parameters than the kernel passes refer to the first constant for the rest.
        self.constants = tuple(sorted({0.0, 1.0} | {float(v) for v in network.ratios() if not isinstance(v, str)}))
        self.modules: list[tuple[str, str]] = []
        self.rows: dict[int, list[list[int]]] = {kind: [] for kind in range(KINDS)}
        self.ratios: dict[int, list[tuple[int, int]]] = {}
        self.laws = {id(one.element): one for one in network.with_laws()}
        self.size = len(self.names) + len(self.constants)
        self.states = network.state_names
        self.junctions = junctions_of(network)
        self.leaves = tuple(n for n in network.storage_names if n not in self.junctions)
        self.couplings = merged_couplings(network)
        reads = [r.modulated_by for r in network.resistors if r.modulated_by] + [m.by for m in network.modulations]
        self.reads = tuple(dict.fromkeys(reads))

    def _place(self, ratio: Ratio) -> int:
        if isinstance(ratio, str):
            return self.names.index(ratio)
        return len(self.names) + self.constants.index(float(ratio))

    def _law(self, element: Any) -> list[int]:
        """Return the code and places, or the block of weights, of an element's law."""
        one, law = self.laws[id(element)], element.law
        if isinstance(law, str):
            places = [self.names.index(n) for n in element.parameters]
            return [list(one.laws).index(law), *places, *[self._place(0.0)] * (SCALARS - len(places))]
        first = self.size
        self.size += int(law.weights().numel())
        self.modules.append((one.kind, one.name))
        return [len(one.laws) + list(WIDE[one.kind]).index(form_of(law)), first, int(law.units), first, first, first]

    def program(self) -> Program:
        network, leaves, junctions, rows = self.network, self.leaves, self.junctions, self.rows
        rows[STORAGES] = [self._law(s) for s in network.storages]
        rows[JUNCTIONS] = [[self.states.index(j), NONE, int(is_linear(self._storage(j)))] for j in junctions]
        rows[PORTS] = [self._law(p) for p in network.ports]
        rows[READS] = [self._read(name) for name in self.reads]
        for name in leaves:
            resistors = [network.resistors[k] for k in resistors_of(network, name)]
            before = [len(rows[k]) for k in _OWNED]
            for r in resistors:
                self._with_ratio(LEAF_RESISTORS, self._resistor(r), r.on[name])
            for (to, of, ratio), times in self.couplings.items():
                for one, other, sign in ((to, of, times), (of, to, -times)):
                    if one == name:
                        self._with_ratio(LINKS, [junctions.index(other)], ratio, sign)
            self._inlets(LEAF_INLETS, name, [])
            ranges = [n for k, first in zip(_OWNED, before, strict=True) for n in (first, len(rows[k]))]
            linear, rule = int(is_linear(self._storage(name))), rule_of(network, name, self.scheme)
            rows[LEAVES].append([self.states.index(name), rule, linear, *ranges])
        for j, name in enumerate(junctions):
            self._inlets(JUNCTION_INLETS, name, [j])
        for r in network.resistors:
            if set(r.on) <= set(junctions):
                branch = len(rows[BRANCHES])
                for name, ratio in r.on.items():
                    self._with_ratio(BRANCHES, [junctions.index(name)], ratio)
                rows[JUNCTION_RESISTORS].append([*self._resistor(r), branch, len(rows[BRANCHES])])
        for (to, of, ratio), times in self.couplings.items():
            if {to, of} <= set(junctions):
                ends = [junctions.index(to), junctions.index(of)]
                self._with_ratio(GYRATORS, ends, ratio, times)
                self._with_ratio(GYRATORS, ends[::-1], ratio, -times)
        # A reducible storage that a ratio reads may have ratios that follow a modulator state: these come first.
        for m in sorted(network.modulations, key=lambda m: m.by in network.storage_names):
            rows[FACTORS].append([*self._law(m), self.reads.index(m.by), self._place(m.ratio)])
        for memory in network.memories:
            sources = self._sources(memory)
            rows[MODULATOR_STATES].append([*self._law(memory), len(rows[SOURCES]), len(rows[SOURCES]) + len(sources)])
            rows[SOURCES] += sources
        table, given = self._absolute(), imposed(network)
        held = (given.motion.momentum, given.motion.displacement, given.contact) if given else ()
        return Program(
            self.names, self.constants, tuple(self.modules), self.states, junctions, leaves, table,
            self.states.index(network.output), Sparsity(table), self.scheme, *map(self.states.index, held),
        )  # fmt: skip

    def _read(self, name: str) -> list[int]:
        places = (self.leaves, self.junctions)
        row = [names.index(name) if name in names else NONE for names in places]
        return [*row, self.states.index(name) if max(row) < 0 else NONE]

    def _sources(self, memory: ModulatorState) -> list[list[int]]:
        """Return the rows of one modulator state's sources; junction resistors are counted within their kind."""
        network, by_name = self.network, dict[str, tuple[int, int]]()
        for k, leaf in enumerate(self.leaves):
            # All resistors of the storage drive the modulator state, or none does: see `phnn.integrate.scheme`.
            by_name |= {r.name: (SOURCE_LEAF, k) for r in network.resistors if tuple(r.on) == (leaf,)}
        by_name |= {p.name: (SOURCE_PORT, k) for k, p in enumerate(network.ports)}
        by_name |= {name: (SOURCE_FLOW, j) for j, name in enumerate(self.junctions)}
        by_name |= {name: (SOURCE_EFFORT, self.states.index(name)) for name in self.leaves}
        on_junctions = (r.name for r in network.resistors if set(r.on) <= set(self.junctions))
        by_name |= {name: (SOURCE_RESISTOR, k) for k, name in enumerate(on_junctions)}
        sources = dict.fromkeys(by_name[name] for name in network.drives_of(memory))
        return [[value if column == c else NONE for c in range(5)] for column, value in sources]

    def _with_ratio(self, kind: int, row: list[int], ratio: Ratio, sign: int = 1) -> None:
        self.rows[kind].append(row)
        self.ratios.setdefault(kind, []).append((self._place(ratio), sign))

    def _absolute(self) -> Integers:
        """Build the table; convert references that count within a kind to row numbers."""
        table = stack(self.rows, self.ratios)
        first = table[0]
        leaves = rows_of(table, LEAVES)
        for column, kind in enumerate(_OWNED):
            leaves[:, FIRST_RESISTOR + 2 * column : FIRST_RESISTOR + 2 * column + 2] += first[kind]
        for kind in (LEAF_RESISTORS, JUNCTION_RESISTORS, FACTORS):
            readers = rows_of(table, kind)
            readers[:, READ] = np.where(readers[:, READ] >= 0, readers[:, READ] + first[READS], NONE)
        rows_of(table, JUNCTION_RESISTORS)[:, FIRST_BRANCH : LAST_BRANCH + 1] += first[BRANCHES]
        rows_of(table, MODULATOR_STATES)[:, FIRST_SOURCE : LAST_SOURCE + 1] += first[SOURCES]
        branches = rows_of(table, SOURCES)[:, SOURCE_RESISTOR]
        branches[branches >= 0] += first[JUNCTION_RESISTORS]
        scaled = np.flatnonzero(np.isin(table[:, RATIO], rows_of(table, FACTORS)[:, RATIO_PLACE]))
        table = np.vstack([table, stack({**dict.fromkeys(range(KINDS), ()), SCALED: scaled[:, None].tolist()}, {})[1:]])
        table[0, KINDS] = len(table)
        return table

    def _storage(self, name: str) -> Storage:
        return self.network.storages[self.states.index(name)]

    def _resistor(self, r: Resistor) -> list[int]:
        read = NONE if r.modulated_by is None else self.reads.index(r.modulated_by)
        return [*self._law(r), read]

    def _inlets(self, kind: int, name: str, rest: list[int]) -> None:
        for k, port in enumerate(self.network.ports):
            if name in port.on:
                self._with_ratio(kind, [k, *rest], port.on[name])


class Sparsity:
    """The inputs of every equation of a table, and properties of the reducible storages' equations.

    Attributes:
        leaves: inputs of the end state, the mean effort and the forces of each reducible storage.
        currents: of each reducible storage's current alone; thresholds: of the modulated thresholds of its first
            resistor.
        affine: by reducible storage, whether its junctions are linear, and its flow exact or lossless once ratios and
            thresholds are known; varies: whether its ratios are modulated.
        plain, others: rows of junction resistors, gyrators and junction inlets: plain ones are linear in the flows with
            constant factors; for the others, their inputs.
        gains: inputs of all modulated ratios.
        modulators: inputs of each modulator state's law, its state included, without its drive;
            sources: of every source except reducible storages.
    """

    def __init__(self, table: Integers) -> None:
        self.table = table
        self._storages, self._ports = rows_of(table, STORAGES), rows_of(table, PORTS)
        self._junctions, self._leaves = rows_of(table, JUNCTIONS), rows_of(table, LEAVES)
        self._unknown = len(self._storages) + len(rows_of(table, MODULATOR_STATES))
        self.known = self._unknown + len(self._junctions)
        self._factors = rows_of(table, FACTORS)
        self._modulated = {int(place) for place in self._factors[:, RATIO_PLACE]}
        numbers = range(len(self._leaves))
        kinds = (JUNCTION_RESISTORS, GYRATORS, JUNCTION_INLETS)
        terms = [row for kind in kinds for row in range(table[0, kind], table[0, kind + 1])]
        self.currents = [self._current(leaf) for leaf in numbers]
        self.thresholds = [self._thresholds(leaf) for leaf in numbers]
        self.leaves = [self._leaf(leaf) for leaf in numbers]
        self.varies = [self._varies(leaf) for leaf in numbers]
        self.affine = [self._is_affine(leaf) for leaf in numbers]
        self.plain = [row for row in terms if self._is_plain(row)]
        self.others = {row: self._term(row) for row in terms if row not in self.plain}
        self.gains = set[int]().union(*map(self._ratio, self._modulated))
        slow = enumerate(rows_of(table, MODULATOR_STATES), len(self._storages))
        self.modulators = [{place} | self._law(row, MEMORY_LAWS) for place, row in slow]
        self.sources = [self._source(row) for row in rows_of(table, SOURCES)]

    def _law(self, row: Integers, laws: Mapping[str, Any]) -> set[int]:
        """Return the indices of a law's parameters; weights of neural laws are left to the torch module."""
        known = list(laws.values())
        count = len(known[row[LAW]].example) if row[LAW] < len(known) else 0
        return {self.known + int(p) for p in row[PLACE_1 : PLACE_1 + count]}

    def _port(self, k: int) -> set[int]:
        """Return the indices of a port's law and of its padding, which may carry a given derivative of the action."""
        return {self.known + int(p) for p in self._ports[k][1 : 1 + SCALARS]}

    def _storage(self, k: int) -> set[int]:
        return self._law(self._storages[k], STORAGE_LAWS)

    def _ratio(self, place: int) -> set[int]:
        """Return the inputs of a ratio."""
        inputs = {self.known + int(place)}
        for row in self._factors[self._factors[:, RATIO_PLACE] == place]:
            inputs |= self._law(row, FACTOR_LAWS) | self._read(row[READ])
        return inputs

    def _flow(self, j: int) -> set[int]:
        storage, linear = self._junctions[j, [OWN_STORAGE, IS_LINEAR]]
        # The mean effort of a linear junction is the unknown itself; elsewhere it follows from both end states.
        return {self._unknown + int(j)} | (set() if linear else {int(storage)} | self._storage(storage))

    def _current(self, leaf: int) -> set[int]:
        """Return the inputs of a reducible storage's current."""
        inputs: set[int] = set()
        links, inlets = self._connections(leaf)
        for row in links:
            inputs |= self._ratio(row[RATIO]) | self._flow(row[TO_JUNCTION])
        for row in inlets:
            inputs |= self._inlet(row)
        return inputs

    def _connections(self, leaf: int) -> tuple[Integers, Integers]:
        """Return the rows of a reducible storage's links and of its inlets."""
        first, last, first_inlet, last_inlet = self._leaves[leaf, FIRST_LINK : LAST_INLET + 1]
        return self.table[first:last], self.table[first_inlet:last_inlet]

    def _inlet(self, row: Integers) -> set[int]:
        return self._ratio(row[RATIO]) | self._port(row[FROM_PORT])

    def _read(self, row: int) -> set[int]:
        if row < 0:
            return set()
        leaf, junction, memory = self.table[row, :3]
        if memory >= 0:
            return {int(memory)}
        if leaf >= 0:
            return {int(self._leaves[leaf, OWN_STORAGE])} | self._current(int(leaf))
        storage = int(self._junctions[junction, OWN_STORAGE])
        return {storage, self._unknown + int(junction)} | self._storage(storage)

    def _resistor(self, row: Integers) -> set[int]:
        return self._law(row, RESISTOR_LAWS) | self._read(row[READ])

    def _leaf(self, leaf: int) -> set[int]:
        """Return the inputs of the end state, the mean effort and the forces of a reducible storage."""
        row = self._leaves[leaf]
        inputs = {int(row[OWN_STORAGE])} | self._storage(row[OWN_STORAGE]) | self._current(leaf)
        for resistor in self.table[row[FIRST_RESISTOR] : row[LAST_RESISTOR]]:
            inputs |= self._resistor(resistor) | self._ratio(resistor[RATIO])
        return inputs

    def _thresholds(self, leaf: int) -> set[int]:
        """Return the inputs of the modulated thresholds of a reducible storage's first resistor."""
        row = self._leaves[leaf]
        follows = row[RULE] == EXACT and self.table[row[FIRST_RESISTOR], READ] >= 0
        return self._resistor(self.table[row[FIRST_RESISTOR]]) if follows else set()

    def _is_affine(self, leaf: int) -> bool:
        """Return whether known ratios make the current linear in the unknowns, and the flow is exact or lossless."""
        row, (links, _) = self._leaves[leaf], self._connections(leaf)
        # A nonlinear law with a modulated ratio is differentiated in full.
        plain = row[RULE] == EXACT or (row[RULE] == LOSSLESS and (row[IS_LINEAR] > 0 or not self.varies[leaf]))
        return bool(plain and all(self._junctions[r[TO_JUNCTION], IS_LINEAR] for r in links))

    def _varies(self, leaf: int) -> bool:
        """Return whether a ratio between a reducible storage and a junction or a port is modulated."""
        links, inlets = self._connections(leaf)
        return bool(self._modulated & {int(r[RATIO]) for r in (*links, *inlets)})

    def _branches(self, row: Integers) -> Integers:
        return self.table[row[FIRST_BRANCH] : row[LAST_BRANCH]]

    def _is_plain(self, place: int) -> bool:
        """Return whether a term of the junctions is linear in the flows, or in an action, with a constant factor."""
        row, kind = self.table[place], self._kind(place)
        if kind == JUNCTION_RESISTORS:
            rows = self._branches(row)
            linear = row[LAW] in LINEAR_RESISTOR_CODES and row[READ] < 0
            ends = rows[:, TO_JUNCTION]
        else:
            rows, linear = row[None], True
            ends = row[:2] if kind == GYRATORS else row[:0]
        constant = not self._modulated & {int(r[RATIO]) for r in rows}
        return bool(linear and constant and all(self._junctions[j, IS_LINEAR] for j in ends))

    def _kind(self, place: int) -> int:
        return int(np.searchsorted(self.table[0, :KINDS], place, side="right")) - 1

    def _term(self, place: int) -> set[int]:
        """Return the inputs of a junction resistor's, a gyrator's or a junction inlet's term."""
        row, kind = self.table[place], self._kind(place)
        if kind == JUNCTION_INLETS:
            return self._inlet(row)
        if kind == GYRATORS:
            return self._ratio(row[RATIO]) | self._flow(row[OF_JUNCTION])
        inputs = self._resistor(row)
        for branch in self._branches(row):
            inputs |= self._ratio(branch[RATIO]) | self._flow(branch[0])
        return inputs

    def _source(self, row: Integers) -> set[int]:
        """Inputs of a source of a modulator state; those of a reducible storage are listed with the storage."""
        if row[SOURCE_RESISTOR] >= 0:
            return self._term(int(row[SOURCE_RESISTOR]))
        if row[SOURCE_FLOW] >= 0:
            return self._flow(int(row[SOURCE_FLOW]))
        return self._port(row[SOURCE_PORT]) if row[SOURCE_PORT] >= 0 else set()


Array = NDArray[np.float64]


def actions(program: Program, theta: Any, u: Array) -> Any:
    """Return (…, P) ``ψ_p(u_p)`` of inputs (…, P)."""
    out = np.empty(u.shape, dtype=theta.dtype)
    for port, row in enumerate(rows_of(program.table, PORTS)):
        law = list(PORT_LAWS.values())[row[LAW]]
        out[..., port] = law.action(
            u[..., port], *(theta[place] for place in row[PLACE_1 : PLACE_1 + len(law.example)])
        )
    return out


def action_derivatives(program: Program, theta: Array, u: Array, places: NDArray[np.int64]) -> Array:
    """Return (S, n, P) derivatives of the actions by the parameters at some entries of ``theta``."""
    out = np.empty((places.size, *u.shape))
    for s, place in enumerate(places):
        moved = theta.astype(complex)
        moved[place] += 1j * TINY
        out[s] = np.imag(actions(program, moved, u)) / TINY
    return out
