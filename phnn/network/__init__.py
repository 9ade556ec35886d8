"""Port-Hamiltonian networks: the elements as values, and the torch module made of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from phnn.network.elements import (
    Coupling,
    Modulation,
    ModulatorState,
    MultiPort,
    Network,
    Port,
    Ratio,
    Resistor,
    SharedEnergy,
    Storage,
)

if TYPE_CHECKING:
    from phnn.network.checks import PowerBalance
    from phnn.network.system import DrivenSystem, PortHamiltonianSystem

__all__ = [
    "Coupling",
    "DrivenSystem",
    "Modulation",
    "ModulatorState",
    "MultiPort",
    "Network",
    "Port",
    "PortHamiltonianSystem",
    "PowerBalance",
    "Ratio",
    "Resistor",
    "SharedEnergy",
    "Storage",
]

_NEEDS_TORCH = ("DrivenSystem", "PortHamiltonianSystem", "PowerBalance")


def __getattr__(name: str) -> Any:
    # The values alone need no torch, whose import takes longer than the command line may take to start.
    if name in _NEEDS_TORCH:
        from phnn.network import system

        return getattr(system, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
