"""The rest state of a network under constant inputs, with its derivatives by the parameters.

At rest no flow remains, and every dissipative reducible storage is uncharged (``Q* = 0`` among the equilibria of eq.
(12)). Lossless storages hold ``x_l = Σ_j a_lj ξ_j`` for displacements ``ξ`` of the junctions, such that the forces on
every junction balance:

    Σ_l a_lj E_l(x_l) = Σ_p g_jp ψ_p(u_p)

No power is dissipated, so that a modulator state rests where ``f(z, s)`` vanishes for the efforts and actions that
drive it. If these equations do not determine the state, or inputs act beside the junctions, `phnn.integrate.steady`
finds it.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.program import (
    FACTORS,
    FIRST_LINK,
    FIRST_SOURCE,
    FROM_PORT,
    GYRATORS,
    INTO_JUNCTION,
    JUNCTION_INLETS,
    LAST_LINK,
    LAST_SOURCE,
    LAW,
    LEAF_INLETS,
    LEAVES,
    MODULATOR_STATES,
    OWN_STORAGE,
    PLACE_1,
    PLACE_2,
    RATIO,
    RATIO_PLACE,
    READ,
    READ_MODULATOR,
    RULE,
    SIGN,
    SOURCE_PORT,
    STORAGES,
    TO_JUNCTION,
    Program,
    actions,
    rows_of,
)
from phnn.integrate.scheme import LOSSLESS
from phnn.laws import FACTOR_LAWS, MEMORY_LAWS, STORAGE_LAWS
from phnn.laws.namespace import TINY
from phnn.laws.wide import WIDE_STORAGES, evaluated
from phnn.network.elements import Network

Array = NDArray[np.float64]

_ITERATIONS = 60
# Storage laws with a nonzero effort at zero state.
_WEIGHTS = [code for code, law in enumerate(STORAGE_LAWS.values()) if not law.bounded]


def equilibrium(program: Program, network: Network, u: Array) -> Array:
    """Return (N,) rest state under constant inputs (P,).

    Raises:
        SolverFailed: a state grows without bound, so that there is no rest state; names the state.
    """
    theta = program.theta(network)
    xi = _displacements(program, theta, u)
    return _steady().steady_state(network, u) if xi is None else np.real(_states(program, theta, u, xi))


def equilibrium_derivative(program: Program, network: Network, u: Array, places: NDArray[np.int64]) -> Array:
    """Return (N, K) derivatives of the rest state by the parameters at some entries of theta, by the implicit function
    theorem."""
    out = np.zeros((len(program.states), places.size))
    theta = program.theta(network)
    pulled = _pulled(program, theta, u)
    if not pulled and not len(rows_of(program.table, MODULATOR_STATES)):
        return out
    xi, shift = _displacements(program, theta, u), np.zeros(len(program.junctions))
    if xi is None:
        return _steady().steady_derivative(network, u, [program.names[place] for place in places])
    slopes = _slopes(program, theta, u, xi) if pulled else np.eye(xi.size)
    for k, place in enumerate(places):
        moved = theta.astype(complex)
        moved[place] += 1j * TINY
        # If no force acts for any parameter values, no spring is needed.
        if pulled:
            shift = -np.linalg.solve(slopes, np.imag(_forces(program, moved, u, xi)) / TINY)
        out[:, k] = np.imag(_states(program, moved, u, xi + 1j * TINY * shift)) / TINY
    return out


def equilibrium_slope(program: Program, network: Network, u: Array, port: int) -> Array:
    """Return (N,) derivative of the rest state by the input at one port.

    Raises:
        SolverFailed: there is no rest state close by; names the states that grow without bound.
    """
    theta = program.theta(network).astype(complex)
    along = np.arange(u.size) == port
    xi = _displacements(program, theta.real, u) if served(program) else None
    slopes = np.zeros((0, 0)) if xi is None else _slopes(program, theta.real, u, xi)
    if xi is not None and np.linalg.matrix_rank(slopes) == xi.size:
        shift = -np.linalg.solve(slopes, np.imag(_forces(program, theta, u + 1j * TINY * along, xi)) / TINY)
        return np.asarray(np.imag(_states(program, theta, u + 1j * TINY * along, xi + 1j * TINY * shift)) / TINY)
    return _steady().steady_slope(network, u, port)


def _steady() -> ModuleType:
    """`phnn.integrate.steady`, imported on first use: it needs torch, whose import takes longer than most solves."""
    from phnn.integrate import steady

    return steady


def _pulled(program: Program, theta: Array, u: Array) -> bool:
    """Whether inputs, or storages with an effort at zero state such as weights, exert forces on an empty network."""
    rows = rows_of(program.table, STORAGES)
    weights = np.isin(rows[:, LAW], _WEIGHTS).any()
    return bool(np.any(u) or weights)


def _displacements(program: Program, theta: Array, u: Array) -> Array | None:
    """Return (m,) ``ξ`` by Newton's method; None where they do not determine the rest state."""
    if not _pulled(program, theta, u):
        return np.zeros(len(program.junctions))
    if not served(program):
        return None
    xi = np.zeros(len(program.junctions))
    start = np.abs(_forces(program, theta, u, xi)).max()
    for _ in range(_ITERATIONS):
        force = np.real(_forces(program, theta, u, xi))
        if not np.isfinite(force).all() or np.abs(force).max() <= 1e-14 * start:
            break
        slopes = _slopes(program, theta, u, xi)
        if np.linalg.matrix_rank(slopes) < xi.size:
            return None
        xi = xi - np.linalg.solve(slopes, force)
    return xi


