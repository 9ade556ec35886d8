"""Derivatives of one step, block by block: complex steps through the very functions that march.

A step maps inputs — states, unknowns, parameters — to the end states of leaves and memories, the changes of junction
states and the balance ``F``. Every leaf is a block, and all terms of the junctions are one; `phnn.integrate.uses` says
which block contains which input, so that one perturbation re-evaluates only what it can change.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.compiled import inline, plain, stay_outside
from phnn.integrate.constants import CONSTANTS, fill_constants, fill_gains
from phnn.integrate.lookups import count, is_linear, junction_storage
from phnn.integrate.memories import advance
from phnn.integrate.program import Program
from phnn.integrate.step import (
    CHANGE,
    EFFORT,
    FORCE,
    NEXT,
    is_closed,
    junction_flows,
    junction_terms,
    leaf_closed,
    leaf_moved,
    leaf_search,
    modulate,
)
from phnn.integrate.tables import FACTORS, JUNCTIONS, LEAVES, MEMORIES, PORTS, STORAGES, Integers, rows_of
from phnn.laws.namespace import TINY

Array = NDArray[np.float64]


class Run(NamedTuple):
    """A march, and how its ports' actions follow the parameters in their laws.

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
    """Where the derivatives of a step by states, unknowns and some parameters are not zero, inputs in that order.

    A leaf and an input that its equations contain are a *pair*; pairs are listed leaf by leaf, inputs increasing.

    Attributes:
        active: (K,) places in theta.
        in_ports: (K,) number of a parameter among those in port laws, −1 for the others.
        in_junctions: (I,) whether an input stands in the junctions' block.
        first: (L+1,) the first pair of each leaf; input: (pairs,) the input of each pair.
        first_of: (I+1,) where each input begins in ``pair_of``: (pairs,) the pairs, now input by input; leaf: (pairs,)
            the leaf of each pair.
    """

    active: NDArray[np.int64]
    in_ports: NDArray[np.int64]
    in_junctions: NDArray[np.bool_]
    first: NDArray[np.int64]
    input: NDArray[np.int64]
    leaf: NDArray[np.int64]
    first_of: NDArray[np.int64]
    pair_of: NDArray[np.int64]


@lru_cache(maxsize=256)
def pattern_of(program: Program, active: tuple[int, ...]) -> Pattern:
    """The pattern of a program for the parameters at some places."""
    known = len(program.states) + len(program.junctions)
    inputs = [*range(known), *(known + place for place in active)]
    *leaves, junctions = program.uses
    pairs = [(leaf, i) for leaf, uses in enumerate(leaves) for i, name in enumerate(inputs) if name in uses]
    in_ports = np.isin(active, rows_of(program.table, PORTS)[:, 1:5])
    leaf, given = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    return Pattern(
        np.asarray(active, dtype=np.int64),
        np.where(in_ports, np.cumsum(in_ports) - 1, -1),
        np.array([i in junctions for i in inputs], dtype=np.bool_),
        _starts(leaf, len(leaves)),
        np.ascontiguousarray(given),
        np.ascontiguousarray(leaf),
        _starts(given, len(inputs)),
        np.argsort(given, kind="stable"),
    )


def _starts(found: NDArray[np.int64], groups: int) -> NDArray[np.int64]:
    """(groups + 1,) where every group begins in a list sorted by group."""
    return np.concatenate([[0], np.cumsum(np.bincount(found, minlength=groups))]).astype(np.int64)


@plain
def perturbed_constants(t: Any, theta: Any, active: Any, h: Any, c: Any, g: Any) -> None:
    """Constants (K+1, L+m, 6) and gains (K+1, rows) with one active parameter perturbed each, and last with none."""
    stay_outside()
    for k in range(active.shape[0] + 1):
        if k < active.shape[0]:
            theta[active[k]] += TINY * 1j
        fill_constants(t, theta, h, c[k])
        fill_gains(t, theta, g[k])
        if k < active.shape[0]:
            theta[active[k]] = complex(theta[active[k]].real, 0.0)


