"""Blocks of a step, differentiated by complex steps through the functions of the integration itself.

A step maps inputs — states, unknowns, parameters — to the end states of reducible storages and modulator states, the
changes of junction states and the balance ``F``. Every reducible storage is a block, and so is every term of the
junctions that is not linear. `phnn.integrate.program` lists the inputs of each block, so that a block is perturbed by
these alone.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.integrate import program as at
from phnn.integrate.cache import inline
from phnn.integrate.program import Integers, Sparsity, has_one_link, rows_of
from phnn.integrate.step import (
    CONSTANTS,
    FORCE,
    Step,
    is_closed,
    is_linear,
    junction_flows,
    junction_storage,
    junction_term,
    leaf_closed,
    leaf_current,
    leaf_moved,
    leaf_search,
    links,
)
from phnn.laws.namespace import TINY

Array = NDArray[np.float64]


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
        only: (L,) row of the only link of an affine storage without inlets and modulated ratios; −1 for all others.
        shifts: (pairs,) whether an input changes the current of one of these others, except for unknowns of junctions
            at a constant ratio; shifted: (L,) whether any does.
        follows: (pairs,) whether an input changes the modulated thresholds of the storage.
        affine: (L,) see `phnn.integrate.program.Sparsity`; reads: (L,) whether thresholds are modulated.
        plain: (R,) rows of the junctions' linear terms; terms: (T,) rows of the others, and their inputs.
        slots: (G,) inputs that change a ratio, the first −1 for none; slot: (I,) the place of an input among them.
        memory, source: inputs of the law of every modulator state and of every source.
    """

    active: Integers
    in_ports: Integers
    first: Integers
    input: Integers
    only: Integers
    shifts: NDArray[np.bool_]
    shifted: NDArray[np.bool_]
    follows: NDArray[np.bool_]
    affine: NDArray[np.bool_]
    reads: NDArray[np.bool_]
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
def pattern_of(sparsity: Sparsity, active: tuple[int, ...]) -> Pattern:
    """Return the pattern of a program for the parameters at some entries of theta."""
    table, known = sparsity.table, sparsity.known
    inputs = [*range(known), *(known + place for place in active)]
    in_ports = np.isin(active, rows_of(table, at.PORTS)[:, at.PLACE_1 : at.PLACE_5 + 1])
    first, given = _listed(sparsity.leaves, inputs)
    leaf = np.repeat(np.arange(len(sparsity.leaves)), np.diff(first))
    names = np.array(inputs, dtype=np.int64)[given]
    affine, varies = (np.array(each, dtype=np.bool_) for each in (sparsity.affine, sparsity.varies))
    only = np.where(affine & ~varies & has_one_link(table), rows_of(table, at.LEAVES)[:, at.FIRST_LINK], -1)
    by_current = [
        only[k] < 0 and (name >= known or sparsity.varies[k]) and name in sparsity.currents[k]
        for k, name in zip(leaf, names, strict=True)
    ]
    by_threshold = [name in sparsity.thresholds[k] for k, name in zip(leaf, names, strict=True)]
    ratios = {known + int(place) for place in table[1:, at.RATIO] if place >= 0}
    slots = [i for i, name in enumerate(inputs) if name in ratios or name in sparsity.gains]
    slot = np.zeros(len(inputs), dtype=np.int64)
    slot[slots] = 1 + np.arange(len(slots))
    return Pattern(
        np.asarray(active, dtype=np.int64),
        np.where(in_ports, np.cumsum(in_ports) - 1, -1),
        first,
        given,
        only,
        np.array(by_current, dtype=np.bool_),
        np.array([any(by_current[first[k] : first[k + 1]]) for k in range(len(first) - 1)], dtype=np.bool_),
        np.array(by_threshold, dtype=np.bool_),
        affine,
        np.array([bool(members) for members in sparsity.thresholds], dtype=np.bool_),
        np.array(sparsity.plain, dtype=np.int64),
        np.array(list(sparsity.others), dtype=np.int64),
        *_listed(sparsity.others.values(), inputs),
        np.array([-1, *slots], dtype=np.int64),
        slot,
        *_listed(sparsity.modulators, inputs),
        *_listed(sparsity.sources, inputs),
    )


