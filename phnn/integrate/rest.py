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

from collections.abc import Sequence
from dataclasses import replace
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from phnn.errors import SolverFailed
from phnn.integrate.actions import actions
from phnn.integrate.program import Program
from phnn.integrate.tables import (
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
    LOSSLESS,
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
    rows_of,
)
from phnn.laws import FACTOR_LAWS, MEMORY_LAWS, STORAGE_LAWS
from phnn.laws.namespace import TINY
from phnn.laws.wide import WIDE_STORAGES, mean_effort
from phnn.network.elements import Network
from phnn.network.system import PortHamiltonianSystem

#     [J − D] ∇H(x) + g ψ(u) = 0,     C x = 0
#
# ``C`` are the invariants, ``C [J, b_1, …, b_R, g] = 0``: a charge that no flow changes stays zero. Flows need not
# vanish: a tank with a steady inflow reaches the level at which its outlet carries the same flow.
#
# A resistor is silent if its flow is zero around its effort, as in a dead zone. With silent resistors, the steady
# states form a set. The solution is the one to which the smallest leaks in parallel with the silent resistors would
# lead, with the least ``Σ ε_r²``: uncharged hysterons, in the paper's actuator. Modulator states rest at the
# equilibrium of their laws under the steady drives.

# Tolerances: of the steps, relative to the state; of the rates, relative to the terms that cancel in them.
_CONVERGED, _BALANCED = 1e-12, 1e-9
# A singular value below this share of the largest counts as zero; rows and columns are equilibrated before.
_RANK = 1e-11
_SWEEPS = 20


class _Point(NamedTuple):
    """A network at a state.

    Attributes:
        rate: (n,) ``ẋ``; terms: (n,) sum of the absolute values of the terms that cancel in it, zero for modulator
            states.
        slope: (n, n) derivative of the rate.
        is_silent: (R,) which resistors are silent; silent: (S,) their efforts; by_state: (S, n) derivative.
        invariants: (c, n) ``C``.
    """

    rate: Array
    terms: Array
    slope: Array
    is_silent: NDArray[np.bool_]
    silent: Array
    by_state: Array
    invariants: Array


def steady_state(network: Network, u: Array) -> Array:
    """(n,) steady state under constant inputs (P,), by Newton's method from the zero state.

    Raises:
        SolverFailed: there is no steady state, or it is not found: names the storages and the remedy.
    """
    system = PortHamiltonianSystem(network)
    x = np.zeros(len(network.state_names))
    for _ in range(_ITERATIONS):
        step, (rows, columns), free = _newton(_at(system, u, x), x)
        x = x + step
        if not np.isfinite(x).all() or np.abs(step / columns).max() <= _CONVERGED * np.abs(x / columns).max():
            break
    point, rows = _at(system, u, x), rows[: x.size]
    # A rate with a single term is rounding as a whole: its scale is the largest of all rates.
    size = max(np.abs(x / columns).max(), (rows * point.terms).max())
    moving = ~(np.abs(rows * point.rate) <= _BALANCED * size)
    if moving.any():
        raise SolverFailed(_why(network, free, moving))
    return x


def steady_derivative(network: Network, u: Array, names: Sequence[str]) -> Array:
    """(n, K) derivatives of the steady state by the values of parameters.

    The state minimises ``½ |ε_S|²`` of the silent resistors under ``G = (ẋ, C x) = 0``. With the multipliers ``λ`` the
    implicit function theorem gives, for ``L = ½ |ε_S|² + λᵀ G``,

        [ L_xx  G_xᵀ ] [ δx ]     [ L_xθ ]
        [ G_x   0    ] [ δλ ] = − [ G_θ  ] δθ,

    of which the solution of least norm is taken, as in `steady_state`.

    Raises:
        SolverFailed: as of `steady_state`.
    """
    steady = steady_state(network, u)
    if not names:
        return np.zeros((steady.size, 0))
    # Without bounds, so that every value has a derivative.
    table = {
        name: replace(p, lower=-np.inf, upper=np.inf, fixed=False) if name in names else p
        for name, p in network.parameters.items()
    }
    system = PortHamiltonianSystem(replace(network, parameters=table))
    coordinates = [system.free.z[name] for name in names]
    by_coordinate = _implicit(system, steady, torch.from_numpy(u), coordinates)
    values = [torch.autograd.grad(system.value(name), z)[0].item() for name, z in zip(names, coordinates, strict=True)]
    return by_coordinate / np.array(values)


def steady_slope(network: Network, u: Array, port: int) -> Array:
    """(n,) derivative of the steady state by the input at one port, as `steady_derivative`."""
    inputs = [torch.tensor(value, dtype=torch.float64, requires_grad=k == port) for k, value in enumerate(u)]
    found = _implicit(PortHamiltonianSystem(network), steady_state(network, u), torch.stack(inputs), [inputs[port]])
    return np.asarray(found[:, 0])


