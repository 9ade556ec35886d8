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

from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.errors import SolverFailed
from phnn.integrate.program import GYRATORS, LEAF_INLETS, Program, rows_of
from phnn.integrate.scheme import LOSSLESS, merged_couplings
from phnn.laws import FACTOR_LAWS, MEMORY_LAWS, PORT_LAWS, STORAGE_LAWS
from phnn.laws.namespace import TINY
from phnn.laws.wide import WIDE_STORAGES, evaluated, form_of
from phnn.network.elements import Network, Ratio, Storage

Array = NDArray[np.float64]

_ITERATIONS = 60
# Stiffness over the largest one, and force over the largest one, that count as none.
_RANK = 1e-11
REMEDY = "declare start: unknown, or input_before: 0.0"


def equilibrium(program: Program, network: Network, u: Array) -> Array:
    """Return (N,) rest state under constant inputs (P,).

    Raises:
        SolverFailed: a state grows without bound, so that there is no rest state; names the state.
    """
    balance = _Balance(program, network, u)
    xi = balance.displacements()
    if xi is None and (loose := balance.loose()):
        raise SolverFailed(moving_for_ever(loose))
    return _steady().steady_state(network, u) if xi is None else np.real(balance.states(xi))


def moving_for_ever(names: Sequence[str]) -> str:
    """Say which states nothing holds under a constant input."""
    them = "it" if len(names) == 1 else "them"
    return f"a constant input moves {', '.join(names)} for ever, nothing holds {them}: {REMEDY}"


def equilibrium_derivative(program: Program, network: Network, u: Array, places: NDArray[np.int64]) -> Array:
    """Return (N, K) derivatives of the rest state by the parameters at some entries of theta, by the implicit function
    theorem."""
    out = np.zeros((len(program.states), places.size))
    balance, names = _Balance(program, network, u), [program.names[place] for place in places]
    if not balance.pulled and not network.memories:
        return out
    xi = balance.displacements()
    if xi is None:
        return _steady().steady_derivative(network, u, names)
    # If no force acts for any parameter values, no spring is needed.
    slopes = balance.slopes(xi) if balance.pulled else np.eye(xi.size)
    for k, name in enumerate(names):
        out[:, k] = _Balance(program, network, u, {name: balance.values[name] + 1j * TINY}).moved(xi, slopes)
    return out


def equilibrium_slope(program: Program, network: Network, u: Array, port: int) -> Array:
    """Return (N,) derivative of the rest state by the input at one port.

    Raises:
        SolverFailed: there is no rest state close by; names the states that grow without bound.
    """
    balance = _Balance(program, network, u)
    xi = balance.displacements() if served(program) else None
    slopes = np.zeros((0, 0)) if xi is None else balance.slopes(xi)
    if xi is None or np.linalg.matrix_rank(slopes) < xi.size:
        return _steady().steady_slope(network, u, port)
    return _Balance(program, network, u + 1j * TINY * (np.arange(u.size) == port)).moved(xi, slopes)


def _steady() -> ModuleType:
    """`phnn.integrate.steady`, imported on first use: it needs torch, whose import takes longer than most solves."""
    from phnn.integrate import steady

    return steady


def served(program: Program) -> bool:
    """Return whether displacements of the junctions determine the rest state: there are some, and no input acts beside
    them."""
    inputs = len(rows_of(program.table, LEAF_INLETS)) + len(rows_of(program.table, GYRATORS))
    return bool(program.junctions) and not inputs


