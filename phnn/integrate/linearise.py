"""Derivatives of one step, block by block: complex steps through the very functions that march.

A step maps inputs — states, unknowns, parameters — to the end states of leaves, the changes of junction states and the
balance ``F``. Every leaf is a block, and all terms of the junctions are one; `phnn.integrate.uses` says which block
contains which input, so that one perturbation re-evaluates only what it can change.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.compiled import inline, plain, stay_outside
from phnn.integrate.constants import CONSTANTS, fill_actions, fill_constants, fill_gains
from phnn.integrate.lookups import count, is_linear, junction_storage
from phnn.integrate.program import Program
from phnn.integrate.step import CHANGE, FORCE, junction_flows, junction_terms, leaf_step, modulate
from phnn.integrate.tables import FACTORS, JUNCTIONS, LEAVES, PORTS, rows_of
from phnn.laws.namespace import TINY


class Pattern(NamedTuple):
    """Where the derivatives of a step by states, unknowns and some parameters are not zero, inputs in that order.

    Attributes:
        active: (K,) places in theta.
        in_ports: (K,) whether a parameter stands in a port law.
        in_junctions: (I,) whether an input stands in the junctions' block.
        first: (I+1,) and leaf: (pairs,) the leaves that contain each input.
    """

    active: NDArray[np.int64]
    in_ports: NDArray[np.bool_]
    in_junctions: NDArray[np.bool_]
    first: NDArray[np.int64]
    leaf: NDArray[np.int64]


def pattern_of(program: Program, active: NDArray[np.int64]) -> Pattern:
    """The pattern of a program for the parameters at some places."""
    known = len(program.states) + len(program.junctions)
    inputs = [*range(known), *(known + int(place) for place in active)]
    *leaves, junctions = program.uses
    found = [[leaf for leaf, uses in enumerate(leaves) if i in uses] for i in inputs]
    ports = set(rows_of(program.table, PORTS)[:, 1:5].ravel().tolist())
    return Pattern(
        np.asarray(active, dtype=np.int64),
        np.array([int(place) in ports for place in active], dtype=np.bool_),
        np.array([i in junctions for i in inputs], dtype=np.bool_),
        np.cumsum([0, *map(len, found)]).astype(np.int64),
        np.array([leaf for leaves_ in found for leaf in leaves_], dtype=np.int64),
    )


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
def load_step(t: Any, n: Any, states: Any, efforts: Any, x: Any, y: Any) -> None:
    """State and unknowns of a step that has been marched, without perturbations."""
    for k in range(x.shape[0]):
        x[k] = complex(states[n, k], 0.0)
    for j in range(y.shape[0]):
        k = junction_storage(t, j)
        y[j] = complex(efforts[n, k] if is_linear(t, j) else states[n + 1, k], 0.0)


@plain
def linearise(
    t: Any, p: Any, theta: Any, c: Any, g: Any, a: Any, x: Any, y: Any, u: Any, h: Any, wj: Any, by_leaf: Any,
    by_force: Any, by_change: Any,
) -> None:  # fmt: skip
    """Fill the derivatives of a step by every input.

    Args:
        t, p: table and pattern; theta, x, y: complex, without perturbations.
        c, g: from `perturbed_constants`; a: (2, P) and wj: (4, m) memory.
        by_leaf: (pairs,) of the leaves' end states, as listed by the pattern.
        by_force, by_change: (I, m) of ``F`` and of ``z − p``.
    """
    stay_outside()
    n, m, none = x.shape[0], y.shape[0], p.active.shape[0]
    fill_actions(t, theta, u, a[0])
    for i in range(n + m + none):
        k = max(i - n - m, -1)
        which = k if k >= 0 else none
        act = a[0]
        if i < n:
            x[i] += TINY * 1j
        elif i < n + m:
            y[i - n] += TINY * 1j
        else:
            theta[p.active[k]] += TINY * 1j
            if p.in_ports[k]:
                act = a[1]
                fill_actions(t, theta, u, act)
        _block_derivatives(
            t, p, i, theta, c[which], g[which], act, x, y, h, wj, by_leaf, by_force[i], by_change[i]
        )  # fmt: skip
        if i < n:
            x[i] = complex(x[i].real, 0.0)
        elif i < n + m:
            y[i - n] = complex(y[i - n].real, 0.0)
        else:
            theta[p.active[k]] = complex(theta[p.active[k]].real, 0.0)


@inline
def _block_derivatives(
    t: Any, p: Any, i: Any, theta: Any, c: Any, g: Any, a: Any, x: Any, y: Any, h: Any, wj: Any, by_leaf: Any,
    by_force: Any, by_change: Any,
) -> None:  # fmt: skip
    """Imaginary parts of the blocks that contain input ``i``."""
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
    for pair in range(p.first[i], p.first[i + 1]):
        leaf = p.leaf[pair]
        end, mean = leaf_step(t, leaf, theta, c, g, a, x, y, h, wj)
        by_leaf[pair] = end.imag / TINY
        row = t[0, LEAVES] + leaf
        for r in range(t[row, 5], t[row, 6]):
            by_force[t[r, 0]] += (g[r] * mean).imag / TINY


class Derivatives(NamedTuple):
    """Memory for the derivatives of one step."""

    theta: Any
    c: Any
    g: Any
    a: Any
    x: Any
    y: Any
    wj: Any
    by_leaf: Any
    by_force: Any
    by_change: Any


@inline
def new_derivatives(t: Any, p: Any, theta: Any, states: Any, ports: Any) -> Any:
    """Memory for a network and a pattern."""
    m, inputs = count(t, JUNCTIONS), p.first.shape[0] - 1
    none = p.active.shape[0] + 1
    return Derivatives(
        theta.astype(np.complex128),
        np.zeros((none, count(t, LEAVES) + m, CONSTANTS), np.complex128),
        np.zeros((none, t.shape[0]), np.complex128),
        np.zeros((2, ports), np.complex128),
        np.zeros(states, np.complex128),
        np.zeros(m, np.complex128),
        np.zeros((4, m), np.complex128),
        np.zeros(p.leaf.shape[0]),
        np.zeros((inputs, m)),
        np.zeros((inputs, m)),
    )


@inline
def derivatives_at(t: Any, p: Any, d: Any, n: Any, states: Any, efforts: Any, u: Any, h: Any, fresh: Any) -> None:
    """Fill the derivatives of step ``n`` of a march; ``fresh`` where its size differs from that of the last call."""
    if fresh:
        perturbed_constants(t, d.theta, p.active, h[n], d.c, d.g)
    load_step(t, n, states, efforts, d.x, d.y)
    linearise(t, p, d.theta, d.c, d.g, d.a, d.x, d.y, u[n], h[n], d.wj, d.by_leaf, d.by_force, d.by_change)
