"""Symptoms of a residual before anything is named: growth, harmonics, phase, repetition, drift.

Every figure comes with the probability that noise alone would give it, noise as the residual shows it
(`phnn.identification.residual_noise`); residuals are in units of the noise. Periods with a transient are
left out: what is still on its way neither repeats nor stays level, whatever the model misses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm
from scipy.stats import t as student

from phnn.diagnosis.seen import LEAST_PERIODS, Seen

Array = NDArray[np.float64]

_BLOCKS = 12
# By how much a noise floor may be wrong: a recording estimates it from a few hundred to a few thousand samples.
_FLOOR_DOUBT = 0.02
# Recordings from which an exponent and its error can be estimated; excess below which there is nothing to grow.
_FEW, _EXCESS = 4, 0.1


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


def symptoms(recordings: Sequence[Seen]) -> Symptoms:
    """All of them."""
    by_amplitude, by_frequency = growth(recordings)
    even, odd = harmonics(recordings)
    delay, explained = phase(recordings)
    repeated, unrepeated = repetition(recordings)
    return Symptoms(
        by_amplitude, by_frequency, even, odd, delay, explained, repeated, unrepeated, drift(recordings)
    )  # fmt: skip


def growth(recordings: Sequence[Seen]) -> tuple[Trend | None, Trend | None]:
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


def _waves(s: Seen, rows: slice, orders: Sequence[int]) -> Array:
    """(N, 2 + 2K) a constant, a slope, and cosine and sine of some harmonics."""
    t = s.dt * np.arange(s.residual.size)[rows]
    columns = [np.ones_like(t), t - t.mean()]
    for k in orders:
        columns += [np.cos(2.0 * np.pi * k * s.frequency * t), np.sin(2.0 * np.pi * k * s.frequency * t)]
    return np.column_stack(columns)


def harmonic_powers(s: Seen) -> dict[int, float]:
    """Power of the residual at the harmonics of a sine; each is χ² of two degrees of freedom where there is noise."""
    rows = s.after_transient()
    count = s.residual[rows].size
    orders = s.orders()
    if s.frequency == 0.0 or count * s.dt * s.frequency < LEAST_PERIODS * 0.99:
        return {}
    w = np.linalg.lstsq(_waves(s, rows, orders), s.residual[rows], rcond=None)[0][2:]
    return {k: 0.5 * count * float(w[2 * i] ** 2 + w[2 * i + 1] ** 2) / s.density(k * s.frequency)
            for i, k in enumerate(orders)}  # fmt: skip


def harmonics(recordings: Sequence[Seen]) -> tuple[Trend | None, Trend | None]:
    """Shares of even and of odd harmonics (the third and up), pooled over the sines."""
    powers = [harmonic_powers(s) for s in recordings]
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


def phase(recordings: Sequence[Seen]) -> tuple[Trend | None, float]:
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


def repetition(recordings: Sequence[Seen]) -> tuple[Trend | None, float]:
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


def drift(recordings: Sequence[Seen]) -> Trend | None:
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