def _listed(sets: Iterable[set[int]], inputs: list[int]) -> tuple[Integers, Integers]:
    """Return the start of every set's list, and all lists one after the other: numbers of the inputs in each set."""
    lists = [[i for i, name in enumerate(inputs) if name in members] for members in sets]
    first = np.cumsum([0, *map(len, lists)])
    return first.astype(np.int64), np.array([i for numbers in lists for i in numbers], dtype=np.int64)


# Affine pieces of a reducible storage.
PIECES = 3


class Derivatives(NamedTuple):
    """Work arrays for the derivatives of one step by I inputs, K of them parameters.

    Attributes:
        theta, x, y, wj, wx: as of `phnn.integrate.step`, complex.
        a: (1+S, P) actions, first unperturbed, then perturbed by each parameter of a port law.
        c: (K+1, L+m, 9) constants, perturbed by one parameter each; the last ones are unperturbed.
        g: (G, rows) ratios, first unperturbed, then perturbed by each input that changes one.
        whole: (L, 3, 6) coefficients of the affine pieces of every reducible storage; affine: (pairs, 3, 8) derivatives
            of end state and mean effort within a piece as functions of the state, the flow through the only link (or
            of the current where there are others), the threshold and 1.
        by_ratio: (pairs,) derivatives of the ratio of the only link; shift: (pairs,) other ones of the current.
        by_threshold: (pairs,) derivatives of a modulated threshold in this step.
        junction: (m, m+1, I) the derivatives of the linear terms of ``F`` as functions of flows and 1; change: (m, I)
            those of ``z − p`` by parameters as multiples of the junction's own flow.
        flows: (m,) mean efforts of the junctions.
        by_leaf, by_mean: (pairs,) of the end states and mean efforts of the reducible storages.
        by_force, by_change: (m, I) of ``F`` and of ``z − p``; by_modulator: (M, I) of the modulator states' end states;
            by_drive: (I,) of the drive of one modulator state.
    """

    theta: Any
    x: Any
    y: Any
    wj: Any
    wx: Any
    a: Any
    c: Any
    g: Any
    whole: Any
    affine: Any
    by_ratio: Any
    shift: Any
    by_threshold: Any
    junction: Any
    change: Any
    flows: Any
    by_leaf: Any
    by_mean: Any
    by_force: Any
    by_change: Any
    by_modulator: Any
    by_drive: Any


def new_derivatives(t: Integers, p: Pattern, theta: Array, run: Run) -> Derivatives:
    """Allocate the work arrays for a network and a pattern."""
    m, leaves, pairs, inputs = len(rows_of(t, at.JUNCTIONS)), len(rows_of(t, at.LEAVES)), p.input.size, p.slot.size
    n, slow = run.states.shape[1], len(rows_of(t, at.MODULATOR_STATES))
    steps = (
        n, m, (4, m), (2, n), (1 + run.by_port.shape[0], run.actions.shape[1]),
        (p.active.size + 1, leaves + m, CONSTANTS), (p.slots.size, t.shape[0]),
    )  # fmt: skip
    storages = (leaves, PIECES, 6), (pairs, PIECES, 8), pairs, pairs, pairs
    totals = pairs, pairs, (m, inputs), (m, inputs), (slow, inputs), inputs
    return Derivatives(
        theta.astype(np.complex128),
        *(np.zeros(shape, np.complex128) for shape in steps),
        *(np.zeros(shape) for shape in (*storages, (m, m + 1, inputs), (m, inputs), m, *totals)),
    )


@inline
def parameter(d: Any, i: Any) -> Any:
    """Return the number of the parameter that input ``i`` is; negative if it is a state or an unknown."""
    return i - d.x.shape[0] - d.y.shape[0]


