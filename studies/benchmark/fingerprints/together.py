"""Features of all residuals together: dependence on the signals, on amplitude and on frequency."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]

_TIMES = (0.03, 0.3)  # s, of low-passed displacements
_REGRESSORS = (
    "time", "time_y", "u2", "u3", "abs_u", "y2", "y3", "sign_v", "v2", "v_abs_v", "abs_v", "y_v", "y2_v", "y_a", "u_y2",
    *(f"slow_{i}" for i in range(len(_TIMES))), *(f"slow_y2_{i}" for i in range(len(_TIMES))),
)  # fmt: skip
_OWN = (
    "level", "floor", "colour", "heavy", "count", "peak", "by_amplitude", "by_frequency", "line_Hz", "line", "slope",
    "slope_alike",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Signals:
    """Attributes:
    t, u, y, left: (N,) time [s], drive, modelled displacement [m], residual [m].
    sigma: deviation of the noise, m.
    frequency: of the drive, Hz; NaN where it has no single one.
    """

    t: Array
    u: Array
    y: Array
    left: Array
    sigma: float
    frequency: float

    @property
    def dt(self) -> float:
        """Sampling interval, s."""
        return float(self.t[-1] - self.t[0]) / (self.t.size - 1)


def names() -> list[str]:
    """Names of the features, in their order."""
    return [*_OWN, *(f"with_{name}" for name in _REGRESSORS)]


def together(signals: Sequence[Signals]) -> dict[str, float]:
    """The features of all recordings together."""
    weighted = np.concatenate([s.left / s.sigma for s in signals])
    values = {"level": 0.5 * math.log(float(np.mean(weighted**2))), "count": float(len(signals))}
    values["peak"] = math.log(float(np.max(np.abs(weighted))))
    values |= _noise(signals) | _dependence(signals) | _lines(signals) | _slopes(signals) | _correlations(signals)
    return {name: values[name] for name in names()}


def _noise(signals: Sequence[Signals]) -> dict[str, float]:
    """Third differences leave noise alone: its size over what is stated, its colour, the weight of its tails.

    Quantiles, as jumps of the drive leave a few large differences.
    """
    fast = [np.diff(s.left / s.sigma, 3) / math.sqrt(20.0) for s in signals]
    size = np.abs(np.concatenate(fast))
    middle, high = (float(x) for x in np.quantile(size, (0.5, 0.995)))
    cut = [np.clip(f, -high, high) for f in fast]
    lagged = float(np.mean(np.concatenate([f[1:] * f[:-1] for f in cut])))
    power = float(np.mean(np.concatenate(cut) ** 2))
    # Half of all normal numbers are below 0.6745 deviations.
    return {
        "floor": math.log(middle / 0.6745) if middle > 0.0 else math.nan,
        "colour": lagged / power if power > 0.0 else math.nan,
        "heavy": math.log(high / middle) if middle > 0.0 else math.nan,
    }


def _dependence(signals: Sequence[Signals]) -> dict[str, float]:
    """Exponents p, q of a residual that grows as amplitudeᵖ frequency^q among the sines; NaN for fewer than three."""
    sines = [s for s in signals if np.isfinite(s.frequency)]
    if len(sines) < 3:
        return {"by_amplitude": math.nan, "by_frequency": math.nan}
    size = np.array([0.5 * math.log(float(np.mean((s.left - s.left.mean()) ** 2)) / s.sigma**2) for s in sines])
    columns = np.array([[1.0, math.log(float(np.ptp(s.u))), math.log(s.frequency)] for s in sines])
    found = np.linalg.lstsq(columns, size, rcond=None)[0]
    return {"by_amplitude": float(found[1]), "by_frequency": float(found[2])}


def _lines(signals: Sequence[Signals]) -> dict[str, float]:
    """The frequency at which all recordings have a line: the largest mean logarithm of their relative spectra."""
    grid, sums, counts = np.geomspace(3.0, 400.0, 300), np.zeros(300), np.zeros(300)
    for s in signals:
        left = (s.left - s.left.mean()) * np.hanning(s.left.size)
        power = np.abs(np.fft.rfft(left, 4 * left.size)) ** 2
        frequency = np.fft.rfftfreq(4 * left.size, s.dt)
        seen = (grid > 2.0 / (s.t[-1] - s.t[0])) & (grid < 0.4 / s.dt)
        if np.isfinite(s.frequency):
            order = grid / s.frequency
            seen &= np.abs(order - np.rint(order)) > 0.2
        background = np.interp(grid, frequency, np.sqrt(np.convolve(power, np.ones(301) / 301.0, "same")))
        sums[seen] += (
            np.log(np.interp(grid, frequency, np.sqrt(power)) + 1e-30)[seen] - np.log(background + 1e-30)[seen]
        )
        counts[seen] += 1.0
    mean = np.where(counts > 0.0, sums / np.maximum(counts, 1.0), -np.inf)
    top = int(np.argmax(mean))
    found = bool(np.isfinite(mean[top]))
    return {"line_Hz": float(grid[top]) if found else math.nan, "line": float(mean[top]) if found else math.nan}


def _slopes(signals: Sequence[Signals]) -> dict[str, float]:
    """The mean rate of drift over its size in each recording, and how alike the rates are."""
    rates, weights = [], []
    for s in signals:
        t = s.t - s.t.mean()
        rates.append(float(t @ s.left) / float(t @ t))
        weights.append(float(t @ t) / s.sigma**2)
    mean, size = float(np.average(rates, weights=weights)), float(np.average(np.square(rates), weights=weights)) ** 0.5
    return {
        "slope": math.asinh(mean * sum(weights) ** 0.5),
        "slope_alike": abs(mean) / size if size > 0.0 else math.nan,
    }


def _correlations(signals: Sequence[Signals]) -> dict[str, float]:
    """Correlation with functions of the signals, after 1, u, y, v and a have been taken off in each recording."""
    reach = max(float(np.max(np.abs(s.y))) for s in signals)
    drive = max(float(np.max(np.abs(s.u))) for s in signals)
    fastest = max(float(np.sqrt(np.mean(np.gradient(s.y, s.dt) ** 2))) for s in signals)
    products, squares, power = np.zeros(len(_REGRESSORS)), np.zeros(len(_REGRESSORS)), 0.0
    for s in signals:
        u, y, v = s.u / drive, s.y / reach, np.gradient(s.y, s.dt) / fastest
        a = np.gradient(v, s.dt)
        known, _ = np.linalg.qr(np.column_stack([np.ones_like(u), u, y, v, a]))
        tried = _regressors(s, u, y, v, a)
        left = s.left / s.sigma
        tried, left = tried - known @ (known.T @ tried), left - known @ (known.T @ left)
        products += tried.T @ left
        squares += np.sum(tried**2, axis=0)
        power += float(left @ left)
    found = products / np.sqrt(np.maximum(squares * power, 1e-300))
    return {f"with_{name}": float(x) for name, x in zip(_REGRESSORS, found, strict=True)}


def _regressors(s: Signals, u: Array, y: Array, v: Array, a: Array) -> Array:
    """(N, K) in the order of `_REGRESSORS`."""
    shares = [1.0 - math.exp(-s.dt / tau) for tau in _TIMES]
    slow = [lfilter([k], [1.0, k - 1.0], y) for k in shares]
    curved = [lfilter([k], [1.0, k - 1.0], y**2) for k in shares]
    a = a / (float(np.max(np.abs(a))) or 1.0)
    return np.column_stack(
        [
            s.t, s.t * y, u**2, u**3, np.abs(u), y**2, y**3, np.tanh(20.0 * v), v**2, v * np.abs(v), np.abs(v), y * v,
            y**2 * v, y * a, u * y**2, *slow, *curved,
        ]
    )  # fmt: skip
