"""Symptoms of a residual before anything is named: growth, harmonics, phase.

Every figure comes with the probability that noise alone would give it, noise as the residual shows it
(`phnn.identification.residual_noise`); residuals are in units of the noise. Periods with a transient are
left out: what is still on its way has no harmonics, whatever the model misses.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2, norm
from scipy.stats import t as student

from phnn.diagnose.linearised import LinearisedFit
from phnn.identification.residual_noise import NoiseSpectrum, noise_of_others
from phnn.recordings.excitation import excitation_of

Array = NDArray[np.float64]

_HARMONICS = 9
# Recordings from which an exponent and its error can be estimated; excess below which there is nothing to grow; range
# of a logarithm below which nothing was varied.
_FEW, _EXCESS, _VARIED = 4, 0.1, 0.05
# Periods that are left out at the start, during the transient, if enough others remain; by how much of a
# period a recording may miss a whole number of them.
_SETTLING, _LEAST_PERIODS, _WHOLE = 1, 2, 0.02


@dataclass(frozen=True, eq=False)
class RecordingResidual:
    """One recording with the residual of the base model.

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

    def densities(self, frequencies: ArrayLike) -> Array:
        """Return the spectrum of the noise over that of white noise, at frequencies [Hz]."""
        cycles = np.asarray(frequencies, dtype=np.float64) * self.dt
        return np.ones_like(cycles) if self.spectrum is None else self.spectrum.at(cycles)

    def waves(self, rows: slice, orders: Sequence[int]) -> Array:
        """Return (N, 2 + 2K) a constant, a slope, and cosine and sine of some harmonics."""
        t = self.dt * np.arange(self.residual.size)[rows]
        turns = [2.0 * np.pi * k * self.frequency * t for k in orders]
        return np.column_stack([np.ones_like(t), t - t.mean(), *(f(x) for x in turns for f in (np.cos, np.sin))])

    def orders(self) -> list[int]:
        """Return the harmonics of a sine that the sampling shows; none of any other input."""
        return [k for k in range(1, _HARMONICS + 1) if 0.0 < k * self.frequency * self.dt < 0.4]

    def after_transient(self) -> slice:
        """Return the samples of a sine after the first period, or all where few periods were recorded."""
        if (
            self.frequency == 0.0
            or self.periodic_start
            or int(self.residual.size * self.frequency * self.dt + _WHOLE) < _SETTLING + _LEAST_PERIODS
        ):
            return slice(None)
        return slice(round(_SETTLING / (self.frequency * self.dt)), None)


def recording_residuals(linearised: LinearisedFit) -> list[RecordingResidual]:
    """Return the residuals of the identification recordings of a linearised fit."""
    residuals = []
    spectra = noise_of_others([linearised.residual[rows] for rows in linearised.slices], linearised.plan.recordings)
    for trajectory, rows, spectrum in zip(linearised.trajectories, linearised.slices, spectra, strict=True):
        r = trajectory.recording
        mask, drive = r.mask("identification"), excitation_of(r.u, r.dt)
        y, model = r.y[mask], trajectory.y[mask]
        residuals.append(
            RecordingResidual(
                r.dt, linearised.fit.residual[rows], y - y.mean(), model - model.mean(),
                drive.low_Hz if drive.kind == "sine" else 0.0, drive.amplitude, spectrum, r.noise,
                r.start.state == "periodic" and bool(mask[0]),
            )
        )  # fmt: skip
    return residuals


class Trend(NamedTuple):
    """An estimate with its standard error, the probability of one as far from zero by chance, and for a delay the share
    of the phases that it explains."""

    value: float
    std: float
    p_value: float
    share: float = 0.0


# By name, those that the recordings can show:
# by_amplitude, by_frequency: exponents of the residual's growth over sines.
# even, odd: share of the power at the harmonics (without the first).
# delay: what the phase of the output against the model asks for [s]; its share is that of the phases.
Symptoms = Mapping[str, Trend]


def symptoms(recordings: Sequence[RecordingResidual]) -> Symptoms:
    """Return all symptoms of the residuals of some recordings."""
    parts = (_growth, _harmonics, _phase)
    return {name: trend for part in parts for name, trend in part(recordings)}


