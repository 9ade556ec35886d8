"""Free runs of a model over many samples: no load, no measured output, a periodic voltage and then none.

A passive actuator under a periodic voltage approaches a periodic steady state, which repeats itself, and comes to rest
after the voltage ends. A run begins at rest under another voltage than that at which the drive begins: a wrong initial
state. Samples are fed in chunks, and only two periods of the output are kept.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.errors import InputRefused
from studies.rival_models.loops import FAILS, FAR, GROWS, MOVES
from studies.rival_models.rival import Stepper

Array = NDArray[np.float64]

# Period of the voltage, s, and its tones in multiples of the lowest: 10, 30 and 70 Hz are within the identified range.
PERIOD, MULTIPLES = 0.1, (1.0, 3.0, 7.0)
CHUNK = 100_000  # samples that are computed at once
LEAST = 20  # periods that a run has at least, so that it has two that can be compared and a rest
# Parts of a run: behind the first the period that is compared, behind the last the voltage is zero.
_COMPARED, _DRIVEN = 0.01, 0.9
_FINE = 2000  # times at which the largest voltage of a period is looked for
# Difference of two periods over the output's r.m.s. above which a model counts as drifted: 1 %, ten times the 0.001
# that the transient of the identified actuator leaves in runs of 200,000 samples. Slow lags of stable models can exceed
# it; their late drift tells them from a model that keeps moving.
DRIFTED = 1e-2


@dataclass(frozen=True)
class Drive:
    """A periodic voltage of three tones.

    Attributes:
        amplitudes: (3,) V; phases: (3,) rad.
        before: constant voltage before the first sample, V.
    """

    amplitudes: Array
    phases: Array
    before: float

    @property
    def peak(self) -> float:
        """Largest voltage of the drive and of the rest in front of it, V."""
        return max(
            abs(self.before), float(np.abs(self.at(np.arange(_FINE, dtype=np.float64) * (PERIOD / _FINE))).max())
        )

    def at(self, t: Array) -> Array:
        """(N,) voltage [V] at the times ``t`` (N,) [s]."""
        angles = 2.0 * np.pi / PERIOD * np.outer(t, MULTIPLES) + self.phases
        return np.asarray(np.sin(angles) @ self.amplitudes)

    def period(self, dt: float) -> Array:
        """One period (P,) [V] at the sampling interval nearest to ``dt`` [s] that divides it."""
        count = max(1, round(PERIOD / dt))
        return self.at(np.arange(count, dtype=np.float64) * (PERIOD / count))


def drawn_drive(peak: float, seed: int, number: int) -> Drive:
    """Draw phases and amplitudes, with a largest voltage of 0.3 to 0.95 times ``peak`` [V].

    The voltage before has the sign that the drive does not begin with, and at least a tenth of the peak.

    Args:
        seed, number: of the drive; models with different sampling intervals get the same voltage.
    """
    rng = np.random.default_rng([seed, number])
    drive = Drive(rng.uniform(0.2, 1.0, len(MULTIPLES)), rng.uniform(0.0, 2.0 * np.pi, len(MULTIPLES)), 0.0)
    amplitudes = drive.amplitudes * peak * rng.uniform(0.3, 0.95) / drive.peak
    side = -1.0 if drive.at(np.zeros(1))[0] >= 0.0 else 1.0
    return Drive(amplitudes, drive.phases, side * peak * rng.uniform(0.1, 1.0))


@dataclass(frozen=True)
class LongRun:
    """Attributes:
    samples: before the run ended or the output left the range.
    diverged: the output is not finite, or ten times the largest static one.
    drift: r.m.s. difference between the output in a period at one hundredth of the run and in the last driven one, over
        its r.m.s. in the former; NaN where the model diverged before.
    late: the same from a period in the middle of the drive to the last driven one.
    motion: r.m.s. about the mean in the last quarter of the rest, over that in its first quarter; NaN where the model
        diverged.
    gained: the motion grew during the rest.
    seconds: processor time.
    """

    samples: int
    diverged: bool
    drift: float
    late: float
    motion: float
    gained: bool
    seconds: float

    @property
    def drifted(self) -> bool:
        """Whether the drift is larger than that of a periodic steady state."""
        return self.drift > DRIFTED


class Kept:
    """The outputs of a run that are compared, gathered from chunks.

    Args:
        period: samples in a period; samples: of the run.

    Raises:
        InputRefused: the run has fewer than twenty periods.
    """

    def __init__(self, period: int, samples: int) -> None:
        if samples < LEAST * period:
            raise InputRefused(f"samples = {samples}: give {LEAST * period} or more, {LEAST} periods of the voltage")
        driven = int(_DRIVEN * samples) // period
        self.driven = driven * period
        early = max(1, int(_COMPARED * samples) // period)
        rest = np.linspace(self.driven, samples, 5).astype(int)
        chosen = (early, driven // 2, driven - 1)
        self._early, self._middle, self._end = (_Part(k * period, (k + 1) * period) for k in chosen)
        self._first, self._last = _Spread(rest[0], rest[1]), _Spread(rest[3], rest[4])
        self._largest = 0.0

    def take(self, first: int, y: Array) -> None:
        """Take the outputs ``y`` (N,) [SI] that begin at the sample ``first``."""
        self._largest = max(self._largest, float(np.abs(y).max(initial=0.0)))
        for part in (self._early, self._middle, self._end, self._first, self._last):
            part.take(first, y)

    @property
    def drift(self) -> float:
        """Change from the early period to the last driven one, see `LongRun`; NaN where one is not complete."""
        return self._change(self._early.y)

    @property
    def late(self) -> float:
        """Change from the period in the middle to the last driven one, see `LongRun`."""
        return self._change(self._middle.y)

    def _change(self, before: Array) -> float:
        """R.m.s. difference between the last driven period and one before, over the r.m.s. of the latter."""
        return _over(float(np.sqrt(np.mean((self._end.y - before) ** 2))), float(np.sqrt(np.mean(before**2))))

    @property
    def motion(self) -> float:
        """Motion during the rest, see `LongRun`."""
        return _over(self._last.deviation, self._first.deviation)

    @property
    def gained(self) -> bool:
        """Whether the motion grew, and is large enough to count as motion."""
        return self.motion > GROWS and self._last.deviation > MOVES * self._largest


def _over(value: float, size: float) -> float:
    """A ratio; zero over zero is zero, as nothing has moved."""
    if value == 0.0:
        return 0.0
    return value / size if size != 0.0 else math.inf


class _Part:
    """Outputs ``y`` from the sample ``first`` to that before ``last``; NaN until they are taken."""

    def __init__(self, first: int, last: int) -> None:
        self._span, self.y = (first, last), np.full(last - first, np.nan)

    def take(self, first: int, y: Array) -> None:
        begin, end = max(first, self._span[0]), min(first + y.size, self._span[1])
        if begin < end:
            self.y[begin - self._span[0] : end - self._span[0]] = y[begin - first : end - first]


class _Spread:
    """Deviation of the samples from ``first`` to that before ``last`` about their mean, gathered from chunks."""

    def __init__(self, first: int, last: int) -> None:
        self._span, self._count, self._mean, self._squares = (first, last), 0, 0.0, 0.0

    def take(self, first: int, y: Array) -> None:
        """Join the mean and the sum of squares with those of the chunk (Chan, Golub, LeVeque 1983)."""
        own = y[max(self._span[0] - first, 0) : max(self._span[1] - first, 0)]
        if own.size == 0:
            return
        mean, count = float(own.mean()), self._count + own.size
        apart = mean - self._mean
        self._squares += float(np.sum((own - mean) ** 2)) + apart**2 * self._count * own.size / count
        self._mean += apart * own.size / count
        self._count = count

    @property
    def deviation(self) -> float:
        """Root mean square about the mean, SI; NaN without samples."""
        return math.sqrt(self._squares / self._count) if self._count else math.nan


def long_run(stepper: Stepper, drive: Drive, gain: float, samples: int) -> LongRun:
    """Run a model freely.

    Args:
        gain: static displacement per volt of the actuator, m/V.
        samples: of the run, at the model's own interval.

    Raises:
        InputRefused: the run is shorter than twenty periods.
    """
    one = drive.period(stepper.dt)
    kept, far, first, spent = Kept(one.size, samples), FAR * gain * drive.peak, 0, 0.0
    try:
        state = stepper.rest(drive.before)
        for first in range(0, samples, CHUNK):
            places = np.arange(first, min(first + CHUNK, samples))
            u = np.where(places < kept.driven, one[places % one.size], 0.0)
            began = time.process_time()
            state, y = stepper.run(state, u)
            spent += time.process_time() - began
            lost = np.flatnonzero(~(np.abs(y) < far))
            kept.take(first, y[: lost[0]] if lost.size else y)
            if lost.size:
                return LongRun(first + int(lost[0]), True, kept.drift, kept.late, math.nan, False, spent)
    except FAILS:
        return LongRun(first, True, kept.drift, kept.late, math.nan, False, spent)
    return LongRun(samples, False, kept.drift, kept.late, kept.motion, kept.gained, spent)
