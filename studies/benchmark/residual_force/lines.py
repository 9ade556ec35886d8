"""Terms whose coefficients belong to one recording, or whose frequency has to be searched: mains, shaking, drift.

Each is a set of columns. To enter a table of single terms, a set becomes one column, the least-squares fit of the
residual by those of its columns that stand out of the noise; without any, there is no term.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from phnn.diagnosis.linearised_fit import LinearisedFit
from phnn.identification.nuisances import drift_columns, line_columns
from phnn.recordings.excitation import excitation_of
from phnn.recordings.recording import Recording
from studies.benchmark.residual_force.states import States
from studies.benchmark.residual_force.terms import Action, Term

Array = NDArray[np.float64]

# Mains [Hz] and harmonics; half-cosines of a drift; frequencies of shaking [Hz]; power of a line over the local noise.
_MAINS, _HARMONICS, _DRIFT, _SHAKING, _STANDS = (50.0, 60.0), (1, 2, 3), 4, (0.5, 200.0), 12.0
# Lines nearer than this to those of the drive, in 1/duration, cannot be told from them.
_APART = 1.5


@dataclass(frozen=True)
class Lines:
    """Attributes:
    terms: without an action of their own; outputs: for each, (N,) changes of the output [m] by recording, without
        their size.
    """

    terms: tuple[Term, ...]
    outputs: tuple[tuple[Array, ...], ...]

    def columns(self, linearised: LinearisedFit) -> Array:
        """(n, L) weighted columns."""
        none = np.zeros((linearised.fit.residual.size, 0))
        return np.column_stack([none, *(linearised.stack(each) for each in self.outputs)])

    @classmethod
    def found(cls, linearised: LinearisedFit) -> Lines:
        """Search the residual."""
        recordings, residual = linearised.plan.recordings, linearised.residual
        terms, outputs = [], []
        for name, effect, each in _sets(recordings):
            fitted = [
                _standing(columns, residual[rows], r.mask("identification"), r.noise)
                for columns, rows, r in zip(each, linearised.slices, recordings, strict=True)
            ]
            if any(np.any(x) for x in fitted):
                terms.append(Term(name, effect, _nothing))
                outputs.append(tuple(fitted))
        frequency, common = _shaken(linearised)
        if frequency:
            for wave, part in zip((np.cos, np.sin), common, strict=True):
                action = partial(_wave, wave, frequency)
                terms.append(Term(f"{wave.__name__}({frequency:.3g} Hz)", "base_motion", action))
                outputs.append(part)
        return cls(tuple(terms), tuple(outputs))


def _nothing(s: States) -> Action:
    """What is known of a line with a phase of its own, or of a drift, in another recording."""
    return Action()


def _wave(wave: Callable[[Array], Array], frequency: float, s: States) -> Action:
    """The motion under a shaking base: a linear plant answers with the same frequency."""
    return Action(output=wave(2.0 * np.pi * frequency * s.t))


def _sets(recordings: Sequence[Recording]) -> list[tuple[str, str, list[Array]]]:
    """Name, effect and (N, C) columns of every set by recording; none where a drive has the frequency itself."""
    found = []
    for frequency in _MAINS:
        lines = [n * frequency for n in _HARMONICS]
        each = [line_columns(r, [] if _driven(r, frequency) else lines) for r in recordings]
        found.append((f"y: mains({frequency:g})", "mains_pickup", each))
    return [*found, ("y: drift", "sensor_drift", [drift_columns(r, _DRIFT) for r in recordings])]


def _standing(columns: Array, residual: Array, mask: NDArray[np.bool_], noise: float) -> Array:
    """(N,) the part of a residual in its noise that is made of pairs of columns whose power stands out [m]."""
    total = np.zeros(columns.shape[0])
    for k in range(0, columns.shape[1], 2):
        pair = columns[:, k : k + 2]
        inside = pair[mask] - pair[mask].mean(axis=0)
        found, *_ = np.linalg.lstsq(inside, residual, rcond=None)
        left = residual - inside @ found
        if float(np.sum((inside @ found) ** 2)) > _STANDS * _floor(left, inside[:, 0]):
            total += noise * (pair @ found)
    return total


def _driven(recording: Recording, frequency: float) -> bool:
    """Whether a sine drives the recording that has a line or harmonics at a frequency [Hz]."""
    excitation = excitation_of(recording.drive, recording.dt)
    if excitation.kind != "sine" or not excitation.low_Hz > 0.0:
        return False
    away = abs(frequency - excitation.low_Hz * max(1, round(frequency / excitation.low_Hz)))
    return away * recording.t.size * recording.dt < _APART


def _floor(left: Array, line: Array) -> float:
    """Power of one line of noise near the frequency of another, by the lines around it."""
    power = 2.0 * np.abs(np.fft.rfft(left)) ** 2 / left.size
    peak = int(np.argmax(np.abs(np.fft.rfft(line - line.mean()))))
    near = power[max(1, peak - 12) : peak + 13]
    return float(np.mean(near))


def _shaken(linearised: LinearisedFit) -> tuple[float, tuple[tuple[Array, ...], tuple[Array, ...]]]:
    """The frequency at which all recordings share a line most, and its cosine and sine; zero where none stands out."""
    recordings, residual = linearised.plan.recordings, linearised.residual
    longest = max(r.t.size * r.dt for r in recordings)
    grid = np.arange(_SHAKING[0], _SHAKING[1], 0.25 / longest) if longest > 0.0 else np.zeros(0)
    gains = np.zeros(grid.size, dtype=complex)
    for r, rows in zip(recordings, linearised.slices, strict=True):
        t = r.t[r.mask("identification")]
        gains += np.exp(-2j * np.pi * np.outer(grid, t)) @ residual[rows]
    power = np.abs(gains) ** 2
    best = int(np.argmax(power))
    if power[best] < 2.0 * _STANDS * float(np.median(power)) / np.log(2.0):
        return 0.0, ((), ())
    phases = [2.0 * np.pi * grid[best] * r.t for r in recordings]
    return float(grid[best]), (tuple(map(np.cos, phases)), tuple(map(np.sin, phases)))
