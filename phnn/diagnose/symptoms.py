"""Symptoms of a residual before anything is named: growth, harmonics, phase, repetition, drift.

Every figure comes with the probability that noise alone would give it, noise as the residual shows it
(`phnn.identification.residual_noise`); residuals are in units of the noise. Periods with a transient are
left out: what is still on its way neither repeats nor stays level, whatever the model misses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm
from scipy.stats import t as student

from phnn.diagnose.linearised import LinearisedFit
from phnn.identification.residual_noise import NoiseSpectrum, noise_of_others
from phnn.recordings.excitation import excitation_of

Array = NDArray[np.float64]

_HARMONICS = 9
_BLOCKS = 12
# By how much a noise floor may be wrong: a recording estimates it from a few hundred to a few thousand samples.
_FLOOR_DOUBT = 0.02
# Recordings from which an exponent and its error can be estimated; excess below which there is nothing to grow.
_FEW, _EXCESS = 4, 0.1
# The symptoms that are tested.
_TRENDS = ("by_amplitude", "by_frequency", "even", "odd", "delay", "repetition", "drift")
# Periods that are left out at the start, during the transient, if enough others remain; by how much of a
# period a recording may miss a whole number of them.
_SETTLING, _LEAST_PERIODS, _WHOLE = 1, 2, 0.02
# Share of a transient that a base model may miss: while the model changes from period to period by so much that this
# share exceeds the noise, the motion is not yet periodic.
_MISSED = 0.1


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

    def density(self, frequency: float) -> float:
        """Return the spectrum of the noise over that of white noise."""
        return float(self.densities(np.array([frequency * self.dt]))[0])

    def densities(self, cycles: Array) -> Array:
        """Return the same at frequencies in cycles a sample."""
        return np.ones_like(cycles) if self.spectrum is None else self.spectrum.at(cycles)

    def orders(self) -> list[int]:
        """Return the harmonics of a sine that the sampling shows; none of any other input."""
        return [k for k in range(1, _HARMONICS + 1) if 0.0 < k * self.frequency * self.dt < 0.4]

    def after_transient(self) -> slice:
        """Return the samples of a sine after the first period, or all where few periods were recorded."""
        if self.frequency == 0.0 or self.periodic_start:
            return slice(None)
        enough = self._periods() >= _SETTLING + _LEAST_PERIODS
        return slice(round(_SETTLING / (self.frequency * self.dt)) if enough else 0, None)

    def steady(self) -> slice | None:
        """Return the samples of a sine from where the model repeats itself, without the first period; None where
        fewer than two periods are left, and of any other input: its answer is not told from a drift."""
        if self.frequency == 0.0:
            return slice(None) if self.amplitude == 0.0 else None
        period, first = 1.0 / (self.frequency * self.dt), 0 if self.periodic_start else _SETTLING
        whole = self._periods()
        while not self.periodic_start and first < whole and self._still_moves(first, period):
            first += 1
        return slice(round(first * period), None) if whole - first >= _LEAST_PERIODS else None

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


def recording_residuals(linearised: LinearisedFit) -> list[RecordingResidual]:
    """Return the residuals of the identification recordings of a linearised fit."""
    found = []
    spectra = noise_of_others([linearised.residual[rows] for rows in linearised.slices], linearised.plan.recordings)
    for trajectory, rows, spectrum in zip(linearised.trajectories, linearised.slices, spectra, strict=True):
        r = trajectory.recording
        mask = r.mask("identification")
        drive = excitation_of(r.u, r.dt)
        frequency = drive.low_Hz if drive.kind == "sine" else 0.0
        y, model = r.y[mask], trajectory.y[mask]
        found.append(
            RecordingResidual(
                r.dt, linearised.fit.residual[rows], y - y.mean(), model - model.mean(), frequency, drive.amplitude,
                spectrum, r.noise, r.start.state == "periodic" and bool(mask[0]),
            )
        )  # fmt: skip
    return found


@dataclass(frozen=True)
class Trend:
    """An estimate with its standard error and the probability of one as far from zero by chance."""

    value: float
    std: float
    p_value: float


@dataclass(frozen=True)
class Symptoms:
    """What was found; None where the recordings cannot show it.

    Attributes:
        by_amplitude, by_frequency: exponents of the residual's growth over sines.
        even, odd: share of the power at the harmonics (without the first) and its p-value.
        delay: what the phase of the output against the model asks for [s]; explained: share of the phases it explains.
        repetition: root mean square of period-to-period differences over what noise gives; its p-value is one-sided.
        unrepeated: share of what is unexplained in those periods that does not repeat.
        drift: mean rate of the residual [m/s].
    """

    by_amplitude: Trend | None
    by_frequency: Trend | None
    even: Trend | None
    odd: Trend | None
    delay: Trend | None
    explained: float
    repetition: Trend | None
    unrepeated: float
    drift: Trend | None


def symptoms(recordings: Sequence[RecordingResidual]) -> Symptoms:
    """Return all symptoms of the residuals of some recordings."""
    return Symptoms(
        *_growth(recordings), *_harmonics(recordings), *_phase(recordings), *_repetition(recordings), _drift(recordings)
    )


def _growth(recordings: Sequence[RecordingResidual]) -> tuple[Trend | None, Trend | None]:
    """Exponents ``n, m`` of ``√(r̄² − 1) ∝ Aⁿ fᵐ`` over the sines, each with the other one free."""
    rows = []
    for s in recordings:
        excess = float(np.mean(s.residual[s.after_transient()] ** 2)) - 1.0
        if s.frequency > 0.0 and excess > _EXCESS:
            rows.append((0.5 * np.log(excess), np.log(s.amplitude), np.log(s.frequency)))
    if len(rows) < _FEW:
        return None, None
    level, *logs = np.array(rows).T
    varied = [x for x in logs if np.ptp(x) > 0.05]
    design = np.column_stack([np.ones_like(level), *varied])
    freedom = level.size - design.shape[1]
    if freedom < 1 or np.linalg.matrix_rank(design) < design.shape[1]:
        return None, None
    weights = np.linalg.lstsq(design, level, rcond=None)[0]
    spread = float(np.sum((level - design @ weights) ** 2)) / freedom
    std = np.sqrt(np.diag(np.linalg.inv(design.T @ design)) * spread)
    trends = iter(
        Trend(float(w), float(s), float(2.0 * student.sf(abs(w) / max(s, 1e-12), freedom)))
        for w, s in zip(weights[1:], std[1:], strict=True)
    )
    first, second = (next(trends) if np.ptp(x) > 0.05 else None for x in logs)
    return first, second


def _waves(s: RecordingResidual, rows: slice, orders: Sequence[int]) -> Array:
    """(N, 2 + 2K) a constant, a slope, and cosine and sine of some harmonics."""
    t = s.dt * np.arange(s.residual.size)[rows]
    columns = [np.ones_like(t), t - t.mean()]
    for k in orders:
        columns += [np.cos(2.0 * np.pi * k * s.frequency * t), np.sin(2.0 * np.pi * k * s.frequency * t)]
    return np.column_stack(columns)


def _harmonic_powers(s: RecordingResidual) -> dict[int, float]:
    """Power of the residual at the harmonics of a sine; each is χ² of two degrees of freedom where there is noise."""
    rows = s.after_transient()
    count = s.residual[rows].size
    orders = s.orders()
    if s.frequency == 0.0 or count * s.dt * s.frequency < _LEAST_PERIODS * 0.99:
        return {}
    w = np.linalg.lstsq(_waves(s, rows, orders), s.residual[rows], rcond=None)[0][2:]
    return {k: 0.5 * count * float(w[2 * i] ** 2 + w[2 * i + 1] ** 2) / s.density(k * s.frequency)
            for i, k in enumerate(orders)}  # fmt: skip


def _harmonics(recordings: Sequence[RecordingResidual]) -> tuple[Trend | None, Trend | None]:
    """Shares of even and of odd harmonics (the third and up), pooled over the sines."""
    powers = [_harmonic_powers(s) for s in recordings]
    groups = []
    for parity in (0, 1):
        found = [p for each in powers for k, p in each.items() if k > 1 and k % 2 == parity]
        groups.append((sum(found), 2 * len(found)))
    total = sum(max(power - freedom, 0.0) for power, freedom in groups)
    trends = [
        Trend(
            max(power - freedom, 0.0) / total if total > 0.0 else 0.0,
            np.sqrt(2.0 * freedom) / max(total, 1e-300),
            float(chi2.sf(power, freedom)),
        )
        if freedom
        else None
        for power, freedom in groups
    ]
    return trends[0], trends[1]


def _phase(recordings: Sequence[RecordingResidual]) -> tuple[Trend | None, float]:
    """The delay ``τ`` of ``arg(Y/Ŷ) = −2π f τ`` over the sines, and the share of the phases that it explains."""
    rows = []
    for s in (s for s in recordings if s.frequency > 0.0):
        inside = s.after_transient()
        waves = _waves(s, inside, (1,))
        y, model = (np.linalg.lstsq(waves, x[inside], rcond=None)[0][2:] for x in (s.measured, s.model))
        ratio = complex(y[0], -y[1]) / complex(model[0], -model[1])
        std = s.noise * np.sqrt(2.0 * s.density(s.frequency) / waves.shape[0]) / float(np.hypot(*model))
        rows.append((-2.0 * np.pi * s.frequency / std, np.angle(ratio) / std, s.frequency))
    if len(rows) < 2 or np.ptp([r[2] for r in rows]) == 0.0:
        return None, 0.0
    slope, angle, _ = np.array(rows).T
    tau, std = float(slope @ angle / (slope @ slope)), float(1.0 / np.linalg.norm(slope))
    rest = angle - tau * slope
    return Trend(tau, std, float(2.0 * norm.sf(abs(tau) / std))), 1.0 - float(rest @ rest) / float(angle @ angle)


def _repetition(recordings: Sequence[RecordingResidual]) -> tuple[Trend | None, float]:
    """Period-to-period differences of the residual over what noise gives, over sines of two or more periodic periods.

    The doubt about the noise floor counts as few degrees of freedom: however many samples there are, differences that
    exceed the noise by no more than that do not count. Second: the share of the residual's excess over the noise that
    does not repeat.
    """
    squares, expected, excess, samples, spread = 0.0, 0.0, 0.0, 0, 0.0
    for s in (s for s in recordings if s.frequency > 0.0):
        rows = s.steady()
        if rows is None:
            continue
        r = s.residual[rows]
        lag = 1.0 / (s.frequency * s.dt)
        whole, part = int(lag), lag - int(lag)
        later = (1.0 - part) * r[whole:-1] + part * r[whole + 1 :]
        difference = later - r[: later.size]
        if difference.size < _FEW:
            continue
        cycles: Array = np.fft.rfftfreq(r.size)[1:].astype(np.float64)
        turn = np.exp(2j * np.pi * cycles)
        power = s.densities(cycles) * np.abs(turn**whole * (1.0 - part + part * turn) - 1.0) ** 2
        squares += float(difference @ difference)
        expected += difference.size * float(power.mean())
        # The sum of χ² of two degrees of freedom a frequency; samples that are counted twice make it no surer.
        spread += 2.0 * difference.size**2 * float(power @ power) / (2.0 * power.size**2)
        samples += difference.size
        excess += float(np.mean(r**2) - s.densities(cycles).mean()) * difference.size
    if not samples:
        return None, 0.0
    power_ratio = squares / expected
    freedom = 2.0 / (spread / expected**2 + (2.0 * _FLOOR_DOUBT) ** 2)
    share = float(np.clip(0.5 * (squares - expected) / excess, 0.0, 1.0)) if excess > 0.0 else 0.0
    p_value = float(chi2.sf(power_ratio * freedom, freedom))
    return Trend(float(np.sqrt(power_ratio)), float(np.sqrt(0.5 / freedom)), p_value), share


def _drift(recordings: Sequence[RecordingResidual]) -> Trend | None:
    """Mean rate of the residual beside the harmonics [m/s], weighted by the information of each recording.

    Only periodic sines and rests show it: in other recordings a slope may be part of the response to the drive.
    """
    rates, stds = [], []
    for s in recordings:
        rows = s.steady()
        if rows is None:
            continue
        waves = _waves(s, rows, s.orders())
        w = np.linalg.lstsq(waves, s.residual[rows], rcond=None)[0]
        rates.append(w[1] * s.noise)
        # Low frequencies are where a drift competes with the noise, and with what else the model misses.
        slope = waves[:, 1]
        parts = np.array_split(slope * (s.residual[rows] - waves @ w), _BLOCKS)
        missed = float(np.linalg.norm([p.sum() for p in parts])) / float(slope @ slope)
        lowest = 1.0 / (slope.size * s.dt)
        stds.append(s.noise * max(missed, float(np.sqrt(s.density(lowest)) / np.linalg.norm(slope))))
    if not rates:
        return None
    known = 1.0 / np.array(stds) ** 2
    rate, std = float(np.array(rates) @ known / known.sum()), float(1.0 / np.sqrt(known.sum()))
    return Trend(rate, std, float(2.0 * norm.sf(abs(rate) / std)))


def significant(found: Symptoms, level: float) -> Symptoms:
    """Return the symptoms that are significant after correction for their number; the rest becomes None.

    Holm's (1979) step-down: the k-th smallest of n p-values has to lie below ``level/(n − k + 1)``. One false sentence
    misleads as much as five do, and the symptoms depend on each other: it bounds the chance of any, whatever their
    dependence. The harmonics come in pairs, of which one alone may be nothing: both stay if either is significant.
    """
    trends = {n: t for n in _TRENDS if isinstance(t := getattr(found, n), Trend)}
    kept: set[str] = set()
    for rank, name in enumerate(sorted(trends, key=lambda n: trends[n].p_value)):
        if trends[name].p_value * (len(trends) - rank) >= level:
            break
        kept.add(name)
    if kept & {"even", "odd"}:
        kept |= {"even", "odd"}
    dropped: dict[str, Any] = {n: None for n in trends if n not in kept}
    return replace(found, **dropped)
