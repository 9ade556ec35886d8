"""What the noise of a recording is, before any model is fitted: from what differs between two periods."""

from __future__ import annotations

import numpy as np

from phnn.recordings.excitation import Excitation
from phnn.recordings.recording import Recording
from phnn.signals.noise import quantisation_step
from phnn.signals.noise_statement import NoiseStatement, Sample, noise_statement

# Harmonics of the drive in which periods may differ because the motion has not settled.
_SETTLING = 3
# By how much of a period a recording may miss a whole number of them; harmonics that give the speed.
_WHOLE, _HARMONICS = 0.02, 20


def stated_noise(recording: Recording, excitation: Excitation) -> NoiseStatement:
    """Of one recording; the first period is left out, for it holds a transient."""
    return noise_statement(
        recording.noise, recording.noise_source, recording.units.output, _between_periods(recording, excitation)
    )


def _between_periods(r: Recording, excitation: Excitation) -> Sample | None:
    """Two periods against each other, without what changes slowly; None where there are not two settled ones."""
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
    times = np.arange(y.size) / size
    waves = [
        f(2.0 * np.pi * k * times) for k in range(1, min(_HARMONICS, int(0.4 * size)) + 1) for f in (np.cos, np.sin)
    ]
    design = np.column_stack([np.ones_like(times), *waves])
    smooth = design @ np.linalg.lstsq(design, y, rcond=None)[0]
    speed = np.gradient(smooth, r.dt)
    count = y.size - lag
    changed = y[lag:] - y[:count]
    # Offset, trend, amplitude, what settles, and the fraction of a sample by which the periods miss each other.
    low = waves[: 2 * _SETTLING]
    slow = np.column_stack([np.ones(count), np.arange(count), smooth[:count], *(w[:count] for w in low)])
    if abs(late) > 1e-9:
        slow = np.column_stack([slow, speed[:count], np.gradient(speed, r.dt)[:count]])
    slow = slow / np.linalg.norm(slow, axis=0)
    changed = changed - slow @ np.linalg.lstsq(slow, changed, rcond=None)[0]
    return Sample(
        changed / np.sqrt(2.0), r.dt, speed[:count], quantisation_step(r.y), above=(_SETTLING + 1.5) / r.period
    )
