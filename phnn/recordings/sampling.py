"""A uniform time grid from recorded times."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from phnn.recordings import checks
from phnn.recordings.table import Where

_NEGLIGIBLE = 1e-4  # of the interval: moving a sample by less changes nothing that a sensor could show
_LARGEST_ROUNDING = 0.05  # of the interval


def on_grid(
    t: np.ndarray, unit_factor: float, channels: Mapping[str, np.ndarray], where: Where
) -> tuple[float, dict[str, np.ndarray], str | None]:
    """The sampling interval and the channels on the uniform grid nearest to the recorded times.

    Args:
        t: ``(N,)`` recorded times, s.
        unit_factor: s per unit of the file's time column; tells rounding of printed times from jitter.
        channels: ``(N,)`` SI values by quantity.
        where: for messages.

    Returns:
        the interval in s, the channels (resampled where times were jittered), and a note or ``None``.

    Raises:
        InputRefused: time goes back or stands still, gaps, a change of rate, jitter above 1 % of the interval.
    """
    if _in_pairs(t):
        means = {name: 0.5 * (values[::2] + values[1::2]) for name, values in channels.items()}
        dt, means, note = on_grid(t[::2], unit_factor, means, where)
        pairs = "two rows with every time, least and largest value: their means are taken"
        return dt, means, f"{pairs}; {note}" if note else pairs
    checks.time_advances(t, where)
    checks.interval(float(np.median(np.diff(t))), where)
    checks.no_gaps(t, where)
    k = np.arange(t.size)
    dt, start = (float(c) for c in np.polyfit(k, t - t[0], 1))
    deviation = t - t[0] - (start + dt * k)
    largest = float(np.abs(deviation).max())
    same = dict(channels)
    if largest <= _NEGLIGIBLE * dt:
        return dt, same, None
    resolution = _printed_resolution(t / unit_factor) * unit_factor
    if largest <= min(0.6 * resolution, _LARGEST_ROUNDING * dt):
        return dt, same, f"times are rounded to {resolution:.3g} s; taken as a uniform grid of {dt:.9g} s"
    checks.little_jitter(deviation, dt, where)
    from scipy.interpolate import PchipInterpolator

    # piecewise and free of overshoot: a jump of the input must not ring into its neighbours
    grid = np.clip(start + dt * k, 0.0, t[-1] - t[0])
    moved = {name: PchipInterpolator(t - t[0], values)(grid) for name, values in channels.items()}
    return dt, moved, f"sampling jitters by up to {largest / dt:.2%} of the interval; put on a uniform grid"


def _in_pairs(t: np.ndarray) -> bool:
    """Whether every time stands in two rows, as where an oscilloscope keeps the extremes of every interval."""
    return t.size % 2 == 0 and t.size > 2 and np.array_equal(t[::2], t[1::2]) and bool((np.diff(t[::2]) > 0.0).all())


def _printed_resolution(numbers: np.ndarray) -> float:
    """Place value of the last digit with which the numbers were written; 0 where they use full precision."""
    for digits in range(13):
        scaled = numbers * 10.0**digits
        if np.all(np.abs(scaled - np.round(scaled)) <= 1e-6 + 4.0 * np.spacing(np.abs(scaled))):
            return float(10.0**-digits)
    return 0.0
