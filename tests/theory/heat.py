"""The first and the second law: thermal energy, entropy, and what a step leaves of their balances.

A memory with a law that holds heat, say of the temperature ``T``, completes the network to an irreversible
port-Hamiltonian system (Ramírez, Maschke & Sbarbaro 2013). ``H`` stays the energy at constant temperature, no storage
law of which knows ``T``; what resistors dissipate becomes heat,

    U' Ṫ = Σ ε φ(ε) − q,     q = (T − T_a)/R_T,     d(H + U)/dt = Σ ψ(u) gᵀ∇H − q
    Ṡ = Σ ε φ(ε)/T − q/T,     Ṡ + q/T_a = Σ ε φ(ε)/T + (T − T_a)²/(R_T T T_a) ≥ 0

Over a step the heat follows the exact flow under the mean dissipated power, so that both hold of steps of any size.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from phnn.laws import MEMORY_LAWS
from phnn.laws.law import Heat
from phnn.network.modulator_states import averages
from phnn.network.system import PortHamiltonianSystem


class ThermalBalance(NamedTuple):
    """Heat and entropy of ``B`` thermal modulator states over steps, in the order of the network.

    Attributes:
        received: (..., B) dissipated power that became heat [J].
        stored: (..., B) ``U(T⁺) − U(T)`` [J].
        released: (..., B) heat given to the ambient at the mean temperature of the step [J].
        entropy: (..., B) change of the bodies' entropy [J/K].
        ambient: (..., B) change of the ambient's, ``released/T_a`` [J/K].
    """

    received: Tensor
    stored: Tensor
    released: Tensor
    entropy: Tensor
    ambient: Tensor

    @property
    def defect(self) -> Tensor:
        """(..., B) ``stored − received + released`` [J]: what rounding leaves of the first law."""
        return self.stored - self.received + self.released

    @property
    def produced(self) -> Tensor:
        """(..., B) entropy produced in body and surroundings [J/K], never negative."""
        return self.entropy + self.ambient


def thermal_energy(
    system: PortHamiltonianSystem,
    x: Tensor,  # (..., n) state
) -> Tensor:
    """(...) ``Σ U`` [J], above that at the reference temperatures."""
    total = torch.zeros_like(x[..., 0])
    for k, heat, values in _bodies(system):
        total = total + heat.energy(x[..., k], *values)
    return total


def total_energy(
    system: PortHamiltonianSystem,
    x: Tensor,  # (..., n) state
) -> Tensor:
    """(...) ``H + Σ U`` [J]: constant but for what ports supply and the ambient takes."""
    return system.energy(x) + thermal_energy(system, x)


def thermal_balance(
    system: PortHamiltonianSystem,
    states: Tensor,  # (N+1, ..., n) at the ends of steps
    drives: Tensor,  # (N, ..., M) mean drives of the modulator states
    h: Tensor,  # (N,) steps [s]
) -> ThermalBalance:
    """Heat and entropy of every step.

    The drives of a compiled integration are the last columns of its mean efforts.
    """
    first = len(system.network.storages)
    shaped = h.reshape(-1, *[1] * (states.ndim - 1))
    mean = averages(system, states[:-1, ..., first:], drives, shaped)
    columns: list[list[Tensor]] = [[] for _ in ThermalBalance._fields]
    for k, heat, values in _bodies(system):
        a, b, step = states[:-1, ..., k], states[1:, ..., k], shaped[..., 0]
        released = step * heat.flow(mean[..., k - first], *values)
        found = (
            step * drives[..., k - first],
            heat.energy(b, *values) - heat.energy(a, *values),
            released,
            heat.entropy(a, b, *values),
            released / heat.ambient(*values),
        )
        for column, value in zip(columns, found, strict=True):
            column.append(value)
    empty = states.new_zeros(*states[:-1].shape[:-1], 0)
    return ThermalBalance(*(torch.stack(c, dim=-1) if c else empty for c in columns))


def _bodies(system: PortHamiltonianSystem) -> list[tuple[int, Heat, list[Any]]]:
    """Place in the state, heat and parameters of every memory that holds heat."""
    first = len(system.network.storages)
    found = []
    for k, memory in enumerate(system.network.memories):
        heat = MEMORY_LAWS[memory.law].heat
        if heat is not None:
            found.append((first + k, heat, [*map(system.value, memory.parameters)]))
    return found
