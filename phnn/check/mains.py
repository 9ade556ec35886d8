"""Mains pickup: tones at 50 or 60 Hz and their multiples that nothing drives."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phnn.check.finding import WARNING, Finding
from phnn.recordings.excitation import Excitation
from phnn.recordings.recording import Recording
from phnn.units import quantity

Array = NDArray[np.float64]

_MAINS, _MULTIPLES = (50.0, 60.0), (1, 2, 3)
# Power of a tone over the median around it: of some hundred thousand bins of noise one comes that far.
_STANDS_OUT = 20.0
# Bins of the neighbourhood on either side, of the tone itself, and the least periods that tell it from slow changes.
_AROUND, _ITSELF, _PERIODS = 25, 3, 8.0


def mains(recording: Recording, excitation: Excitation) -> list[Finding]:
    """The multiples of a mains frequency that stand out of an output's spectrum, but not out of its input's.

    Hann window; the amplitude of a tone is that of a sine of the same power.
    """
    duration = recording.t.size * recording.dt
    lines = [base * n for base in _MAINS for n in _MULTIPLES]
    asked = [f for f in lines if _shown(recording, f, duration) and not _driven(excitation, f, duration)]
    if not asked:
        return []
    output, drive = _spectrum(recording.y), _spectrum(recording.drive)
    found = {f: a for f in asked if (a := _amplitude(output, drive, f * duration, recording.t.size)) > 0.0}
    if not found:
        return []
    said = ", ".join(f"{f:g} Hz ({quantity(a, recording.units.output)})" for f, a in found.items())
    text = f"tones of the mains in the output at {said}: look for a ground loop, or shield the sensor"
    return [Finding("mains", WARNING, text, {f"amplitude_{f:g}Hz": a for f, a in found.items()})]


def _shown(recording: Recording, frequency: float, duration: float) -> bool:
    """Whether a recording is long enough, and sampled fast enough, to show a tone."""
    return frequency * duration >= _PERIODS and frequency <= 0.45 / recording.dt


def _driven(excitation: Excitation, frequency: float, duration: float) -> bool:
    """Whether a harmonic of what drives the recording lies within its resolution of the frequency."""
    if excitation.kind not in ("sine", "periodic"):
        return False
    return abs(frequency - excitation.low_Hz * round(frequency / excitation.low_Hz)) * duration < _ITSELF


def _spectrum(x: Array) -> Array:
    """Power by bins, through a Hann window."""
    return np.asarray(np.abs(np.fft.rfft((x - x.mean()) * np.hanning(x.size))) ** 2)


def _amplitude(output: Array, drive: Array, place: float, samples: int) -> float:
    """Amplitude of a tone in the output's spectrum; 0 where there is none, or where the input could have caused it."""
    stands_out, power = _over_neighbours(output, round(place))
    if stands_out < _STANDS_OUT or _over_neighbours(drive, round(place))[0] > 0.1 * stands_out:
        return 0.0
    # A sine of amplitude a has the power (a n/4)² in the middle bin of a Hann window, a quarter of it on either side.
    return float(np.sqrt(power / 1.5)) * 4.0 / samples


def _over_neighbours(spectrum: Array, middle: int) -> tuple[float, float]:
    """Power at a bin over the median around it, and the power in its three bins together."""
    own = slice(max(middle - 1, 0), middle + 2)
    below = spectrum[max(middle - _AROUND, 1) : max(middle - _ITSELF, 1)]
    around = np.concatenate([below, spectrum[middle + _ITSELF + 1 : middle + _AROUND + 1]])
    peak = float(spectrum[own].max(initial=0.0))
    return peak / max(float(np.median(around)) if around.size else 0.0, 1e-300), float(spectrum[own].sum())
