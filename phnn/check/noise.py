"""The noise of a recording before any model is fitted, from the difference between two periods."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phnn.recordings.excitation import Excitation
from phnn.recordings.recording import Recording
from phnn.signals.least_squares import residual
from phnn.signals.noise_statement import NoiseStatement, Sample, noise_statement
from phnn.signals.quantisation import quantisation_step

Array = NDArray[np.float64]

# Harmonics of the drive in which periods may differ because of the transient.
_SETTLING = 3
# By how much of a period a recording may miss a whole number of them; harmonics that give the speed.
_WHOLE, _HARMONICS = 0.02, 20


def stated_noise(recording: Recording, excitation: Excitation) -> NoiseStatement:
    """Of one recording; the first period is left out, for it holds a transient."""
    return noise_statement(
        recording.noise, recording.noise_source, recording.units.output, _between_periods(recording, excitation)
    )


def _between_periods(r: Recording, excitation: Excitation) -> Sample | None:
    """Two periods against each other, without what changes slowly; None without two periodic ones."""
    if r.period is None or not np.isfinite(r.noise):
        return None
    first, last = excitation.span
    size = r.period / r.dt
    skip = 0 if r.start.state == "periodic" else 1
    whole = int((last - first) / size + _WHOLE) - skip
    if whole < 2:
        return None
    start, lag = first + round(skip * size), round(whole // 2 * size)
    late = whole // 2 * size - lag
    y = r.y[start : min(last, r.y.size)]
    harmonics = min(_HARMONICS, int(0.4 * size))
    smooth = y - residual(y, lambda rows: _waves(rows, size, harmonics))
    speed = np.gradient(smooth, r.dt)
    count = y.size - lag
    # Offset, trend, amplitude, what settles, and the fraction of a sample by which the periods miss each other.
    shapes = [np.arange(float(count)), smooth[:count]]
    if abs(late) > 1e-9:
        shapes += [speed[:count], np.gradient(speed, r.dt)[:count]]
    slow = [shape / np.sqrt(np.mean(shape**2)) for shape in shapes]
    changed = residual(
        y[lag:] - y[:count],
        lambda rows: np.column_stack([*(shape[rows] for shape in slow), _waves(rows, size, min(_SETTLING, harmonics))]),
    )
    return Sample(
        changed / np.sqrt(2.0), r.dt, speed[:count], quantisation_step(r.y), above=(_SETTLING + 1.5) / r.period
    )


def _waves(rows: slice, size: float, harmonics: int) -> Array:
    """(n, 1 + 2 K) a constant, cosines and sines of the first harmonics of ``size`` samples, at some samples."""
    phase = 2.0 * np.pi / size * np.outer(np.arange(rows.start, rows.stop), np.arange(1, harmonics + 1))
    return np.column_stack([np.ones(phase.shape[0]), np.cos(phase), np.sin(phase)])
