"""The features of a fitted base model: a vector of one length whatever recordings there are; what is missing is NaN.

Each recording has its slots: a sine that of its frequency, at nearly the largest amplitude or below; a sweep one for
each band of its instantaneous frequency; a recording with jumps one. A slot that several recordings share has the mean
of their features. Features of all recordings together, and the estimates themselves, complete the vector.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from phnn.identification.fit import Fit
from phnn.recordings import Recording
from phnn.recordings.excitation import Excitation, excitation_of
from studies.benchmark.fingerprints import cycles, jumps, together
from studies.benchmark.fingerprints.together import Signals

Array = NDArray[np.float64]

# Ends of the bands of sines and of sweeps, Hz; amplitudes over the largest one from which on a sine is a full one.
_SINES, _SWEEPS = (3.0, 17.0, 35.0, 62.0, 87.0, 120.0), (20.0, 40.0, 60.0, 80.0)
_SMALL, _FULL = 0.5, 0.85
_SLOTS = (
    *(f"sine_{i}" for i in range(len(_SINES) + 1)),
    *("small_slow", "middle_slow", "small_fast"),
    *(f"sweep_{i}" for i in range(len(_SWEEPS) + 1)),
)
_JUMPS = "jumps"
# Resistances are left out: that of a fast hysteron is in no recording, and its estimate tells where the fit began.
_PARAMETERS = ("m", "k", "b", "alpha", "C_1", "d_1", "C_2", "d_2")


def names() -> list[str]:
    """Names of all features, in their order."""
    return [
        *(f"{slot}.{name}" for slot in _SLOTS for name in cycles.names()),
        *(f"{_JUMPS}.{name}" for name in jumps.names()),
        *(f"all.{name}" for name in together.names()),
        *(f"base.{name}" for name in _PARAMETERS),
    ]


def features(fitted: Fit) -> dict[str, float]:
    """The features of a base model that was fitted to all samples of its recordings.

    Returns:
        Numbers by name, for all of `names`, in their order; finite or NaN.
    """
    ends = np.cumsum([int(np.count_nonzero(r.mask(fitted.use))) for r in fitted.plan.recordings])
    residuals = np.split(fitted.residual, ends[:-1])
    signals = [
        _signals(r, left * r.noise, fitted.use) for r, left in zip(fitted.plan.recordings, residuals, strict=True)
    ]
    total = float(np.sqrt(np.mean(np.concatenate([s.left for s in signals]) ** 2)))
    largest = max(float(np.ptp(s.u)) for s in signals)
    found: dict[str, list[float]] = defaultdict(list)
    for s, recording in zip(signals, fitted.plan.recordings, strict=True):
        excitation = excitation_of(recording.drive, recording.dt)
        for slot, values in _slots(s, excitation, largest, total):
            for name, value in values.items():
                found[f"{slot}.{name}"].append(value)
    values = {name: float(np.mean(each)) for name, each in found.items()}
    values |= {f"all.{name}": value for name, value in together.together(signals).items()}
    values |= {f"base.{name}": value for name, value in _estimates(fitted).items()}
    return {name: _finite(values.get(name, math.nan)) for name in names()}


def _finite(value: float) -> float:
    return value if math.isfinite(value) else math.nan


def _signals(recording: Recording, left: Array, use: str) -> Signals:
    mask, excitation = recording.mask(use), excitation_of(recording.drive, recording.dt)
    y = recording.y[mask] - left
    frequency = excitation.low_Hz if excitation.kind == "sine" else math.nan
    return Signals(recording.t[mask], recording.u[mask], y - y.mean(), left, recording.noise, frequency)


def _slots(s: Signals, excitation: Excitation, largest: float, total: float) -> Iterator[tuple[str, dict[str, float]]]:
    """The slots that a recording fills, with their features."""
    if excitation.kind == "sine":
        phase = cycles.sine_phase(s.t, s.u, s.frequency)
        yield (
            _slot_of(s.frequency, float(np.ptp(s.u)) / largest),
            cycles.window(phase, s.y, s.left, s.dt, s.sigma, total),
        )
    elif excitation.kind == "chirp":
        phase = cycles.sweep_phase(s.u)
        rate = np.gradient(phase, s.dt) / (2.0 * math.pi)
        # The angle of the analytic signal wavers within a cycle at low frequencies: a cubic in time does not.
        smooth = np.polynomial.Polynomial.fit(s.t, rate, 3)(s.t)
        band = np.searchsorted(_SWEEPS, smooth)
        for i in range(len(_SWEEPS) + 1):
            rows = band == i
            yield f"sweep_{i}", cycles.window(phase[rows], s.y[rows], s.left[rows], s.dt, s.sigma, total)
    elif excitation.kind == "steps":
        yield _JUMPS, jumps.jumps(s.t, s.u, s.left, s.sigma, total)


def _slot_of(frequency: float, amplitude: float) -> str:
    """The slot of a sine [Hz] of an amplitude over the largest one."""
    if amplitude >= _FULL:
        return f"sine_{int(np.searchsorted(_SINES, frequency))}"
    if frequency > _SINES[1]:
        return "small_fast"
    return "small_slow" if amplitude <= _SMALL else "middle_slow"


def _estimates(fitted: Fit) -> dict[str, float]:
    """Logarithms of the estimates; hysterons in the order in which they slip."""
    values = fitted.setup.values()
    # C d is the charge from which on a hysteron slips.
    order = sorted((1, 2), key=lambda i: values[f"C_{i}"] * values[f"d_{i}"])
    swapped = {f"{n}_{new}": values[f"{n}_{old}"] for new, old in enumerate(order, start=1) for n in ("C", "d")}
    return {n: math.log(max(x, 1e-300)) for n, x in ({n: values[n] for n in _PARAMETERS} | swapped).items()}