@inline
def perturb(p: Any, d: Any, i: Any, by: Any) -> None:
    """Give input ``i`` an imaginary part; 0 removes it again. A negative ``i`` stands for no input."""
    k = parameter(d, i)
    if k >= 0:
        d.theta[p.active[k]] = complex(d.theta[p.active[k]].real, by)
    elif i >= d.x.shape[0]:
        d.y[i - d.x.shape[0]] = complex(d.y[i - d.x.shape[0]].real, by)
    elif i >= 0:
        d.x[i] = complex(d.x[i].real, by)


@inline
def places_of(p: Any, d: Any, i: Any) -> Any:
    """Return the rows of constants, ratios and actions that belong to the perturbation of input ``i``."""
    k = parameter(d, i)
    which, act = (k, 1 + p.in_ports[k]) if k >= 0 else (p.active.shape[0], 0)
    return which, p.slot[i] if i >= 0 else 0, act


@inline
def perturbed_step(t: Any, p: Any, d: Any, i: Any, h: Any) -> Step:
    """Return the step with input ``i`` perturbed, with its flows; `perturb` takes the perturbation away again."""
    which, slot, act = places_of(p, d, i)
    perturb(p, d, i, TINY)
    junction_flows(t, d.theta, d.x, d.y, d.wj)
    return Step(d.theta, d.c[which], d.g[slot], d.a[act], d.x, d.y, h, d.wj, d.wx)


@inline
def load(t: Any, d: Any, n: Any, run: Any) -> None:
    """Load state, unknowns and actions of a step; of the actions, those by parameters of port laws are perturbed."""
    for k in range(d.x.shape[0]):
        d.x[k] = complex(run.states[n, k], 0.0)
    for j in range(d.y.shape[0]):
        k = junction_storage(t, j)
        d.flows[j] = run.efforts[n, k]
        d.y[j] = complex(run.efforts[n, k] if is_linear(t, j) else run.states[n + 1, k], 0.0)
    for port in range(d.a.shape[1]):
        d.a[0, port] = complex(run.actions[n, port], 0.0)
        for s in range(run.by_port.shape[0]):
            d.a[1 + s, port] = complex(run.actions[n, port], TINY * run.by_port[s, n, port])


@inline
def terms_in_full(t: Any, p: Any, d: Any, h: Any) -> None:
    """Add the derivatives of the junctions' terms that are not linear."""
    for term in range(p.terms.shape[0]):
        for place in range(p.term_first[term], p.term_first[term + 1]):
            i = p.term_input[place]
            step = perturbed_step(t, p, d, i, h)
            for j in range(d.y.shape[0]):
                d.wj[FORCE, j] = 0.0
            junction_term(t, p.terms[term], step)
            for j in range(d.y.shape[0]):
                d.by_force[j, i] += d.wj[FORCE, j].imag / TINY
            perturb(p, d, i, 0.0)


@inline
def leaf_in_full(t: Any, p: Any, d: Any, leaf: Any, h: Any) -> None:
    """Fill the derivatives of a reducible storage."""
    closed = is_closed(t, leaf)
    solution = (0.0, 0.0, 0.0, 0.0)
    if not closed:
        # Solved once, for all derivatives of the step.
        solution = leaf_search(t, leaf, perturbed_step(t, p, d, -1, h))
    for pair in range(p.first[leaf], p.first[leaf + 1]):
        i = p.input[pair]
        step = perturbed_step(t, p, d, i, h)
        if closed:
            end, mean = leaf_closed(t, leaf, step)
        else:
            end, mean = leaf_moved(t, leaf, step, solution)
        if not p.affine[leaf]:
            d.shift[pair] = leaf_current(t, leaf, step.g, step.a, step.wj).imag / TINY
        perturb(p, d, i, 0.0)
        d.by_leaf[pair] = end.imag / TINY
        d.by_mean[pair] = mean.imag / TINY
        for r in links(t, leaf):
            d.by_force[t[r, at.TO_JUNCTION], i] += (step.g[r] * mean).imag / TINY