def _implicit(system: PortHamiltonianSystem, steady: Array, u: Tensor, by: Sequence[Tensor]) -> Array:
    """(n, K) derivatives of a steady state by some scalars on which the system or its inputs depend.

    Raises:
        SolverFailed: there is no steady state close by; names the states that grow without bound.
    """
    point = _at(system, u.detach().numpy(), steady)
    x = torch.from_numpy(steady).requires_grad_(True)
    residual, silent = _conditions(system, point, x, u)
    constraint = _rows(residual, [x])
    multipliers = np.linalg.lstsq(constraint.T, -point.by_state.T @ point.silent, rcond=_RANK)[0]
    objective = 0.5 * (silent**2).sum() + (torch.from_numpy(multipliers) * residual).sum()
    (slope,) = torch.autograd.grad(objective, x, create_graph=True)
    count = constraint.shape[0]
    matrix = np.block([[_rows(slope, [x]), constraint.T], [constraint, np.zeros((count, count))]])
    right = -np.vstack([_rows(slope, by), _rows(residual, by)])
    rows, columns = _equilibrated(matrix)
    scaled, right = rows[:, None] * matrix * columns, rows[:, None] * right
    found, _ = _least(scaled, right)
    # Residual at the level of rounding.
    found = found + _least(scaled, right - scaled @ found)[0]
    defect = np.abs(scaled @ found - right).max(axis=1)
    if (defect > _BALANCED * np.abs(right).max(initial=0.0)).any():
        # A small change makes a state grow without bound.
        moving = defect[steady.size : 2 * steady.size] > 0.0
        raise SolverFailed(_why(system.network, _newton(point, steady)[2], moving))
    return np.asarray((columns[:, None] * found)[: steady.size])


