"""The time-invariant plant that is nearest to the linearised base model: a mass on a damped spring."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.simulate import Trajectory
from studies.benchmark.residual_force.states import responses

Array = NDArray[np.float64]

# Size of the force that probes a model [N]; it cancels, as the model is linearised.
_PROBE = 1e-3


@dataclass(frozen=True)
class Plant:
    """Attributes:
    mass [kg], damping [N s/m], stiffness [N/m]: of the linearised base.
    """

    mass: float
    damping: float
    stiffness: float

    def response(self, frequency: Array) -> NDArray[np.complex128]:
        """Output per force [m/N] at frequencies [Hz]."""
        w = 2.0 * np.pi * np.asarray(frequency)
        return np.asarray(1.0 / (self.stiffness - self.mass * w**2 + 1j * w * self.damping))


def plant_of(trajectory: Trajectory, seed: int = 0) -> Plant:
    """The time-invariant plant that is nearest to the base model linearised along a recording.

    A hysteron is a spring while it sticks and almost no force while it slips. Stiffness and damping are those of least
    error in the balance of forces under a random force of small size; the mass is the base's.
    """
    dt = trajectory.recording.dt
    count = trajectory.recording.t.size + trajectory.lead
    rng, span = np.random.default_rng(seed), np.hanning(count)
    force = _PROBE * span * np.convolve(rng.normal(size=count), np.hanning(9) / 4.0, mode="same")
    y = responses(trajectory, force[:, None])[:, 0]
    acted = force[trajectory.lead :]
    mass, w = trajectory.setup.values()["m"], 2.0 * np.pi * np.fft.rfftfreq(y.size, dt)
    spectrum, wanted = np.fft.rfft(y), np.fft.rfft(acted)
    balance = wanted + mass * w**2 * spectrum
    columns = np.column_stack([spectrum, 1j * w * spectrum])
    both = np.concatenate([columns.real, columns.imag])
    stiffness, damping = np.linalg.lstsq(both, np.concatenate([balance.real, balance.imag]), rcond=None)[0]
    return Plant(mass, max(float(damping), 0.0), float(stiffness))
