"""The energy ledger of a simulated recording, on stage values: supplied, stored, dissipated, unexplained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.program import DISSIPATIVE
from phnn.laws import PORT_LAWS, RESISTOR_LAWS, STORAGE_LAWS
from phnn.simulate import Trajectory

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Account:
    """Energies of one recording [J], "up to one common factor" without an anchor.

    Attributes:
        supplied: by the ports, ``Σ h g ψ(ū) v̄``.
        stored: ``H(end) − H(start)``.
        dissipated: by element.
        unexplained: work of the missing effort, ``Σ h |f v̄|``; 0 where none was located.
        defect: what the balance misses; rounding only.
    """

    supplied: float
    stored: float
    dissipated: Mapping[str, float]
    unexplained: float
    defect: float


def account(trajectory: Trajectory, missing_force: Array | None = None) -> Account:
    """The ledger of a trajectory.

    Args:
        missing_force: (n,) effort that a located mismatch asks for [N].
    """
    program, theta, h, v = trajectory.program, trajectory.theta, trajectory.h, trajectory.velocity
    force = np.zeros_like(v)
    for j, row in enumerate(program.ports):
        law = list(PORT_LAWS.values())[row[0]]
        force = force + theta[row[1]] * law.action(trajectory.u[:, j], *theta[row[2 : 2 + len(law.example)]])
    states = trajectory.states
    stored = 0.5 * (states[-1, -1] ** 2 - states[0, -1] ** 2) / theta[program.inertia]
    dissipated: dict[str, float] = {}
    names = {next(iter(r.on)): r.name for r in trajectory.setup.network.resistors}
    for i, row in enumerate(program.leaves):
        storage = list(STORAGE_LAWS.values())[row[1]]
        values = theta[row[4 : 4 + len(storage.example)]]
        change = float(storage.energy(states[-1, i], *values) - storage.energy(states[0, i], *values))
        stored += change
        if row[0] == DISSIPATIVE:
            taken = float(np.sum(h * theta[row[3]] * v * trajectory.efforts[:, i]))
            dissipated[names[program.leaf_names[i]]] = taken - change
    on_flow = [r for r in trajectory.setup.network.resistors if next(iter(r.on)) not in program.leaf_names]
    for resistor, row in zip(on_flow, program.resistors, strict=True):
        flow = RESISTOR_LAWS[resistor.law]
        q = trajectory.mid_displacement
        values = theta[row[2 : 2 + len(flow.example)]]
        dissipated[resistor.name] = float(np.sum(h * v * flow.flow(v, q, *values)))
    supplied = float(np.sum(h * v * force))
    unexplained = 0.0 if missing_force is None else float(np.sum(h * np.abs(missing_force * v)))
    defect = supplied - stored - sum(dissipated.values())
    return Account(supplied, float(stored), dissipated, unexplained, defect)
