"""Learned laws for networks: torch modules that keep a network passive whatever their weights.

    network = phnn.models.hrc(hysterons=2)
    network = network.replace("hysteron_1", phnn.nn.SectorMLP(effort_scale=20.0, flow_scale=1e-3))
    system = phnn.PortHamiltonianSystem(network)             # D ≥ 0 after every step of every optimiser

A law of your own is a module: ``forward(effort)`` of a resistor, ``energy(x)`` of a storage. `check` tries it; where
training carries it out of its promise, a system leaves out what would deliver power.
"""

from phnn.network.checks import check
from phnn.nn.learned_system import LearnedSystem, Scales
from phnn.nn.multi_ports import LearnedCoupling, LearnedDissipation, LearnedEnergy, LearnedRatio
from phnn.nn.one_ports import ConvexEnergyMLP, MonotoneMLP, SectorMLP

__all__ = [
    "ConvexEnergyMLP",
    "LearnedCoupling",
    "LearnedDissipation",
    "LearnedEnergy",
    "LearnedRatio",
    "LearnedSystem",
    "MonotoneMLP",
    "Scales",
    "SectorMLP",
    "check",
]
