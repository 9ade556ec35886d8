"""A model as one value: what lies between a recorded input and a recorded output, ready to simulate."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phnn.errors import InputRefused
from phnn.html import table, titled
from phnn.models.store import save
from phnn.recordings.manifest import INPUTS
from phnn.recordings.recording import unrecorded
from phnn.setup import Setup
from phnn.signals.sampling import check_samples, series
from phnn.trajectory import Trajectory, simulate

if TYPE_CHECKING:
    from phnn.inverse.invert import Inverse
    from phnn.network.elements import Network
    from phnn.network.system import PortHamiltonianSystem

# A command may leave the recorded range by this share of it before that is told.
_MARGIN = 0.02


@dataclass(frozen=True)
class Model:
    """An identified or stored model.

        model = phnn.load("out/model")
        y = model.simulate(t, voltage)                       # (N,) displacement [m]
        system = model.module                                # torch module, for gradients and torchdiffeq

    Attributes:
        setup: amplifier, port-Hamiltonian network and sensor.
        substeps: integration steps in a sample interval of the recordings that it was identified from.
        inputs: least and largest input of these recordings, SI; None where they are not known.
    """

    setup: Setup
    substeps: int = 1
    inputs: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.setup, Setup):
            raise InputRefused(
                f"a model is made of a Setup, not of a {type(self.setup).__name__}: Model(Setup(network))"
            )

    def __repr__(self) -> str:
        states = ", ".join(self.setup.network.state_names)
        values = ", ".join(f"{name} = {self.setup.parameters[name].value:.4g}" for name in self.setup.free)
        return f"<Model {self.setup.name}: states {states}; {values}>"

    def _repr_html_(self) -> str:
        rows = ((n, p.value, p.unit, p.description) for n, p in self.setup.parameters.items())
        values = table(("parameter", "value", "unit", "meaning"), rows)
        return titled(f"Model {self.setup.name}", self.setup.network._repr_html_(), values)

    @property
    def parameters(self) -> dict[str, float]:
        """Return the values of all parameters in SI units, by name."""
        return self.setup.values()

    @cached_property
    def module(self) -> PortHamiltonianSystem:
        """Return the network as a torch module with ``J``, ``D(x)``, ``H``, efforts and ports, for `torchdiffeq`.

        Amplifier and sensor are no part of it. It is always the same module, with laws and parameters of its own:
        ``model.with_network(model.module.as_network())`` is the model with the trained laws and parameters.
        """
        from phnn.integrate.method import PortHamiltonianSystem

        return PortHamiltonianSystem(self.setup.network)

    def with_network(self, network: Network) -> Model:
        """Return the model with another network between its amplifier and its sensor."""
        return replace(self, setup=replace(self.setup, network=network))

    def simulate(
        self,
        t: ArrayLike,
        u: ArrayLike,
        *,
        input_before: float | None = None,
        further: Mapping[str, ArrayLike] | None = None,
        substeps: int | None = None,
        hold: str = "cubic",
    ) -> NDArray[np.float64]:
        """Simulate the output from rest.

        Args:
            t: (N,) time [s], increasing in equal steps.
            u: (N,) input in the SI unit of the network's first port: for an actuator its voltage [V], for an imposed
                motion its velocity [m/s].
            input_before: constant input before the first sample, in whose equilibrium the model begins; None: ``u[0]``.
            further: (N,) inputs at further ports, by the port's name; zero where left out.
            substeps: integration steps in an interval; those of the model if None.
            hold: the input between its samples: ``"cubic"``, ``"linear"``, ``"band_limited"``, or ``"zero_order"`` as a
                converter holds it.

        Returns:
            (N,) output in SI units, for an actuator its displacement [m].

        Raises:
            InputRefused: fewer than two samples, arrays of different lengths, values that are not finite, steps that
                differ, a port that the network does not have, or an unknown hold.
            SolverFailed: a step has no solution. A warning tells where the input leaves the range of the recordings.
        """
        return self.trajectory(t, u, input_before=input_before, further=further, substeps=substeps, hold=hold).y

    def trajectory(
        self,
        t: ArrayLike,
        u: ArrayLike,
        *,
        input_before: float | None = None,
        further: Mapping[str, ArrayLike] | None = None,
        substeps: int | None = None,
        hold: str = "cubic",
    ) -> Trajectory:
        """Simulate from rest; return states and efforts of every step and the output. Arguments as of `simulate`."""
        time, voltage = series("t", t), series("u", u)
        others = {name: series(name, values) for name, values in (further or {}).items()}
        check_samples(time, {"u": voltage, **others})
        ports = {p.name for p in self.setup.network.ports[1:]}
        for name in others.keys() - ports:
            raise InputRefused(f"further: no port {name!r}; there are {', '.join(sorted(ports)) or 'no further ports'}")
        if hold not in INPUTS:
            raise InputRefused(f"hold = {hold!r}: choose one of {', '.join(INPUTS)}")
        before = float(voltage[0]) if input_before is None else float(input_before)
        for beyond in self._beyond(voltage):
            warnings.warn(beyond, stacklevel=3)
        recording = unrecorded("simulate", time - time[0], voltage, hold, before, others)
        return simulate(self.setup, recording, substeps or self.substeps)

    def inverse(
        self,
        t: ArrayLike,
        reference: ArrayLike,
        *,
        smooth: float | None = None,
        limits: tuple[float, float] | None = None,
        slew: float | None = None,
        hold: str = "cubic",
        lead_in: float = 0.0,
        tolerance: float | None = None,
        iterations: int = 20,
    ) -> Inverse:
        """Find the input with which the output follows a reference, from rest at its first value.

            answer = model.inverse(t, reference, limits=(-30.0, 150.0))
            answer.voltage, answer.reached, answer.messages

        Args:
            t: (N,) time [s], increasing in equal steps.
            reference: (N,) output that is wanted, SI; for an actuator its displacement [m].
            smooth: corner of a low-pass without phase that the reference passes first [Hz].
            limits: lowest and highest input [V].
            slew: largest rate of the input [V/s].
            hold: the input between its samples, as `simulate` takes it: ``"cubic"``, or ``"zero_order"`` as a converter
                holds it.
            lead_in: time before the first sample in which the motion begins from rest [s].
            tolerance: largest error that counts as none, SI; None: a hundred-thousandth of the reference's range.
            iterations: at most as many simulations.

        Returns:
            Voltage, reached output, error, and in words what cannot be reached; see `phnn.inverse.Inverse`.

        Raises:
            InputRefused: arrays that are no equally spaced samples, an option out of its range, a reference that is
                mostly noise, or a model whose motion does not tell its input.
            SolverFailed: a step has no solution.
        """
        from phnn.inverse import InverseOptions, invert

        options = InverseOptions(smooth, limits, slew, hold, lead_in, tolerance, iterations)
        answer = invert(self.setup, self.substeps, series("t", t), series("reference", reference), options)
        return replace(answer, messages=(*answer.messages, *self._beyond(answer.voltage)))

    def _beyond(self, voltage: NDArray[np.float64]) -> tuple[str, ...]:
        """Say where an input leaves the range of the recordings."""
        low, high = self.inputs or (-np.inf, np.inf)
        margin, unit = _MARGIN * (high - low), self.setup.network.ports[0].unit
        if voltage.min() >= low - margin and voltage.max() <= high + margin:
            return ()
        return (
            f"The input reaches {voltage.min():.4g} to {voltage.max():.4g} {unit}, but the model was identified "
            f"between {low:.4g} and {high:.4g} {unit}: beyond that it extrapolates.",
        )

    def save(self, folder: str | Path) -> None:
        """Write the model into a folder, as ``model/`` of a diagnosis.

        Raises:
            InputRefused: the folder holds other files, or cannot be written to.
        """
        save(self.setup, Path(folder), self.substeps, self.inputs)