@inline
def _load(t: Any, d: Any, n: Any, run: Any) -> None:
    """State, unknowns and actions of a step; only the actions by parameters of port laws are perturbed."""
    for k in range(d.x.shape[0]):
        d.x[k] = complex(run.states[n, k], 0.0)
        d.wx[NEXT, k] = complex(run.states[n + 1, k], 0.0)
        d.wx[EFFORT, k] = complex(run.efforts[n, k], 0.0)
    for j in range(d.y.shape[0]):
        k = junction_storage(t, j)
        d.y[j] = complex(run.efforts[n, k] if is_linear(t, j) else run.states[n + 1, k], 0.0)
    for port in range(d.a.shape[1]):
        d.a[0, port] = complex(run.actions[n, port], 0.0)
        for s in range(run.by_port.shape[0]):
            d.a[1 + s, port] = complex(run.actions[n, port], TINY * run.by_port[s, n, port])


@plain
def _linearise(t: Any, p: Any, d: Any, h: Any) -> None:
    """Fill the derivatives of a step by every input."""
    stay_outside()
    n, m, none = d.x.shape[0], d.y.shape[0], p.active.shape[0]
    _search(t, d, d.c[none], d.g[none], d.a[0], h)
    for i in range(n + m + none):
        k = i - n - m
        if i < n:
            d.x[i] += TINY * 1j
        elif i < n + m:
            d.y[i - n] += TINY * 1j
        else:
            d.theta[p.active[k]] += TINY * 1j
        which, act = (k, 1 + p.in_ports[k]) if k >= 0 else (none, 0)
        _block_derivatives(
            t, p, i, d.theta, d.c[which], d.g[which], d.a[act], d.x, d.y, h, d.wj, d.wx, d.found, d.by_leaf,
            d.by_force[:, i], d.by_change[:, i], d.by_memory[:, i],
        )  # fmt: skip
        if i < n:
            d.x[i] = complex(d.x[i].real, 0.0)
        elif i < n + m:
            d.y[i - n] = complex(d.y[i - n].real, 0.0)
        else:
            d.theta[p.active[k]] = complex(d.theta[p.active[k]].real, 0.0)


@inline
def _search(t: Any, d: Any, c: Any, g: Any, a: Any, h: Any) -> None:
    """Solve the leaves without a closed solution once, for all derivatives of the step."""
    junction_flows(t, d.theta, d.x, d.y, d.wj)
    if count(t, FACTORS) > 0:
        modulate(t, d.theta, c, g, a, d.x, d.y, h, d.wj)
    for leaf in range(count(t, LEAVES)):
        if not is_closed(t, leaf):
            found = leaf_search(t, leaf, d.theta, c, g, a, d.x, d.y, h, d.wj)
            for k in range(4):
                d.found[leaf, k] = found[k]


