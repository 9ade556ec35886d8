"""The integer table that the compiled kernel reads: one row an element, all kinds in one array.

A single array, because a compiled function is called faster with fewer arrays. Row 0 holds the first row of each kind.
Below, "row" is a row number of this table, "place" an index into the vector ``theta``. "Law" stands for a code with
five places, or a code with the first place and the number of units of a block of weights.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

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
KINDS = 15
# Columns of a row: the code of its law; the places of its parameters, or of a block of weights and its units; the row
# of the variable that it reads; the ratio that it multiplies; the rows that belong to it.
LAW, PLACE_1, PLACE_2, PLACE_3, PLACE_4, PLACE_5 = range(6)
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
RATIO, SIGN = 16, 17
_COLUMNS = 18

# Rules of a reducible storage: without resistors; exact flow; two-stage Radau IIA; discrete gradient.
LOSSLESS, EXACT, RADAU, GRADIENT, PATH = range(5)
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
    """(…, 18) the rows of one kind."""
    return table[table[0, kind] : table[0, kind + 1]]
