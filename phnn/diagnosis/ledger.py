"""The energy ledger of a simulated recording, on stage values: supplied, stored, dissipated, unexplained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.residual import power_balance
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
    balance = power_balance(trajectory)
    losses = balance.dissipated.detach().sum(dim=0).tolist()
    names = [r.name for r in trajectory.setup.network.resistors]
    work = 0.0
    if missing_force is not None:
        work = float(np.sum(trajectory.h * np.abs(missing_force * trajectory.velocity)))
    return Account(
        supplied=float(balance.supplied.detach().sum()),
        stored=float(balance.stored.detach().sum()),
        dissipated=dict(zip(names, losses, strict=True)),
        unexplained=work,
        defect=float(balance.defect.detach().sum()),
    )
