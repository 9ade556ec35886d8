"""Two figures of a model's steady cycle: the area of its hysteresis loop and the harmonics of its output.

    A = ∮ y du     over the last period,        Y_k = (2/nP) ∫ y e^{−ikωt} dt     over the last n whole periods

Both are linear in the displacement, ``A = w·y``, so that a model's error is that of the difference ``ŷ − y`` and the
sensor's noise goes through with the standard deviation ``σ √(Σ_ij w_i w_j r_{i−j})``, ``r`` its autocorrelation. A
displacement zero drops out of either.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.recordings.excitation import active_span
from phnn.recordings.recording import Part, Recording
from phnn.signals.harmonics import HARMONICS, deviation, harmonic_weights

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CycleErrors:
    """Attributes:
    area: relative error ``(Â − A)/|A|`` of the signed loop area; area_noise: its standard deviation by the noise.
    harmonics: ``|Ŷ_k − Y_k|`` for k = 1…5, m; harmonic_noise: root mean square of each by the noise, m.
    """

    area: float
    area_noise: float
    harmonics: tuple[float, ...]
    harmonic_noise: float


def cycle_errors(recording: Recording, part: Part, model: Array) -> CycleErrors | None:
    """The errors of a model on one part of a recording; None where its input does not repeat within it.

    Args:
        recording: what was measured.
        part: the samples that count. The first period of a recording is left out where there is another one: a start
            from rest is no cycle yet.
        model: (N,) output of the model at all samples, m.
    """
    if recording.period is None:
        return None
    begin, end = active_span(recording.u)
    first, last = max(part.first, begin), min(part.last, end)
    per_period = recording.period / recording.dt
    # A recording of n periods that ends one sample before it would begin again has n of them.
    whole = min(_periods(last - first, per_period), max(1, _periods(last - begin, per_period) - 1))
    if whole < 1 or last - first <= per_period or per_period < 2 * HARMONICS + 2:
        return None
    error = model - recording.y
    rows = slice(first, last)
    loop, area = _loop(recording, rows)
    rows_whole = slice(last - round(whole * per_period), last)
    waves = harmonic_weights(recording.t[rows_whole], recording.period)
    return CycleErrors(
        area=float(loop @ error[rows]) / abs(area),
        area_noise=recording.noise * deviation(loop, recording.noise_correlation) / abs(area),
        harmonics=tuple(np.abs(waves @ error[rows_whole]).tolist()),
        harmonic_noise=recording.noise * deviation(waves[0], recording.noise_correlation),
    )


def _periods(samples: int, per_period: float) -> int:
    """Whole periods in a number of samples."""
    return int(samples / per_period + 1e-6)


def _loop(recording: Recording, rows: slice) -> tuple[Array, float]:
    """Weights of a loop's area, and the area; infinite where there is no loop, so that no error is relative to it."""
    assert recording.period is not None
    weights = area_weights(recording.t[rows], recording.u[rows], recording.period)
    area = float(weights @ recording.y[rows])
    return weights, area if area else np.inf


def area_weights(t: Array, u: Array, period: float) -> Array:
    """(N,) weights of the samples in ``∮ y du`` over the last period, by the trapezoidal rule.

    Args:
        t: (N,) times, s; u: (N,) input; period: s, at most as long as the times span.
    """
    weights = np.zeros(t.size)
    begin = t[-1] - period
    inside = int(np.searchsorted(t, begin, side="right"))
    # The period begins between two samples, at a value of the output that lies between theirs.
    before = max(inside - 1, 0)
    share = (begin - t[before]) / (t[inside] - t[before]) if inside > before else 0.0
    # The input closes the loop exactly, so that a displacement zero drops out.
    du = np.diff(np.concatenate([[u[-1]], u[inside:]]))
    weights[inside:] = 0.5 * du
    weights[inside:-1] += 0.5 * du[1:]
    weights[before] += 0.5 * du[0] * (1.0 - share)
    weights[inside] += 0.5 * du[0] * share
    return weights
