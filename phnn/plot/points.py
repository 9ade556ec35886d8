"""Measured points of a frequency response, from recordings of single sines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phnn.plot.panels import Array
from phnn.recordings.excitation import excitation_of
from phnn.recordings.recording import Recording
from phnn.signals.harmonics import HARMONICS, deviation, harmonic_weights


@dataclass(frozen=True)
class Point:
    """Response in one recording of a single sine.

    Attributes:
        name: of the recording; frequency [Hz]; amplitude: of the input.
        gain: ``Y_1/U_1``; std: its standard deviation by the noise, of either part.
        harmonics: (4,) ``|Y_k|/|Y_1|`` for k = 2 … 5.
    """

    name: str
    frequency: float
    amplitude: float
    gain: complex
    std: float
    harmonics: Array


def point(recording: Recording) -> Point | None:
    """The response in a recording of a single sine, by its last whole periods; None of any other recording."""
    drive = excitation_of(recording.u, recording.dt)
    if drive.kind != "sine" or drive.cycles < 1.0 or not np.isfinite(recording.y).all():
        return None
    period = recording.period or 1.0 / drive.low_Hz
    # The first period holds the transient.
    whole = max(1, int(drive.cycles + 1e-6) - (recording.start.state != "periodic"))
    rows = slice(max(drive.span[0], drive.span[1] - round(whole * period / recording.dt)), drive.span[1])
    if period / recording.dt < 2 * HARMONICS + 2:
        return None
    waves = harmonic_weights(recording.t[rows], period)
    into, out = waves[0] @ recording.u[rows], waves @ recording.y[rows]
    noise = recording.noise if recording.noise_found else np.nan
    std = noise * deviation(waves[0], recording.noise_correlation) / np.sqrt(2.0) / abs(into)
    return Point(
        recording.name, 1.0 / period, float(abs(into)), complex(out[0] / into), float(std),
        np.abs(out[1:]) / abs(out[0]),
    )  # fmt: skip