def _growth(recordings: Sequence[RecordingResidual]) -> Iterator[tuple[str, Trend]]:
    """Yield exponents ``n, m`` of ``√(r̄² − 1) ∝ Aⁿ fᵐ`` over the sines, each with the other one free."""
    rows = []
    for s in recordings:
        excess = float(np.mean(s.residual[s.after_transient()] ** 2)) - 1.0
        if s.frequency > 0.0 and excess > _EXCESS:
            rows.append((0.5 * np.log(excess), np.log(s.amplitude), np.log(s.frequency)))
    if len(rows) < _FEW:
        return
    level, *logs = np.array(rows).T
    varied = {n: x for n, x in zip(("by_amplitude", "by_frequency"), logs, strict=True) if np.ptp(x) > _VARIED}
    design = np.column_stack([np.ones_like(level), *varied.values()])
    freedom = level.size - design.shape[1]
    if freedom < 1 or np.linalg.matrix_rank(design) < design.shape[1]:
        return
    weights = np.linalg.lstsq(design, level, rcond=None)[0]
    spread = float(np.sum((level - design @ weights) ** 2)) / freedom
    stds = np.sqrt(np.diag(np.linalg.inv(design.T @ design)) * spread)
    for name, w, std in zip(varied, weights[1:].tolist(), stds[1:].tolist(), strict=True):
        yield name, Trend(w, std, float(2.0 * student.sf(abs(w) / max(std, 1e-12), freedom)))


def _harmonics(recordings: Sequence[RecordingResidual]) -> Iterator[tuple[str, Trend]]:
    """Yield shares of even and of odd harmonics (the third and up), pooled over the sines.

    The power at a harmonic is χ² of two degrees of freedom where there is noise.
    """
    powers: list[list[float]] = [[], []]
    for s in recordings:
        rows, orders = s.after_transient(), s.orders()
        r = s.residual[rows]
        if s.frequency == 0.0 or r.size * s.dt * s.frequency < _LEAST_PERIODS * 0.99:
            continue
        pairs = np.linalg.lstsq(s.waves(rows, orders), r, rcond=None)[0][2:].reshape(-1, 2)
        densities = s.densities(s.frequency * np.array(orders))
        for k, power in zip(orders, 0.5 * r.size * np.sum(pairs**2, axis=1) / densities, strict=True):
            if k > 1:
                powers[k % 2].append(float(power))
    total = sum(max(sum(own) - 2 * len(own), 0.0) for own in powers)
    for name, own in zip(("even", "odd"), powers, strict=True):
        if own:
            power, freedom = sum(own), 2 * len(own)
            share = max(power - freedom, 0.0) / total if total > 0.0 else 0.0
            yield name, Trend(share, np.sqrt(2.0 * freedom) / max(total, 1e-300), float(chi2.sf(power, freedom)))


def _phase(recordings: Sequence[RecordingResidual]) -> Iterator[tuple[str, Trend]]:
    """Yield the delay ``τ`` of ``arg(Y/Ŷ) = −2π f τ`` over the sines."""
    rows = []
    for s in (s for s in recordings if s.frequency > 0.0):
        inside = s.after_transient()
        waves = s.waves(inside, (1,))
        y, model = (np.linalg.lstsq(waves, x[inside], rcond=None)[0][2:] for x in (s.measured, s.model))
        ratio = complex(y[0], -y[1]) / complex(model[0], -model[1])
        std = s.noise * np.sqrt(2.0 * s.densities(s.frequency) / waves.shape[0]) / float(np.hypot(*model))
        rows.append((-2.0 * np.pi * s.frequency / std, np.angle(ratio) / std, s.frequency))
    if len(rows) < 2 or np.ptp([r[2] for r in rows]) == 0.0:
        return
    slope, angle, _ = np.array(rows).T
    tau, std = float(slope @ angle / (slope @ slope)), float(1.0 / np.linalg.norm(slope))
    rest = angle - tau * slope
    yield "delay", Trend(tau, std, float(2.0 * norm.sf(abs(tau) / std)), 1.0 - float(rest @ rest / (angle @ angle)))


def significant(every: Symptoms, level: float) -> Symptoms:
    """Return the symptoms that are significant after correction for their number.

    Holm's (1979) step-down: the k-th smallest of n p-values has to lie below ``level/(n − k + 1)``. One false sentence
    misleads as much as five do, and the symptoms depend on each other: it bounds the chance of any, whatever their
    dependence. The harmonics come in pairs, of which one alone may be nothing: both stay if either is significant.
    """
    kept: set[str] = set()
    for rank, name in enumerate(sorted(every, key=lambda n: every[n].p_value)):
        if every[name].p_value * (len(every) - rank) >= level:
            break
        kept.add(name)
    if kept & {"even", "odd"}:
        kept |= {"even", "odd"}
    return {n: t for n, t in every.items() if n in kept}
