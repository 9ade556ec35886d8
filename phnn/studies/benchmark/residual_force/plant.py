"""The residual force as a function of time: what a recording lacks, divided by the response of the linearised base.

    F̂(ω) = W(ω) R(ω) / G(ω),   W = max(0, 1 − S_n/S_r),   G = 1/(k − m ω² + i ω d)

``R`` is the residual of the base, ``S_r`` its power and ``S_n`` that of the noise. ``W`` is Wiener's filter with the
power of the signal estimated by what exceeds the noise (Wiener 1949, Extrapolation, Interpolation, and Smoothing of
Stationary Time Series): where noise dominates, no force is claimed. The band is that in which ``W`` is at least a half.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from phnn.errors import InputRefused
from phnn.simulate import Trajectory
from phnn.studies.benchmark.residual_force.states import responses

Array = NDArray[np.float64]

# Lines over which the power of a residual is averaged, and by how much it has to exceed the noise, whose average over
# so many lines scatters.
_SMOOTH, _EXCEEDS = 9, 1.5
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


@dataclass(frozen=True)
class Deconvolved:
    """Attributes:
    force: (N,) [N]; weight: (F,) ``W`` at ``frequency`` (F,) [Hz].
    """

    force: Array
    weight: Array
    frequency: Array

    @property
    def band(self) -> tuple[float, float]:
        """Lowest and highest frequency [Hz] with a weight of a half or more; NaN where there is none."""
        inside = self.frequency[self.weight >= 0.5]
        return (float(inside[0]), float(inside[-1])) if inside.size else (np.nan, np.nan)


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


def deconvolved(
    residual: Array, dt: float, plant: Plant, noise: float, correlation: Array | None = None
) -> Deconvolved:
    """The force that closes the gap between a recording and the base model.

    The residual is continued by its point reflections at both ends, so that it has neither a jump nor a kink there.

    Args:
        residual: (N,) recorded minus simulated output [m]; dt: interval [s].
        noise: deviation of the noise [m]; correlation: (K,) of the noise at lags 0 … K − 1, white where not given.

    Raises:
        InputRefused: fewer than 16 samples, numbers that are not finite, noise or interval that are not positive.
    """
    if residual.size < 16 or not np.isfinite(residual).all():
        raise InputRefused(
            f"residual: {residual.size} samples, all finite and 16 at least are needed: give a longer one"
        )
    if not (noise > 0.0 and dt > 0.0):
        raise InputRefused(f"noise = {noise} m, interval = {dt} s: give positive numbers")
    longer = np.concatenate([residual, 2.0 * residual[-1] - residual[-2:0:-1]])
    slope = (residual[-1] - residual[0]) * np.concatenate(
        [np.linspace(0.0, 2.0, 2 * residual.size - 1)[:-1]]
    )  # fmt: skip
    periodic = longer - slope
    spectrum, frequency = np.fft.rfft(periodic), np.asarray(np.fft.rfftfreq(periodic.size, dt), dtype=np.float64)
    power = uniform_filter1d(np.abs(spectrum) ** 2 / periodic.size, _SMOOTH, mode="nearest")
    floor = noise**2 * _shape(correlation, frequency * dt)
    weight = np.maximum(0.0, 1.0 - _EXCEEDS * floor / np.maximum(power, 1e-300))
    force = np.fft.irfft(weight * spectrum / plant.response(frequency), periodic.size)[: residual.size]
    # What was taken off is slow: a constant rate under stiffness and damping.
    rate = (residual[-1] - residual[0]) / (dt * (residual.size - 1))
    slow = plant.stiffness * slope[: residual.size] + plant.damping * rate
    return Deconvolved(force + slow, weight, frequency)


def _shape(correlation: Array | None, turns: Array) -> Array:
    """Power of the noise by frequency [1/sample] over its mean."""
    if correlation is None or correlation.size < 2:
        return np.ones(turns.size)
    lags = np.arange(1, correlation.size)
    # Tapered as Bartlett does, so that no power is negative.
    taper = correlation[1:] * (1.0 - lags / correlation.size)
    return np.maximum(1.0 + 2.0 * np.cos(2.0 * np.pi * np.outer(turns, lags)) @ taper, 1e-3)
