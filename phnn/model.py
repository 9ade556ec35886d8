"""A model as one value: what lies between a recorded input and a recorded output, ready to simulate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phnn.errors import InputRefused
from phnn.models.store import save
from phnn.recordings.recording import unrecorded
from phnn.setup import Setup
from phnn.simulate import Trajectory, simulate

if TYPE_CHECKING:
    from phnn.network.system import PortHamiltonianSystem

# By how much of an interval the steps of a time axis may differ from each other.
_UNIFORM = 1e-3


@dataclass(frozen=True)
class Model:
    """An identified or stored model.

        model = phnn.load("out/model")
        y = model.simulate(t, voltage)                       # (N,) displacement [m]
        system = model.module                                # torch module, for gradients and torchdiffeq

    Attributes:
        setup: amplifier, port-Hamiltonian network and sensor.
        substeps: integration steps in a sample interval of the recordings that it was identified from.
    """

    setup: Setup
    substeps: int = 1

    @property
    def parameters(self) -> dict[str, float]:
        """Values of all parameters in SI units, by name."""
        return self.setup.values()

    @property
    def module(self) -> PortHamiltonianSystem:
        """The network as a torch module with ``J``, ``D(x)``, ``H``, efforts and ports; `torchdiffeq` can integrate it.

        Amplifier and sensor are no part of it.
        """
        from phnn.network.system import PortHamiltonianSystem

        return PortHamiltonianSystem(self.setup.network)

    def simulate(
        self,
        t: ArrayLike,
        u: ArrayLike,
        *,
        input_before: float | None = None,
        further: Mapping[str, ArrayLike] | None = None,
        substeps: int | None = None,
    ) -> NDArray[np.float64]:
        """Simulate the output from rest.

        Args:
            t: (N,) time [s], increasing in equal steps.
            u: (N,) input in the SI unit of the network's first port: for an actuator its voltage [V], for an imposed
                motion its velocity [m/s].
            input_before: constant input before the first sample, in whose equilibrium the model begins; None: ``u[0]``.
            further: (N,) inputs at further ports, by the port's name; zero where left out.
            substeps: integration steps in an interval; those of the model if None.

        Returns:
            (N,) output in SI units, for an actuator its displacement [m].

        Raises:
            InputRefused: fewer than two samples, arrays of different lengths, values that are not finite, steps that
                differ, or a port that the network does not have.
            SolverFailed: a step has no solution.
        """
        found = self.trajectory(t, u, input_before=input_before, further=further, substeps=substeps)
        return np.asarray(found.y)

    def trajectory(
        self,
        t: ArrayLike,
        u: ArrayLike,
        *,
        input_before: float | None = None,
        further: Mapping[str, ArrayLike] | None = None,
        substeps: int | None = None,
    ) -> Trajectory:
        """Simulate from rest and return states and efforts of every step beside the output; arguments as of
        `simulate`."""
        time, voltage = _series("t", t), _series("u", u)
        others = {name: _series(name, values) for name, values in (further or {}).items()}
        _check(time, {"u": voltage, **others})
        ports = {p.name for p in self.setup.network.ports[1:]}
        for name in others.keys() - ports:
            raise InputRefused(f"further: no port {name!r}; there are {', '.join(sorted(ports)) or 'no further ports'}")
        before = float(voltage[0]) if input_before is None else float(input_before)
        recording = unrecorded("simulate", time - time[0], voltage, input_before=before, further=others)
        return simulate(self.setup, recording, substeps or self.substeps)

    def save(self, folder: str | Path) -> None:
        """Write the model into a folder, as ``model/`` of a diagnosis.

        Raises:
            InputRefused: the folder holds other files, or cannot be written to.
        """
        save(self.setup, Path(folder), self.substeps)


def _series(name: str, values: Any) -> NDArray[np.float64]:
    """(N,) values as float64.

    Raises:
        InputRefused: they are no numbers, or do not stand in one row.
    """
    try:
        found = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputRefused(f"{name}: {error}: give an array of numbers") from error
    if found.ndim != 1:
        raise InputRefused(f"{name} has shape {found.shape}: give one value per sample, shape (N,)")
    return found


def _check(t: NDArray[np.float64], inputs: Mapping[str, NDArray[np.float64]]) -> None:
    """Refuse what cannot be simulated.

    Raises:
        InputRefused: names the array, and what is wrong with it.
    """
    if t.size < 2:
        raise InputRefused(f"t has {t.size} samples: give at least 2")
    for name, values in {"t": t, **inputs}.items():
        if values.size != t.size:
            raise InputRefused(f"{name} has {values.size} samples and t has {t.size}: give as many")
        if not np.isfinite(values).all():
            raise InputRefused(f"{name}[{int(np.argmin(np.isfinite(values)))}] is not finite: leave such samples out")
    steps, mean = np.diff(t), (t[-1] - t[0]) / (t.size - 1)
    if not (mean > 0.0 and np.abs(steps - mean).max() <= _UNIFORM * mean):
        raise InputRefused(
            f"t increases by {steps.min():.6g} to {steps.max():.6g} s: give equal steps, for example np.linspace"
        )
