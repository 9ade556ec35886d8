"""The sparsity pattern of a step's derivatives, as arrays that the compiled sweeps read."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.cache import plain, stay_outside
from phnn.integrate.program import Program
from phnn.integrate.tables import (
    PLACE_1,
    PLACE_5,
    PORTS,
    RATIO,
    rows_of,
)

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


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
            ratio; follows: (pairs,) whether it changes the modulated thresholds of the storage.
        affine, varies: (L,) see `phnn.integrate.program`; reads: (L,) whether thresholds are modulated.
        plain: (R,) rows of the junctions' linear terms; terms: (T,) rows of the others, and their inputs.
        slots: (G,) inputs that change a ratio, the first −1 for none; slot: (I,) the place of an input among them.
        scaled: rows with a modulated ratio.
        memory, source: inputs of the law of every modulator state and of every source.
    """

    active: Integers
    in_ports: Integers
    first: Integers
    input: Integers
    shifts: NDArray[np.bool_]
    follows: NDArray[np.bool_]
    affine: NDArray[np.bool_]
    varies: NDArray[np.bool_]
    reads: NDArray[np.bool_]
    plain: Integers
    terms: Integers
    term_first: Integers
    term_input: Integers
    slots: Integers
    slot: Integers
    scaled: Integers
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
    by_threshold = [name in sparsity.thresholds[k] for k, name in zip(leaf, names, strict=True)]
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
        np.array(by_threshold, dtype=np.bool_),
        np.array(sparsity.affine, dtype=np.bool_),
        np.array(sparsity.varies, dtype=np.bool_),
        np.array([bool(found) for found in sparsity.thresholds], dtype=np.bool_),
        np.array(sparsity.plain, dtype=np.int64),
        np.array(list(sparsity.others), dtype=np.int64),
        *_listed(sparsity.others.values(), inputs),
        np.array([-1, *slots], dtype=np.int64),
        slot,
        np.array(sparsity.scaled, dtype=np.int64),
        *_listed(sparsity.modulators, inputs),
        *_listed(sparsity.sources, inputs),
    )


def _listed(sets: Iterable[frozenset[int]], inputs: list[int]) -> tuple[Integers, Integers]:
    """The start of every set's list, and all lists one after the other: numbers of the inputs in each set."""
    lists = [[i for i, name in enumerate(inputs) if name in found] for found in sets]
    first = np.cumsum([0, *map(len, lists)])
    return first.astype(np.int64), np.array([i for found in lists for i in found], dtype=np.int64)


@plain
def eliminate(matrix: Any, right: Any) -> None:
    """Solve a small linear system in place by elimination with row pivoting; ``right`` (m, k) becomes the solution."""
    stay_outside()
    m, columns = right.shape
    for k in range(m):
        pivot = k
        for i in range(k + 1, m):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if pivot != k:
            for j in range(m):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            for c in range(columns):
                right[k, c], right[pivot, c] = right[pivot, c], right[k, c]
        for i in range(k + 1, m):
            share = matrix[i, k] / matrix[k, k]
            for j in range(k + 1, m):
                matrix[i, j] -= share * matrix[k, j]
            for c in range(columns):
                right[i, c] -= share * right[k, c]
    for k in range(m - 1, -1, -1):
        inverse = 1.0 / matrix[k, k]
        for j in range(k + 1, m):
            for c in range(columns):
                right[k, c] -= matrix[k, j] * right[j, c]
        for c in range(columns):
            right[k, c] *= inverse
