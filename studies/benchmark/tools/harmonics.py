"""A person's rule of thumb as a tool: look at what the base model leaves, and take the largest entry of a table.

Of each recording in which the residual of the base model exceeds the noise, it looks where most of the excess power
lies: a trend, below the excitation, at the excitation, at even or odd multiples of it, between these, or above all that
is excited. A table gives the effect that a textbook names for it. The rule knows no shape, no second effect, and
states one probability for every name.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phnn.effects import catalogue
from phnn.identification.identified import Identified
from phnn.recordings.excitation import Excitation, excitation_of
from phnn.recordings.recording import Recording
from studies.benchmark.answer import Answer
from studies.benchmark.tools.common import base_of, predictions

Array = NDArray[np.float64]

# Multiples of the excitation above this one are fast.
_FAST = 12
# A residual below this multiple of the noise is noise.
_NOISE = 1.1
# By the band in which most of the excess lies: what a textbook names.
TABLE = {
    "trend": "sensor_drift",
    "slow": "creep",
    "fundamental": "extra_hysteron",
    "even": "hysteresis_asymmetry",
    "odd": "cubic_stiffness",
    "line": "mains_pickup",
    "fast": "second_mode",
}
# Probability of the name, and that nothing is missing where the residual is noise.
_NAME, _NONE = 0.6, 0.8


def answer(folder: Path, seed: int) -> Answer:
    """Identify the base model and look at its residual."""
    base = base_of(folder, seed)
    predicted = predictions(base.model, folder)
    found = [band for band in map(_band, base.fit.plan.recordings, _residuals(base)) if band]
    if not found:
        return Answer({}, none=_NONE, predictions=predicted)
    name = TABLE[Counter(found).most_common(1)[0][0]]
    return Answer({name: _NAME}, places=(catalogue()[name].location,), predictions=predicted)


def _residuals(base: Identified) -> list[Array]:
    """(N,) of each recording, in units of its noise."""
    sizes = [int(np.count_nonzero(r.mask("identification"))) for r in base.fit.plan.recordings]
    return list(np.split(base.fit.residual, np.cumsum(sizes)[:-1]))


def _band(recording: Recording, residual: Array) -> str:
    """The band with most of the excess power; empty where the residual is noise."""
    if np.sqrt(np.mean(residual**2)) < _NOISE:
        return ""
    return max(_powers(recording, residual).items(), key=lambda item: item[1])[0]


def _powers(recording: Recording, residual: Array) -> dict[str, float]:
    """Power above the noise by band; a sum over the lines of a periodogram."""
    n, excitation = residual.size, excitation_of(recording.drive, recording.dt)
    line = np.linspace(-1.0, 1.0, n)
    slope = float(line @ residual / (line @ line))
    left = residual - residual.mean() - slope * line
    power = 2.0 * np.abs(np.fft.rfft(left)) ** 2 / n**2
    frequency, noise = np.asarray(np.fft.rfftfreq(n, recording.dt), dtype=np.float64), 2.0 / n
    found = {"trend": slope**2 / 3.0}
    for name, chosen in _bands(frequency, excitation).items():
        found[name] = float(np.sum(power[chosen] - noise))
    return found


def _bands(frequency: Array, excitation: Excitation) -> dict[str, NDArray[np.bool_]]:
    low, high = excitation.low_Hz, excitation.high_Hz
    found = {"slow": (frequency > 0.0) & (frequency < 0.7 * low)}
    if excitation.kind != "sine" or not low > 0.0:
        return {**found, "fundamental": (frequency >= 0.7 * low) & (frequency <= high), "fast": frequency > high}
    order = frequency / low
    whole = np.rint(order).astype(int)
    near = np.abs(order - whole) < 0.26
    return {
        **found,
        "fundamental": near & (whole == 1),
        "even": near & (whole % 2 == 0) & (whole > 0) & (whole < _FAST),
        "odd": near & (whole % 2 == 1) & (whole > 1) & (whole < _FAST),
        "fast": order > _FAST,
        "line": ~near & (order > 1.0) & (order < _FAST),
    }