class _Balance:
    """The forces on the junctions of a network at rest, in real or in complex numbers.

    Args:
        u: (P,) constant inputs.
        changed: values of some parameters that replace those of the network.
    """

    def __init__(
        self, program: Program, network: Network, u: Any, changed: Mapping[str, complex] | None = None
    ) -> None:
        self.program, self.network, self.u = program, network, u
        self.values: dict[str, Any] = {n: p.value for n, p in network.parameters.items()} | dict(changed or {})
        self.lossless = {s.name: s for s in network.storages if program.rules.get(s.name) == LOSSLESS}
        self.actions = {p.name: PORT_LAWS[p.law].action(v, *self.of(p)) for p, v in zip(network.ports, u, strict=True)}
        # Inputs, or storages with an effort at zero state such as weights, exert forces on an empty network.
        weights = (isinstance(s.law, str) and not STORAGE_LAWS[s.law].bounded for s in network.storages)
        self.pulled = bool(np.any(u)) or any(weights)
        junctions = program.junctions
        self.links: list[tuple[str, int, Ratio, int]] = []
        for (to, of, ratio), times in merged_couplings(network).items():
            for leaf, other, sign in ((to, of, times), (of, to, -times)):
                if leaf in self.lossless:
                    self.links.append((leaf, junctions.index(other), ratio, sign))

    def of(self, element: Any) -> list[Any]:
        """Return the values of an element's parameters."""
        return [self.values[n] for n in element.parameters]

    def ratio(self, ratio: Ratio) -> Any:
        """Return the value of a ratio that no state modulates."""
        return self.values[ratio] if isinstance(ratio, str) else ratio

    def effort(self, storage: Storage, x: Any) -> Any:
        """Return the effort of a storage at a state."""
        if isinstance(storage.law, str):
            return STORAGE_LAWS[storage.law].mean_effort(x, x, *self.of(storage))
        weights = storage.law.weights().detach().numpy()
        return evaluated(WIDE_STORAGES[form_of(storage.law)], weights, np.asarray(x), np.asarray(x))

    def states(self, xi: Any) -> Any:
        """Return (N,) states at displacements (m,) of the junctions."""
        x = dict.fromkeys(self.network.state_names, 0.0 * xi.sum())
        for leaf, j, ratio, sign in self.links:
            x[leaf] = x[leaf] + sign * self.ratio(ratio) * xi[j]
        drives = {n: self.effort(s, x[n]) for n, s in self.lossless.items()} | self.actions
        for memory in self.network.memories:
            law, values = MEMORY_LAWS[memory.law], self.of(memory)
            drive = sum(drives.get(name, 0.0) for name in dict.fromkeys(self.network.drives_of(memory)))
            x[memory.name] = law.rate(0.0, drive, *values) / law.decay(*values)
        return np.array(list(x.values()))

    def forces(self, xi: Any) -> Any:
        """Return (m,) force on every junction."""
        x = dict(zip(self.network.state_names, self.states(xi), strict=True))
        factor: dict[Ratio, Any] = {}
        for m in self.network.modulations:
            # A junction is zero at rest.
            factor[m.ratio] = factor.get(m.ratio, 1.0) * FACTOR_LAWS[m.law].factor(x[m.by], *self.of(m))
        force = [0.0 * xi.sum()] * xi.size
        for leaf, j, ratio, sign in self.links:
            effort = self.effort(self.lossless[leaf], x[leaf])
            force[j] = force[j] + sign * self.ratio(ratio) * factor.get(ratio, 1.0) * effort
        for port in self.network.ports:
            for name, ratio in port.on.items():
                if name in self.program.junctions:
                    j = self.program.junctions.index(name)
                    force[j] = force[j] - self.ratio(ratio) * factor.get(ratio, 1.0) * self.actions[port.name]
        return np.array(force)

    def slopes(self, xi: Array) -> Array:
        """Return (m, m) derivative of the forces by the displacements."""
        return np.column_stack([np.imag(self.forces(xi + 1j * TINY * e)) / TINY for e in np.eye(xi.size)])

    def displacements(self) -> Array | None:
        """Return (m,) ``ξ`` by Newton's method; None where they do not determine the rest state."""
        xi = np.zeros(len(self.program.junctions))
        if not self.pulled:
            return xi
        if not served(self.program):
            return None
        start = np.abs(self.forces(xi)).max()
        for _ in range(_ITERATIONS):
            force = np.real(self.forces(xi))
            if not np.isfinite(force).all() or np.abs(force).max() <= 1e-14 * start:
                break
            slopes = self.slopes(xi)
            if np.linalg.matrix_rank(slopes) < xi.size:
                return None
            xi = xi - np.linalg.solve(slopes, force)
        return xi

    def loose(self) -> list[str]:
        """Return the states that the inputs move along directions in which no spring acts, where a network has springs
        and inertias alone; empty where it has other storages, that may hold a force too."""
        size, storages = len(self.program.junctions), len(self.network.storages)
        if not served(self.program) or storages != len(self.lossless) + size:
            return []
        rest = np.zeros(size)
        force, (_, stiffness, across) = np.real(self.forces(rest)), np.linalg.svd(self.slopes(rest))
        free = across[stiffness <= _RANK * stiffness.max(initial=0.0)]
        along = (free @ force) @ free
        if np.abs(along).max(initial=0.0) <= _RANK * np.abs(force).max():
            return []
        moved = np.real(self.states(along) - self.states(rest))[:storages]
        return [name for name, x in zip(self.network.state_names, moved, strict=False) if x != 0.0]

    def moved(self, xi: Array, slopes: Array) -> Array:
        """Return (N,) derivative of the states along the perturbation of the values or inputs."""
        shift = -np.linalg.solve(slopes, np.imag(self.forces(xi)) / TINY)
        return np.asarray(np.imag(self.states(xi + 1j * TINY * shift)) / TINY)