def served(program: Program) -> bool:
    """Return whether displacements of the junctions determine the rest state: there are some, and no input acts beside
    them."""
    beside = len(rows_of(program.table, LEAF_INLETS)) + len(rows_of(program.table, GYRATORS))
    return bool(program.junctions) and not beside


def _slopes(program: Program, theta: Array, u: Array, xi: Array) -> Array:
    """Return (m, m) derivative of the forces by the displacements."""
    columns = [np.imag(_forces(program, theta, u, xi + 1j * TINY * e)) / TINY for e in np.eye(xi.size)]
    return np.column_stack(columns)


def _lossless(program: Program) -> NDArray[np.int64]:
    leaves = rows_of(program.table, LEAVES)
    return leaves[leaves[:, RULE] == LOSSLESS]


def _states(program: Program, theta: Any, u: Array, xi: Any) -> Any:
    """Return (N,) states at junction displacements."""
    x = np.zeros(len(program.states), dtype=np.result_type(theta, xi))
    for leaf in _lossless(program):
        for row in program.table[leaf[FIRST_LINK] : leaf[LAST_LINK]]:
            x[leaf[OWN_STORAGE]] += row[SIGN] * theta[row[RATIO]] * xi[row[TO_JUNCTION]]
    for k, row in enumerate(rows_of(program.table, MODULATOR_STATES)):
        law = list(MEMORY_LAWS.values())[row[LAW]]
        values = [theta[p] for p in row[PLACE_1 : PLACE_1 + len(law.example)]]
        drive = _resting_drive(program, row, theta, u, x)
        x[len(rows_of(program.table, STORAGES)) + k] = law.rate(0.0, drive, *values) / law.decay(*values)
    return x


def _resting_drive(program: Program, memory: NDArray[np.int64], theta: Any, u: Array, x: Any) -> Any:
    """Return the drive of a modulator state at rest: efforts of lossless storages and actions of ports."""
    total = 0.0 * theta[0]
    lossless = _lossless(program)[:, OWN_STORAGE]
    for _, _, storage, _, port in program.table[memory[FIRST_SOURCE] : memory[LAST_SOURCE], : SOURCE_PORT + 1]:
        if storage in lossless:
            total = total + _effort(program, storage, theta, x[storage])
        if port >= 0:
            total = total + actions(program, theta, u)[port]
    return total


def _forces(program: Program, theta: Any, u: Array, xi: Any) -> Any:
    """Return (m,) force on every junction at rest."""
    x = _states(program, theta, u, xi)
    ratio: dict[int, Any] = {}
    for row in rows_of(program.table, FACTORS):
        place = int(row[RATIO_PLACE])
        ratio[place] = ratio.get(place, theta[place]) * _factor(program, row, theta, x)
    force = np.zeros(len(program.junctions), dtype=x.dtype)
    for leaf in _lossless(program):
        effort = _effort(program, leaf[OWN_STORAGE], theta, x[leaf[OWN_STORAGE]])
        for row in program.table[leaf[FIRST_LINK] : leaf[LAST_LINK]]:
            force[row[TO_JUNCTION]] += row[SIGN] * ratio.get(int(row[RATIO]), theta[row[RATIO]]) * effort
    pushed = actions(program, theta, u)
    for row in rows_of(program.table, JUNCTION_INLETS):
        force[row[INTO_JUNCTION]] -= ratio.get(int(row[RATIO]), theta[row[RATIO]]) * pushed[row[FROM_PORT]]
    return force


def _factor(program: Program, row: NDArray[np.int64], theta: Any, x: Any) -> Any:
    """Return ``f(x)`` of a modulation. It reads a reducible storage, a modulator state, or a junction, which is zero at
    rest."""
    law = list(FACTOR_LAWS.values())[row[LAW]]
    leaf, _, memory = program.table[row[READ], : READ_MODULATOR + 1]
    q = x[memory] if memory >= 0 else x[rows_of(program.table, LEAVES)[leaf, OWN_STORAGE]] if leaf >= 0 else 0.0
    return law.factor(q, *(theta[p] for p in row[PLACE_1 : PLACE_1 + len(law.example)]))


def _effort(program: Program, storage: int, theta: Any, x: Any) -> Any:
    row = rows_of(program.table, STORAGES)[storage]
    known = list(STORAGE_LAWS.values())
    if row[LAW] < len(known):
        law = known[row[LAW]]
        return law.mean_effort(x, x, *(theta[p] for p in row[PLACE_1 : PLACE_1 + len(law.example)]))
    wide = list(WIDE_STORAGES.values())[row[LAW] - len(known)]
    weights = theta[row[PLACE_1] : row[PLACE_1] + wide.head + wide.per_unit * row[PLACE_2]]
    return evaluated(wide, weights, np.asarray(x), np.asarray(x))
