"""The score of lines: a subspace instead of a direction, because their phases are not known.

With an orthonormal basis ``Q`` of the lines of all recordings, base and nuisances projected out, ``‖Qᵀr‖²`` over the
mean noise power along ``Q`` is χ² with as many degrees of freedom as columns, where nothing is missing. The standard
normal deviate of the same tail probability makes it comparable to the score of a direction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.special import ndtri_exp
from scipy.stats import chi2

from phnn.diagnose.colour import Colour, doubt, first_order_of
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
    """An effect that shows as lines.

    Attributes:
        effect: which; values: of its parameters.
        deviate: how far the lines stand out of the stated noise, as a normal deviate.
        judged: the same out of the noise as the residual has it, where that is more.
    """

    effect: Effect
    values: dict[str, float]
    deviate: float
    judged: float


def line_candidates(ground: Ground, effects: Sequence[Effect], colour: Colour) -> list[LineCandidate]:
    """Those of the effects that show as lines, with their scores."""
    found = []
    for effect in effects:
        points = effect.grid(ground.scales)
        if effect.searched is not None:
            found.append(_searched(ground, effect, effect.searched, points))
        elif effect.add_to(ground.fit.setup, points[0]).lines != ground.fit.setup.lines:
            found.append(_known(ground, effect, points, colour))
    return found


def _known(ground: Ground, effect: Effect, points: Sequence[dict[str, float]], colour: Colour) -> LineCandidate:
    """The best of a few given frequencies."""
    found = [line_score(ground, effect.add_to(ground.fit.setup, v).lines, colour) for v in points]
    best = max(range(len(points)), key=lambda i: found[i])
    return LineCandidate(effect, dict(points[best]), *found[best])


def _searched(ground: Ground, effect: Effect, name: str, points: Sequence[dict[str, float]]) -> LineCandidate:
    """The strongest line there is; the other parameters, in which the effect is linear, by least squares."""
    frequency, deviate, judged = strongest_line(ground)
    placed = [point | {name: frequency} for point in points]
    columns = ground.project(np.column_stack([direction(ground, effect, v) for v in placed]))
    weights = np.linalg.lstsq(columns, ground.residual, rcond=_RANK)[0]
    values = {n: float(sum(w * v[n] for w, v in zip(weights, placed, strict=True))) for n in placed[0]}
    return LineCandidate(effect, values | {name: frequency}, deviate, judged)


def line_score(ground: Ground, frequencies: Sequence[float], colour: Colour) -> tuple[float, float]:
    """Normal deviates of the residual's power at some lines, out of the noise as stated and as the residual has it.

    Both are zero where no recording can show the lines.

    Args:
        frequencies: of the lines [Hz].
    """
    blocks = [line_columns(r, frequencies) for r in ground.plan.recordings]
    ends = np.cumsum([b.shape[0] for b in blocks])[:-1]
    columns = ground.project(ground.stack(np.split(block_diag(*blocks), ends)))
    if not columns.size:
        return 0.0, 0.0
    basis, size, _ = np.linalg.svd(columns, full_matrices=False)
    q = basis[:, size > _RANK * size[0]]
    stated, left = (np.einsum("ij,ij->", q, times(q)) / q.shape[1] for times in (colour.stated, colour.left))
    saved = float(np.sum((q.T @ ground.residual) ** 2) / stated)
    return _deviate(saved, q.shape[1], 1.0), _deviate(saved / float(doubt(left, stated)) ** 2, q.shape[1], 1.0)


def strongest_line(ground: Ground) -> tuple[float, float, float]:
    """The frequency [Hz] at which the recordings' residuals hold most power together, and its normal deviates.

    The periodograms of all recordings, each over the spectrum of its noise, are added up. The tail probability of the
    largest sum is multiplied by the number of frequencies that the longest recording resolves. The deviates are those
    out of the noise as stated and as the residual has it; the frequency is that of the first.
    """
    spectra = [
        _spectrum(ground.residual[rows], r) for r, rows in zip(ground.plan.recordings, ground.slices, strict=True)
    ]
    longest = max(s.duration for s in spectra)
    last = max(s.f[-1] for s in spectra)
    f = np.arange(_PERIODS / longest, last, 0.25 / longest)
    power, judged, freedom = np.zeros_like(f), np.zeros_like(f), np.zeros_like(f)
    for s in spectra:
        shown = (f >= _PERIODS / s.duration) & (f <= s.f[-1])
        power += np.where(shown, np.interp(f, s.f, s.power), 0.0)
        judged += np.where(shown, np.interp(f, s.f, s.judged), 0.0)
        freedom += 2.0 * shown
    # Where tails underflow the power itself decides.
    best, worst = (int(np.lexsort((-p, chi2.logsf(p, np.maximum(freedom, 2.0))))[0]) for p in (power, judged))
    deviates = [_deviate(float(p[i]), int(freedom[i]), last * longest) for p, i in ((power, best), (judged, worst))]
    return float(f[best]), deviates[0], deviates[1]


@dataclass(frozen=True)
class _Spectrum:
    """Frequencies [Hz], and power in units of half its mean under noise as stated and as the residual has it."""

    f: Array
    power: Array
    judged: Array
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
    stated = np.maximum(noise[keep], 0.1)
    squares, a = first_order_of(residual)
    left = squares * (1.0 - a * a) / (1.0 + a * a - 2.0 * a * np.cos(2.0 * np.pi * recording.dt * f[keep]))
    return _Spectrum(
        f[keep], power[keep] / stated, power[keep] / stated / doubt(left, stated) ** 2, n * recording.dt
    )  # fmt: skip


def _deviate(saved: float, freedom: int, tries: float) -> float:
    """Normal deviate of a tail probability of χ² times a number of tries."""
    tail = min(chi2.logsf(saved, max(freedom, 1)) + np.log(tries), -1e-12)
    # Far out the tail underflows; what a score means, a sum of squares saved, bounds the deviate in any case.
    return float(np.clip(-ndtri_exp(tail), 0.0, np.sqrt(saved)))
