"""Recordings as the base model sees them: residual over noise, output, drive, and the samples that are periodic."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.diagnose.linearised import LinearisedFit
from phnn.identification.residual_noise import NoiseSpectrum, noise_of_others
from phnn.recordings.excitation import excitation_of

Array = NDArray[np.float64]

_HARMONICS = 9
# Periods that are left out at the start, during the transient, if enough others remain; by how much of a
# period a recording may miss a whole number of them.
_SETTLING, LEAST_PERIODS, _WHOLE = 1, 2, 0.02
# Share of a transient that a base model may miss: while the model changes from period to period by so much that this
# share exceeds the noise, the motion is not yet periodic.
_MISSED = 0.1


@dataclass(frozen=True, eq=False)
class Seen:
    """One recording as the base model sees it.

    Attributes:
        dt: sampling interval [s].
        residual: (N,) over noise.
        measured, model: (N,) output without its mean [m].
        frequency: of a sine [Hz], 0 for any other input; amplitude: half the input's range.
        spectrum: of the noise in the residual; white of unit variance where None.
        noise: its stated standard deviation [m].
        periodic_start: the recording begins in a steady cycle.
    """

    dt: float
    residual: Array
    measured: Array
    model: Array
    frequency: float
    amplitude: float
    spectrum: NoiseSpectrum | None
    noise: float
    periodic_start: bool = False

    def density(self, frequency: float) -> float:
        """Spectrum of the noise over that of white noise."""
        return float(self.densities(np.array([frequency * self.dt]))[0])

    def densities(self, cycles: Array) -> Array:
        """The same at frequencies in cycles a sample."""
        return np.ones_like(cycles) if self.spectrum is None else self.spectrum.at(cycles)

    def orders(self) -> list[int]:
        """Harmonics of a sine that the sampling shows; none of any other input."""
        return [k for k in range(1, _HARMONICS + 1) if 0.0 < k * self.frequency * self.dt < 0.4]

    def after_transient(self) -> slice:
        """The samples of a sine after the first period, or all where few periods were recorded."""
        if self.frequency == 0.0 or self.periodic_start:
            return slice(None)
        enough = self._periods() >= _SETTLING + LEAST_PERIODS
        return slice(round(_SETTLING / (self.frequency * self.dt)) if enough else 0, None)

    def steady(self) -> slice | None:
        """The samples of a sine from where the model repeats itself, the first period never among them; None where
        fewer than two periods are left, and of any other input: its answer is not told from a drift."""
        if self.frequency == 0.0:
            return slice(None) if self.amplitude == 0.0 else None
        period, first = 1.0 / (self.frequency * self.dt), 0 if self.periodic_start else _SETTLING
        whole = self._periods()
        while not self.periodic_start and first < whole and self._still_moves(first, period):
            first += 1
        return slice(round(first * period), None) if whole - first >= LEAST_PERIODS else None

    def _periods(self) -> int:
        return int(self.residual.size * self.frequency * self.dt + _WHOLE)

    def _still_moves(self, count: int, period: float) -> bool:
        """Whether the model's next period differs from that after it by more than the noise hides."""
        at = np.arange(round(count * period), round((count + 1) * period))
        at = at[at + period <= self.model.size - 1]
        if at.size < 2:
            return False
        change = np.interp(at + period, np.arange(self.model.size), self.model) - self.model[at]
        return _MISSED * float(np.sqrt(np.mean(change**2))) > self.noise


def seen(linearised: LinearisedFit) -> list[Seen]:
    """The identification recordings of a linearised."""
    found = []
    spectra = noise_of_others([linearised.residual[rows] for rows in linearised.slices], linearised.plan.recordings)
    for trajectory, rows, spectrum in zip(linearised.trajectories, linearised.slices, spectra, strict=True):
        r = trajectory.recording
        mask = r.mask("identification")
        drive = excitation_of(r.u, r.dt)
        frequency = drive.low_Hz if drive.kind == "sine" else 0.0
        y, model = r.y[mask], trajectory.y[mask]
        found.append(
            Seen(
                r.dt, linearised.fit.residual[rows], y - y.mean(), model - model.mean(), frequency, drive.amplitude,
                spectrum, r.noise, r.start.state == "periodic" and bool(mask[0]),
            )
        )  # fmt: skip
    return found