def _conditions(system: PortHamiltonianSystem, point: _Point, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """(n + c,) ``G`` and (S,) efforts of the silent resistors, differentiable to second order."""
    branches, inputs = system.incidences(x)
    touched = torch.cat([system.structure(x), branches, inputs], dim=-1)
    invariants = torch.from_numpy(point.invariants)
    first = touched.shape[0]
    # The invariants depend on the ratios: δC = −C δA A⁺ for C A = 0.
    by_ratio = torch.from_numpy(np.linalg.pinv(touched.detach().numpy(), rcond=_RANK)) @ x.detach()[:first]
    held = invariants @ x - invariants[:, :first] @ (touched @ by_ratio)
    epsilon = system.branch_efforts(system.efforts(x), x)
    return torch.cat([system.vector_field(x, u), held]), epsilon[torch.from_numpy(point.is_silent)]


def _rows(values: Tensor, by: Sequence[Tensor]) -> Array:
    """(m, K) derivatives of values (m,) by one vector (K,) or by K scalars."""
    out = np.zeros((values.shape[0], sum(b.numel() for b in by)))
    for i in range(values.shape[0]):
        if values.requires_grad:
            found = torch.autograd.grad(values[i], list(by), retain_graph=True, materialize_grads=True)
            out[i] = torch.cat([f.reshape(-1) for f in found]).numpy()
    return out


def _at(system: PortHamiltonianSystem, u: Array, x: Array) -> _Point:
    state, inputs = torch.from_numpy(x), torch.from_numpy(u)
    with torch.no_grad():
        structure, (branches, ports) = system.structure(state), system.incidences(state)
        stiffness = torch.autograd.functional.jacobian(system.efforts, state)
        epsilon = system.branch_efforts(system.efforts(state), state)
        flows, pushed = system.branch_flows(epsilon, state), system.actions(inputs)
        terms = (
            structure.abs() @ system.efforts(state).abs() + branches.abs() @ flows.abs() + ports.abs() @ pushed.abs()
        )
        conductances = torch.autograd.functional.jacobian(lambda e: system.branch_flows(e, state), epsilon)
        silent = conductances.diagonal() == 0.0
        slope = torch.autograd.functional.jacobian(lambda s: system.vector_field(s, inputs), state)
        touched = torch.cat([structure, branches, ports], dim=-1).numpy()
        left, size, _ = np.linalg.svd(touched)
        rank = int((size > _RANK * size.max(initial=0.0)).sum())
        slow = len(system.network.memories)
        return _Point(
            system.vector_field(state, inputs).numpy(), np.pad(terms.numpy(), (0, slow)), slope.numpy(),
            silent.numpy(), epsilon[silent].numpy(), (branches.mT @ stiffness)[silent].numpy(),
            np.pad(left[:, rank:].T, ((0, 0), (0, slow))),
        )  # fmt: skip


def _newton(point: _Point, x: Array) -> tuple[Array, tuple[Array, Array], Array]:
    """(n,) step, the factors of rows and columns, and (n, f) directions that the equations leave free."""
    matrix = np.vstack([point.slope, point.invariants])
    right = np.concatenate([-point.rate, -point.invariants @ x])
    rows, columns = _equilibrated(matrix)
    step, free = _least(rows[:, None] * matrix * columns, rows * right)
    if free.size and point.silent.size:
        # The silent resistors determine the free directions.
        along = point.by_state @ (columns[:, None] * free)
        size = np.abs(along).max() or 1.0
        chosen, rest = _least(along / size, -(point.silent + point.by_state @ (columns * step)) / size)
        step, free = step + free @ chosen, free @ rest
    return columns * step, (rows, columns), free


def _equilibrated(matrix: Array) -> tuple[Array, Array]:
    """Factors of rows and columns that bring all their largest entries to one; Ruiz 2001."""
    rows, columns = np.ones(matrix.shape[0]), np.ones(matrix.shape[1])
    for _ in range(_SWEEPS):
        scaled = np.abs(rows[:, None] * matrix * columns)
        by_row, by_column = scaled.max(axis=1), scaled.max(axis=0)
        rows /= np.sqrt(np.where(by_row > 0.0, by_row, 1.0))
        columns /= np.sqrt(np.where(by_column > 0.0, by_column, 1.0))
    return rows, columns


def _least(matrix: Array, right: Array) -> tuple[Array, Array]:
    """The least-squares solution of least norm, and the null space."""
    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        raise SolverFailed("no rest state was found: the network's rates, or their derivatives, are not finite there")
    left, size, across = np.linalg.svd(matrix)
    rank = int((size > _RANK * size.max(initial=0.0)).sum())
    inverse = across[:rank].T / size[:rank]
    return inverse @ (left[:, :rank].T @ right), across[rank:].T


def _why(network: Network, free: Array, moving: NDArray[np.bool_]) -> str:
    names = np.array(network.state_names)
    remedy = "declare start: unknown, or input_before: 0.0"
    loose = names[np.abs(free).max(axis=1, initial=0.0) > _BALANCED]
    if loose.size:
        them = "it" if loose.size == 1 else "them"
        return f"a constant input moves {', '.join(loose)} for ever, nothing holds {them}: {remedy}"
    return f"no rest state under a constant input was found, {', '.join(names[moving])} would not stand still: {remedy}"


Array = NDArray[np.float64]

_ITERATIONS = 60
# Storage laws with a nonzero effort at zero state.
_WEIGHTS = [code for code, law in enumerate(STORAGE_LAWS.values()) if not law.bounded]


def equilibrium(program: Program, network: Network, u: Array) -> Array:
    """(N,) rest state under constant inputs (P,).

    Raises:
        SolverFailed: a state grows without bound, so that there is no rest state; names the state.
    """
    theta = program.theta(network)
    if not _pulled(program, theta, u) and not len(rows_of(program.table, MODULATOR_STATES)):
        return np.zeros(len(program.states))
    xi = _displacements(program, theta, u)
    return _steady().steady_state(network, u) if xi is None else np.real(_states(program, theta, u, xi))


def equilibrium_derivative(program: Program, network: Network, u: Array, places: NDArray[np.int64]) -> Array:
    """(N, K) derivatives of the rest state by the parameters at some entries of theta, by the implicit function
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
    """(N,) derivative of the rest state by the input at one port.

    Raises:
        SolverFailed: there is no rest state close by; names the states that grow without bound.
    """
    theta = program.theta(network).astype(complex)
    along = np.arange(u.size) == port
    xi = _displacements(program, theta.real, u) if _served(program) else None
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
    """(m,) ``ξ`` by Newton's method; None where they do not determine the rest state."""
    if not _pulled(program, theta, u):
        return np.zeros(len(program.junctions))
    if not _served(program):
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


def _served(program: Program) -> bool:
    """Whether displacements of the junctions determine the rest state: there are some, and no input acts beside
    them."""
    beside = len(rows_of(program.table, LEAF_INLETS)) + len(rows_of(program.table, GYRATORS))
    return bool(program.junctions) and not beside


def _slopes(program: Program, theta: Array, u: Array, xi: Array) -> Array:
    """(m, m) derivative of the forces by the displacements."""
    columns = [np.imag(_forces(program, theta, u, xi + 1j * TINY * e)) / TINY for e in np.eye(xi.size)]
    return np.column_stack(columns)


def _lossless(program: Program) -> NDArray[np.int64]:
    leaves = rows_of(program.table, LEAVES)
    return leaves[leaves[:, RULE] == LOSSLESS]


def _states(program: Program, theta: Any, u: Array, xi: Any) -> Any:
    """(N,) states at junction displacements."""
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
    """Drive of a modulator state at rest: efforts of lossless storages and actions of ports."""
    total = 0.0 * theta[0]
    lossless = _lossless(program)[:, OWN_STORAGE]
    for _, _, storage, _, port in program.table[memory[FIRST_SOURCE] : memory[LAST_SOURCE], : SOURCE_PORT + 1]:
        if storage in lossless:
            total = total + _effort(program, storage, theta, x[storage])
        if port >= 0:
            total = total + actions(program, theta, u)[port]
    return total


def _forces(program: Program, theta: Any, u: Array, xi: Any) -> Any:
    """(m,) force on every junction at rest."""
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
    """``f(x)`` of a modulation. It reads a reducible storage, a modulator state, or a junction, which is zero at
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
    return mean_effort(wide, np.asarray(x), np.asarray(x), weights)
