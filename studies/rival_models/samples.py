"""Samples that fit a rival and samples that choose its size, both inside the identification recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.recordings.excitation import excitation_of
from phnn.recordings.recording import Recording, dominant_frequency

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# From so many recordings on a whole one chooses the size: with fewer, the end of each does.
_WHOLE = 3
_END = 0.3


@dataclass(frozen=True)
class Split:
    """Masks (N,) by recording: ``fit`` for the parameters, ``check`` for the size, ``both`` for the last fit."""

    fit: tuple[Mask, ...]
    check: tuple[Mask, ...]

    @property
    def both(self) -> tuple[Mask, ...]:
        """All identification samples."""
        return tuple(f | c for f, c in zip(self.fit, self.check, strict=True))


def split(recordings: Sequence[Recording]) -> Split:
    """Set samples aside: the recording in the middle by frequency where there are three or more, else the last 30 %."""
    masks = [r.mask("identification") for r in recordings]
    if len(recordings) >= _WHOLE:
        order = sorted(range(len(masks)), key=lambda k: (dominant_frequency(recordings[k]), recordings[k].name))
        # The upper of two in the middle: of 1, 50, 100 and 150 Hz that is 100 Hz, as for the trained models.
        aside = order[len(order) // 2]
        none = [np.zeros(m.size, dtype=bool) for m in masks]
        fit = tuple(n if k == aside else m for k, (m, n) in enumerate(zip(masks, none, strict=True)))
        return Split(fit, tuple(m if k == aside else n for k, (m, n) in enumerate(zip(masks, none, strict=True))))
    early, ends = [], []
    for mask in masks:
        places = np.flatnonzero(mask)
        late = np.zeros(mask.size, dtype=bool)
        late[places[round((1.0 - _END) * places.size) :]] = True
        early.append(mask & ~late)
        ends.append(late)
    return Split(tuple(early), tuple(ends))


@dataclass(frozen=True)
class Scales:
    """Typical sizes: input ``u``, output ``y`` (both SI, half ranges) and ``rate``, the highest angular frequency."""

    u: float
    y: float
    rate: float


def scales_of(recordings: Sequence[Recording]) -> Scales:
    """From the identification samples."""
    masks = [r.mask("identification") for r in recordings]
    u = max(float(np.abs(r.u).max()) for r in recordings)
    y = max(0.5 * float(np.ptp(r.y[m])) for r, m in zip(recordings, masks, strict=True))
    return Scales(u or 1.0, y or 1.0, 2.0 * np.pi * highest(recordings))


def highest(recordings: Sequence[Recording]) -> float:
    """The highest frequency [Hz] of any input; that of the strongest line where no band is recognised."""
    bands = [excitation_of(r.u, r.dt).high_Hz for r in recordings]
    return max(b if b > 0.0 else dominant_frequency(r) for b, r in zip(bands, recordings, strict=True))


def over_noise(recordings: Sequence[Recording], outputs: Sequence[Array], masks: Sequence[Mask]) -> float:
    """Root mean square of the residual over noise on masks, each recording's mean residual taken out.

    A recording that is set aside whole has its zero from itself, as the scored ones have it from their first samples.
    """
    total, count = 0.0, 0
    for r, y, mask in zip(recordings, outputs, masks, strict=True):
        if mask.any():
            error = (r.y - y)[mask] / r.noise
            if not np.isfinite(error).all():
                return float("inf")
            total += float(np.sum((error - error.mean()) ** 2))
            count += int(mask.sum())
    return float(np.sqrt(total / count)) if count else float("inf")
