"""The noise of an output at the frequencies about which its input is silent."""

from __future__ import annotations

import numpy as np
from scipy.signal import coherence, welch

# Longest stretch that a spectrum is averaged over, and how many of them there are at least, overlaps not counted.
_LONGEST, _STRETCHES = 512, 8
# Samples of a stretch that its window needs.
_SHORTEST = 8
# Coherence from which an output is the input's at a frequency, and the least share of frequencies where it is not.
_HEARD, _LEAST = 0.5, 0.05
# Part of the silent frequencies, from below, whose level is taken.
_NEAREST = 0.2


def silent_deviation(u: np.ndarray, y: np.ndarray) -> float | None:
    """Standard deviation of white noise that has the power of an output where its input does not cause it.

        γ² = |S_uy|² / (S_uu S_yy) < ½

    Of those frequencies the lowest fifth counts. They lie next to what is excited, for it is low frequencies that are;
    towards the highest ones what protects a sensor from aliases takes its noise away too. What a nonlinear system
    sends there is counted as noise.

    Args:
        u: ``(N,)`` input.
        y: ``(N,)`` output.

    Returns:
        In the unit of the output; ``None`` where the input leaves hardly a frequency out, or too few samples tell.
    """
    length = min(_LONGEST, y.size // _STRETCHES)
    if length < _SHORTEST:
        return None
    # This window lets nothing through from far away, where a resonance may be a hundred decibels stronger.
    options = {"window": "blackmanharris", "nperseg": length, "detrend": "linear"}
    density = welch(y, **options)[1][1:-1]
    silent = density[coherence(u, y, **options)[1][1:-1] < _HEARD]
    if silent.size < _LEAST * density.size:
        return None
    nearest = silent[: max(round(_NEAREST * silent.size), 1)]
    # One-sided, at a rate of one sample per second: white noise has twice its variance.
    return float(np.sqrt(0.5 * nearest.mean()))
