"""A subset of a few recordings far apart, in place of many similar ones, for a first evaluation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from phnn.identification.plan import Plan
from phnn.recordings.recording import Recording, dominant_frequency

Array = NDArray[np.float64]

_ENOUGH = 5
# A recording without a frequency counts as this much slower than the slowest that has one.
_SLOWER = 0.1


def representative_subset(plan: Plan) -> Plan:
    """The plan with at most five recordings, spread over amplitude and frequency.

    Beginning with the largest input, each further one is the farthest from those chosen (Gonzalez 1985), in decades of
    the input's range and of its dominant frequency.
    """
    if len(plan.recordings) <= _ENOUGH:
        return plan
    places = _places(plan.recordings)
    chosen = [int(np.argmax(places[:, 0]))]
    while len(chosen) < _ENOUGH:
        apart = np.linalg.norm(places[:, None] - places[chosen], axis=2).min(axis=1)
        apart[chosen] = -1.0
        chosen.append(int(np.argmax(apart)))
    return replace(plan, recordings=tuple(plan.recordings[i] for i in sorted(chosen)))


def _places(recordings: tuple[Recording, ...]) -> Array:
    """(R, 2) decades of the input's range and of its dominant frequency."""
    ranges = np.array([float(np.ptp(r.u)) for r in recordings])
    frequencies = np.array([dominant_frequency(r) for r in recordings])
    known = frequencies[frequencies > 0.0]
    frequencies = np.where(frequencies > 0.0, frequencies, _SLOWER * known.min() if known.size else 1.0)
    return np.log10(np.column_stack([np.maximum(ranges, max(1e-3 * ranges.max(), 1e-300)), frequencies]))
