"""Spectrum of a residual against the noise floor, from every scored sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import welch

_SHORTEST = 32


@dataclass(frozen=True)
class Spectrum:
    """Amplitude spectral densities, one-sided; the zero frequency is left out."""

    frequency: np.ndarray  # (K,) Hz
    before: np.ndarray  # (K,) m/√Hz
    after: np.ndarray  # (K,) m/√Hz
    noise: float  # m/√Hz, white noise of the stated standard deviation


def longest_run(mask: np.ndarray) -> slice:
    """The longest stretch of true values (empty where there is none)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask.astype(bool), [False])).astype(np.int8)))
    if edges.size == 0:
        return slice(0, 0)
    first, last = edges[::2], edges[1::2]
    best = int(np.argmax(last - first))
    return slice(int(first[best]), int(last[best]))


def residual_spectrum(
    t: np.ndarray,  # (N,) s
    before: np.ndarray,  # (N,) residual of the base model
    after: np.ndarray,  # (N,) residual of the final model
    usable: np.ndarray,  # (N,) bool
    noise: float,
) -> Spectrum | None:
    """Welch estimate over the longest usable stretch, in segments of a third of it, so that lines stay sharp.

    White noise of standard deviation σ sampled every Δt has the one-sided density ``σ √(2 Δt)``.
    ``None`` where the stretch has fewer than 32 samples.
    """
    part = longest_run(usable & np.isfinite(before) & np.isfinite(after))
    count = part.stop - part.start
    if count < _SHORTEST:
        return None
    step = float(t[part][-1] - t[part][0]) / (count - 1)
    (f, drawn_before), (_, drawn_after) = (amplitude_density(x[part], step) for x in (before, after))
    return Spectrum(f, drawn_before, drawn_after, noise * float(np.sqrt(2.0 * step)))


def amplitude_density(x: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """(K,) frequencies [Hz] without zero, and the one-sided amplitude density, in the unit of ``x`` by √Hz.

    Args:
        x: (N,) samples; dt: sampling interval [s].
    """
    segment = x.size if x.size < 8 * _SHORTEST else x.size // 3
    f, power = welch(x, fs=1.0 / dt, nperseg=segment, detrend="constant")
    return f[1:], np.sqrt(power[1:])
