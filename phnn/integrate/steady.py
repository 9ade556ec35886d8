"""The steady state that a network reaches from nothing under constant inputs.

    [J − D] ∇H(x) + g ψ(u) = 0,     C x = 0

``C`` are the invariants, ``C [J, b_1, …, b_R, g] = 0``: a charge that nothing changes stays zero. Currents may flow: a
tank that is filled steadily stands as high as its outlet needs. Where resistors are silent around their efforts, as
dead zones are, a whole set of states is steady. Of these it is the one to which the smallest leaks beside them would
lead, ``Σ ε_r²`` of the silent ones least: uncharged hysterons, in the paper's actuator. Memories rest where what drives
them holds them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from phnn.errors import SolverFailed
from phnn.network.elements import Network
from phnn.network.system import PortHamiltonianSystem

Array = NDArray[np.float64]

_ITERATIONS = 60
# Of the steps, beside the state; of what is left of the rates, beside the terms that cancel in them.
_CONVERGED, _BALANCED = 1e-12, 1e-9
# A singular value below this share of the largest is zero, rows and columns being of one size.
_RANK = 1e-11
_SWEEPS = 20
# Relative step of central differences.
_STEP = 1e-5


class _Point(NamedTuple):
    """A network at a state.

    Attributes:
        rate: (n,) ``ẋ``; terms: (n,) sum of the absolute values of what cancels in it, of memories zero.
        slope: (n, n) derivative of the rate.
        silent: (S,) efforts of the silent resistors; by_state: (S, n) their derivative.
        invariants: (c, n) ``C``.
    """

    rate: Array
    terms: Array
    slope: Array
    silent: Array
    by_state: Array
    invariants: Array


def steady_state(network: Network, u: Array) -> Array:
    """(n,) steady state under constant inputs (P,), by Newton's method from nothing.

    Raises:
        SolverFailed: there is none, or it is not found: names the storages and the remedy.
    """
    system = PortHamiltonianSystem(network)
    x = np.zeros(len(network.state_names))
    for _ in range(_ITERATIONS):
        step, (rows, columns), free = _newton(_at(system, u, x), x)
        x = x + step
        if not np.isfinite(x).all() or np.abs(step / columns).max() <= _CONVERGED * np.abs(x / columns).max():
            break
    point, rows = _at(system, u, x), rows[: x.size]
    # A rate of a single term is rounding as a whole: the size is that of the largest.
    size = max(np.abs(x / columns).max(), (rows * point.terms).max())
    moving = ~(np.abs(rows * point.rate) <= _BALANCED * size)
    if moving.any():
        raise SolverFailed(_why(network, free, moving))
    return x


def steady_derivative(network: Network, u: Array, names: Sequence[str]) -> Array:
    """(n, K) derivatives of the steady state by parameters, by central differences."""
    out = np.empty((len(network.state_names), len(names)))
    for k, name in enumerate(names):
        value = network.parameters[name].value
        step = _STEP * (abs(value) or 1.0)
        above, below = (steady_state(_moved(network, name, value + s), u) for s in (step, -step))
        out[:, k] = (above - below) / (2.0 * step)
    return out


def _moved(network: Network, name: str, value: float) -> Network:
    """The network with another value of one parameter, its bounds aside."""
    moved = replace(network.parameters[name], value=value, lower=-np.inf, upper=np.inf)
    return replace(network, parameters={**network.parameters, name: moved})


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
            epsilon[silent].numpy(), (branches.mT @ stiffness)[silent].numpy(),
            np.pad(left[:, rank:].T, ((0, 0), (0, slow))),
        )  # fmt: skip


def _newton(point: _Point, x: Array) -> tuple[Array, tuple[Array, Array], Array]:
    """(n,) step, the factors of rows and columns, and (n, f) directions that nothing determines."""
    matrix = np.vstack([point.slope, point.invariants])
    right = np.concatenate([-point.rate, -point.invariants @ x])
    rows, columns = _equilibrated(matrix)
    step, free = _least(rows[:, None] * matrix * columns, rows * right)
    if free.size and point.silent.size:
        # What is open is settled by the silent resistors.
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
    return across[:rank].T @ (left[:, :rank].T @ right / size[:rank]), across[rank:].T


def _why(network: Network, free: Array, moving: NDArray[np.bool_]) -> str:
    names = np.array(network.state_names)
    remedy = "declare start: unknown, or input_before: 0.0"
    loose = names[np.abs(free).max(axis=1, initial=0.0) > _BALANCED]
    if loose.size:
        them = "it" if loose.size == 1 else "them"
        return f"a constant input moves {', '.join(loose)} for ever, nothing holds {them}: {remedy}"
    return f"no rest state under a constant input was found, {', '.join(names[moving])} would not stand still: {remedy}"
