"""The steady state that a network reaches from the zero state under constant inputs.

    [J − D] ∇H(x) + g ψ(u) = 0,     C x = 0

``C`` are the invariants, ``C [J, b_1, …, b_R, g] = 0``: a charge that no flow changes stays zero. Flows need not
vanish: a tank with a steady inflow reaches the level at which its outlet carries the same flow.

A resistor is silent if its flow is zero around its effort, as in a dead zone. With silent resistors, the steady states
form a set. The solution is the one to which the smallest leaks in parallel with the silent resistors would lead, with
the least ``Σ ε_r²``: uncharged hysterons, in the paper's actuator. Modulator states rest at the equilibrium of their
laws under the steady drives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from phnn.errors import SolverFailed
from phnn.integrate.rest import REMEDY, moving_for_ever
from phnn.network.elements import Network
from phnn.network.system import PortHamiltonianSystem

Array = NDArray[np.float64]

_ITERATIONS = 60
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
    """Return (n,) steady state under constant inputs (P,), by Newton's method from the zero state.

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
    size = (rows * point.terms).max()
    moving = ~(np.abs(rows * point.rate) <= _BALANCED * size)
    if moving.any():
        raise SolverFailed(_why(network, free, moving))
    return x


def steady_derivative(network: Network, u: Array, names: Sequence[str]) -> Array:
    """Return (n, K) derivatives of the steady state by the values of parameters.

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
    """Return (n,) derivative of the steady state by the input at one port, as `steady_derivative`."""
    inputs = [torch.tensor(value, dtype=torch.float64, requires_grad=k == port) for k, value in enumerate(u)]
    slopes = _implicit(PortHamiltonianSystem(network), steady_state(network, u), torch.stack(inputs), [inputs[port]])
    return np.asarray(slopes[:, 0])


def _implicit(system: PortHamiltonianSystem, steady: Array, u: Tensor, by: Sequence[Tensor]) -> Array:
    """Return (n, K) derivatives of a steady state by some scalars on which the system or its inputs depend.

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
    solution, _ = _least(scaled, right)
    # Residual at the level of rounding.
    solution = solution + _least(scaled, right - scaled @ solution)[0]
    defect = np.abs(scaled @ solution - right).max(axis=1)
    if (defect > _BALANCED * np.abs(right).max(initial=0.0)).any():
        # A small change makes a state grow without bound.
        moving = defect[steady.size : 2 * steady.size] > 0.0
        raise SolverFailed(_why(system.network, _newton(point, steady)[2], moving))
    return np.asarray((columns[:, None] * solution)[: steady.size])


def _conditions(system: PortHamiltonianSystem, point: _Point, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """Return (n + c,) ``G`` and (S,) efforts of the silent resistors, differentiable to second order."""
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
    """Return (m, K) derivatives of values (m,) by one vector (K,) or by K scalars."""
    out = np.zeros((values.shape[0], sum(b.numel() for b in by)))
    for i in range(values.shape[0]):
        if values.requires_grad:
            gradients = torch.autograd.grad(values[i], list(by), retain_graph=True, materialize_grads=True)
            out[i] = torch.cat([f.reshape(-1) for f in gradients]).numpy()
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
        # Each flow depends on its own effort alone. A network may have no resistors, and dissipate in a multi-port.
        silent = torch.autograd.functional.jacobian(lambda e: system.branch_flows(e, state).sum(), epsilon) == 0.0
        slope = torch.autograd.functional.jacobian(lambda s: system.vector_field(s, inputs), state)
        touched = torch.cat([structure, branches, ports], dim=-1).numpy()
        left_vectors, size, _ = np.linalg.svd(touched)
        rank = int((size > _RANK * size.max(initial=0.0)).sum())
        slow = len(system.network.memories)
        return _Point(
            system.vector_field(state, inputs).numpy(), np.pad(terms.numpy(), (0, slow)), slope.numpy(),
            silent.numpy(), epsilon[silent].numpy(), (branches.mT @ stiffness)[silent].numpy(),
            np.pad(left_vectors[:, rank:].T, ((0, 0), (0, slow))),
        )  # fmt: skip


def _newton(point: _Point, x: Array) -> tuple[Array, tuple[Array, Array], Array]:
    """Return (n,) step, the factors of rows and columns, and (n, f) directions that the equations leave free."""
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
    """Return the factors of rows and columns that bring all their largest entries to one; Ruiz 2001."""
    rows, columns = np.ones(matrix.shape[0]), np.ones(matrix.shape[1])
    for _ in range(_SWEEPS):
        scaled = np.abs(rows[:, None] * matrix * columns)
        by_row, by_column = scaled.max(axis=1), scaled.max(axis=0)
        rows /= np.sqrt(np.where(by_row > 0.0, by_row, 1.0))
        columns /= np.sqrt(np.where(by_column > 0.0, by_column, 1.0))
    return rows, columns


def _least(matrix: Array, right: Array) -> tuple[Array, Array]:
    """Return the least-squares solution of least norm, and the null space."""
    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        raise SolverFailed("no rest state was found: the network's rates, or their derivatives, are not finite there")
    left_vectors, size, across = np.linalg.svd(matrix)
    rank = int((size > _RANK * size.max(initial=0.0)).sum())
    inverse = across[:rank].T / size[:rank]
    return inverse @ (left_vectors[:, :rank].T @ right), across[rank:].T


def _why(network: Network, free: Array, moving: NDArray[np.bool_]) -> str:
    names = np.array(network.state_names)
    loose = names[np.abs(free).max(axis=1, initial=0.0) > _BALANCED]
    if loose.size:
        return moving_for_ever(loose)
    return f"no rest state under a constant input was found, {', '.join(names[moving])} would not stand still: {REMEDY}"