@inline
def _block_derivatives(
    t: Any, p: Any, i: Any, theta: Any, c: Any, g: Any, a: Any, x: Any, y: Any, h: Any, wj: Any, wx: Any, found: Any,
    by_leaf: Any, by_force: Any, by_change: Any, by_memory: Any,
) -> None:  # fmt: skip
    """Imaginary parts of the blocks that contain input ``i``, and of the memories."""
    m = y.shape[0]
    for j in range(m):
        by_force[j] = 0.0
        by_change[j] = 0.0
    junction_flows(t, theta, x, y, wj)
    if count(t, FACTORS) > 0:
        modulate(t, theta, c, g, a, x, y, h, wj)
    if p.in_junctions[i]:
        junction_terms(t, theta, c, g, a, x, y, h, wj)
        for j in range(m):
            by_force[j] = wj[FORCE, j].imag / TINY
            by_change[j] = wj[CHANGE, j].imag / TINY
    for place in range(p.first_of[i], p.first_of[i + 1]):
        pair = p.pair_of[place]
        leaf = p.leaf[pair]
        if is_closed(t, leaf):
            end, mean = leaf_closed(t, leaf, theta, c, g, a, x, y, h, wj)
        else:
            known = (found[leaf, 0], found[leaf, 1], found[leaf, 2], found[leaf, 3])
            end, mean = leaf_moved(t, leaf, theta, c, g, a, x, y, h, wj, known)
        by_leaf[pair] = end.imag / TINY
        row = t[0, LEAVES] + leaf
        for r in range(t[row, 5], t[row, 6]):
            by_force[t[r, 0]] += (g[r] * mean).imag / TINY
        wx[NEXT, t[row, 0]] = end
        wx[EFFORT, t[row, 0]] = mean
    if by_memory.shape[0] > 0:
        advance(t, theta, c, g, a, x, y, h, wj, wx)
        for k in range(by_memory.shape[0]):
            by_memory[k] = wx[NEXT, count(t, STORAGES) + k].imag / TINY
        _forget(t, p, i, wx)


@inline
def _forget(t: Any, p: Any, i: Any, wx: Any) -> None:
    """Take the perturbation out of the leaves that contain input ``i``: the next input may not meet them."""
    for place in range(p.first_of[i], p.first_of[i + 1]):
        k = t[t[0, LEAVES] + p.leaf[p.pair_of[place]], 0]
        wx[NEXT, k] = complex(wx[NEXT, k].real, 0.0)
        wx[EFFORT, k] = complex(wx[EFFORT, k].real, 0.0)


class Derivatives(NamedTuple):
    """Memory for the derivatives of one step.

    Attributes:
        theta, x, y: as of `phnn.integrate.step`, complex; wj: (4, m); wx: (2, N).
        found: (L, 4) what solves the leaves without a closed solution.
        c, g: from `perturbed_constants`; a: (1+S, P) actions, then perturbed by each parameter of a port law.
        by_leaf: (pairs,) of the leaves' end states, as listed by the pattern.
        by_force, by_change: (m, I) of ``F`` and of ``z − p``; by_memory: (M, I) of the memories' end states.
    """

    theta: Any
    c: Any
    g: Any
    a: Any
    x: Any
    y: Any
    wj: Any
    found: Any
    by_leaf: Any
    by_force: Any
    by_change: Any
    wx: Any
    by_memory: Any


def new_derivatives(t: Integers, p: Pattern, theta: Array, run: Run) -> Derivatives:
    """Memory for a network and a pattern."""
    m, inputs, none = len(rows_of(t, JUNCTIONS)), p.in_junctions.size, p.active.size + 1
    return Derivatives(
        theta.astype(np.complex128),
        np.zeros((none, len(rows_of(t, LEAVES)) + m, CONSTANTS), np.complex128),
        np.zeros((none, t.shape[0]), np.complex128),
        np.zeros((1 + run.by_port.shape[0], run.actions.shape[1]), np.complex128),
        np.zeros(run.states.shape[1], np.complex128),
        np.zeros(m, np.complex128),
        np.zeros((4, m), np.complex128),
        np.zeros((len(rows_of(t, LEAVES)), 4)),
        np.zeros(p.leaf.shape[0]),
        np.zeros((m, inputs)),
        np.zeros((m, inputs)),
        np.zeros((2, run.states.shape[1]), np.complex128),
        np.zeros((len(rows_of(t, MEMORIES)), inputs)),
    )


@inline
def derivatives_at(t: Any, p: Any, d: Any, n: Any, run: Any, fresh: Any) -> None:
    """Fill the derivatives of step ``n``; ``fresh`` where its size differs from that of the last call."""
    if fresh:
        perturbed_constants(t, d.theta, p.active, run.h[n], d.c, d.g)
    _load(t, d, n, run)
    _linearise(t, p, d, run.h[n])
