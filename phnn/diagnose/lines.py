"""The score of lines: a subspace instead of a direction, because their phases are not known.

With an orthonormal basis ``Q`` of the lines of all recordings, base and nuisances projected out, ``‖Qᵀr‖²`` over the
mean noise power along ``Q`` is χ² with as many degrees of freedom as columns, where nothing is missing. The standard
normal deviate of the same tail probability makes it comparable to the score of a direction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.special import ndtri_exp
from scipy.stats import chi2

from phnn.diagnose.ground import Ground, direction
from phnn.effects import Effect
from phnn.identify.nuisances import line_columns
from phnn.recordings.recording import Recording

Array = NDArray[np.float64]

_RANK = 1e-9
# Zero padding of the spectra that are searched; how many periods a recording must have to show a line.
_PADDING, _PERIODS = 8, 2.0


@dataclass(frozen=True)
class LineCandidate:
    """An effect that shows as lines: its parameter values, and how far the lines stand out, as a normal deviate."""

    effect: Effect
    values: dict[str, float]
    deviate: float


def line_candidates(
    ground: Ground, effects: Sequence[Effect], colour: Callable[[Array], Array]
) -> list[LineCandidate]:  # fmt: skip
    """Those of the effects that show as lines, with their scores.

    Args:
        colour: multiplication by the correlation matrix of the noise.
    """
    found = []
    for effect in effects:
        points = effect.grid(ground.scales)
        if effect.searched is not None:
            found.append(_searched(ground, effect, effect.searched, points))
        elif effect.add_to(ground.fit.setup, points[0]).lines != ground.fit.setup.lines:
            found.append(_known(ground, effect, points, colour))
    return found


def _known(
    ground: Ground, effect: Effect, points: Sequence[dict[str, float]], colour: Callable[[Array], Array]
) -> LineCandidate:  # fmt: skip
    """The best of a few given frequencies."""
    deviates = [line_score(ground, effect.add_to(ground.fit.setup, v).lines, colour) for v in points]
    best = int(np.argmax(deviates))
    return LineCandidate(effect, dict(points[best]), deviates[best])


def _searched(ground: Ground, effect: Effect, name: str, points: Sequence[dict[str, float]]) -> LineCandidate:
    """The strongest line there is; the other parameters, in which the effect is linear, by least squares."""
    frequency, deviate = strongest_line(ground)
    placed = [point | {name: frequency} for point in points]
    columns = ground.project(np.column_stack([direction(ground, effect, v) for v in placed]))
    weights = np.linalg.lstsq(columns, ground.residual, rcond=_RANK)[0]
    values = {n: float(sum(w * v[n] for w, v in zip(weights, placed, strict=True))) for n in placed[0]}
    return LineCandidate(effect, values | {name: frequency}, deviate)


def line_score(ground: Ground, frequencies: Sequence[float], colour: Callable[[Array], Array]) -> float:
    """Normal deviate of the residual's power at some lines; zero where no recording can show them.

    Args:
        frequencies: of the lines [Hz].
        colour: multiplication by the correlation matrix of the noise.
    """
    blocks = [line_columns(r, frequencies) for r in ground.plan.recordings]
    ends = np.cumsum([b.shape[0] for b in blocks])[:-1]
    columns = ground.project(ground.stack(np.split(block_diag(*blocks), ends)))
    if not columns.size:
        return 0.0
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    q = left[:, size > _RANK * size[0]]
    power = float(np.einsum("ij,ij->", q, colour(q))) / q.shape[1]
    return _deviate(float(np.sum((q.T @ ground.residual) ** 2)) / power, q.shape[1], 1.0)


def strongest_line(ground: Ground) -> tuple[float, float]:
    """The frequency [Hz] at which the recordings' residuals hold most power together, and its normal deviate.

    The periodograms of all recordings, each over the spectrum of its noise, are added up. The tail probability of the
    largest sum is multiplied by the number of frequencies that the longest recording resolves.
    """
    spectra = [
        _spectrum(ground.residual[rows], r) for r, rows in zip(ground.plan.recordings, ground.slices, strict=True)
    ]
    longest = max(s.duration for s in spectra)
    last = max(s.f[-1] for s in spectra)
    f = np.arange(_PERIODS / longest, last, 0.25 / longest)
    power, freedom = np.zeros_like(f), np.zeros_like(f)
    for s in spectra:
        shown = (f >= _PERIODS / s.duration) & (f <= s.f[-1])
        power += np.where(shown, np.interp(f, s.f, s.power), 0.0)
        freedom += 2.0 * shown
    tails = chi2.logsf(power, np.maximum(freedom, 2.0))
    # Where tails underflow the power itself decides.
    best = int(np.lexsort((-power, tails))[0])
    return float(f[best]), _deviate(float(power[best]), int(freedom[best]), last * longest)


@dataclass(frozen=True)
class _Spectrum:
    """Frequencies [Hz] and power in units of half its mean where there is only noise."""

    f: Array
    power: Array
    duration: float


def _spectrum(residual: Array, recording: Recording) -> _Spectrum:
    n = residual.size
    f = np.asarray(np.fft.rfftfreq(_PADDING * n, recording.dt), dtype=np.float64)
    power = 2.0 / n * np.abs(np.fft.rfft(residual, _PADDING * n)) ** 2
    rho = recording.noise_correlation
    lags = np.arange(1, rho.size)
    noise = 1.0 + 2.0 * np.cos(2.0 * np.pi * recording.dt * np.outer(f, lags)) @ rho[1:]
    keep = f < 0.45 / recording.dt
    # A correlation that was cut off may give a spectrum that is hardly positive somewhere.
    return _Spectrum(f[keep], power[keep] / np.maximum(noise[keep], 0.1), n * recording.dt)


def _deviate(saved: float, freedom: int, tries: float) -> float:
    """Normal deviate of a tail probability of χ² times a number of tries."""
    tail = min(chi2.logsf(saved, max(freedom, 1)) + np.log(tries), -1e-12)
    # Far out the tail underflows; what a score means, a sum of squares saved, bounds the deviate in any case.
    return float(np.clip(-ndtri_exp(tail), 0.0, np.sqrt(saved)))
