"""The interface of a rival, the processor time it may take, and the samples that choose its size.

A rival is fitted to recordings; it then answers whole recordings and single samples.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.errors import InputRefused
from phnn.identification.prepare import single
from phnn.recordings.excitation import excitation_of
from phnn.recordings.recording import Recording, dominant_frequency

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
State = Any

_SHOWN = 1e-4  # least singular value, over the largest, of a zero and initial state that samples tell
# From so many recordings on a whole one chooses the size: with fewer, this share at the end of each does.
_WHOLE, _END = 3, 0.3


class Spent(Exception):
    """The budget is spent: the best model so far counts."""


@dataclass(frozen=True)
class Budget:
    """Processor seconds of this process, all threads together, from the moment it is made.

    Attributes:
        seconds: how many; infinity for no limit.
        most: evaluations or updates of each candidate at most. A fit that ends by this number, and not by its time,
            gives the same model on every run.
    """

    seconds: float
    most: int = 10**9
    began: float = field(default_factory=time.process_time)

    @property
    def used(self) -> float:
        """Processor seconds since the beginning."""
        return time.process_time() - self.began

    @property
    def left(self) -> float:
        """Processor seconds that are left, 0 at least."""
        return max(0.0, self.seconds - self.used)

    def part(self, share: float) -> Budget:
        """Return a budget that begins now with a share of what is left."""
        return Budget(share * self.left if math.isfinite(self.seconds) else self.seconds, self.most)

    def share(self, spent: float, turns: int) -> Budget:
        """Return a budget for one of so many turns that end when the share ``spent`` of the whole is gone."""
        spare = self.left - (1.0 - spent) * self.seconds if math.isfinite(self.seconds) else self.seconds
        return Budget(max(0.0, spare) / turns, self.most)

    def check(self) -> None:
        """Stop a fit at the deadline. Raises Spent where nothing is left."""
        if self.left <= 0.0:
            raise Spent


class Stepper(ABC):
    """A model that takes one input sample and gives one output sample, for a loop that is closed around it.

    It has `step` or `run`, whichever is faster; each of them follows from the other.

    Attributes:
        dt: sampling interval, s.
    """

    dt: float

    @abstractmethod
    def rest(self, u: float) -> State:
        """Return the state after a long rest at the input ``u`` [SI]."""

    def step(self, state: State, u: float) -> tuple[State, float]:
        """Return the next state, and the output [SI] at the sample whose input is ``u`` [SI]."""
        state, y = self.run(state, np.array([u]))
        return state, float(y[0])

    def run(self, state: State, u: Array) -> tuple[State, Array]:
        """Step through (N,) inputs [SI]; return the state behind the last one, and (N,) outputs [SI].

        The state in front of the first sample stays as it is.
        """
        y = np.empty(u.size)
        for n, x in enumerate(u):
            state, y[n] = self.step(state, float(x))
        return state, y


@dataclass(frozen=True)
class Fitted(ABC):
    """A rival after its fit.

    Attributes:
        parameters: numbers that were fitted.
        facts: chosen size, processor seconds and what else there is to say.
    """

    parameters: int
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    @abstractmethod
    def dt(self) -> float | None:
        """Sampling interval [s] of a model in discrete time; None where any serves."""

    @abstractmethod
    def simulate(self, recording: Recording) -> Array:
        """Return the (N,) output [SI] from the recording's start, its zero left out; measured outputs only begin it."""

    @abstractmethod
    def stepper(self, dt: float) -> Stepper:
        """Return the model sample by sample. Raises InputRefused where it lives at another interval than ``dt`` [s]."""

    def free(self, recording: Recording) -> Array:
        """Return (N, K) responses to unknown initial states; K is 0 where the start tells them."""
        return np.zeros((recording.t.size, 0))

    def outputs(self, recordings: Sequence[Recording]) -> list[Array]:
        """Return (N,) outputs [SI]; zero and unknown initial state come from identification or nuisance samples."""
        return [anchored(r, self.simulate(r), self.free(r)) for r in recordings]


def anchored(recording: Recording, y: Array, free: Array) -> Array:
    """Return the (N,) response with the recording's own zero and initial state, by least squares.

    The samples are those of `phnn.identification.evaluate`: for identification, else those before the scored ones, else
    all. An output that nobody recorded leaves the response as it is.
    """
    if not np.isfinite(recording.y).all() or not np.isfinite(y).all():
        return y
    masks = (recording.mask("identification"), recording.mask("nuisance"), np.ones(y.size, dtype=bool))
    mask = next(m for m in masks if m.any())
    columns = np.column_stack([np.ones(y.size), free])
    # Over their largest value in the whole recording: a response that the samples hardly show, and that is large
    # elsewhere, is left out.
    columns = columns / np.maximum(np.abs(columns).max(axis=0), 1e-300)
    weights = np.linalg.lstsq(columns[mask], (recording.y - y)[mask], rcond=_SHOWN)[0]
    return np.asarray(y + columns @ weights)


class Rival(ABC):
    """A kind of model with its rule for choosing a size.

    Attributes:
        words: what it is; source: who proposed it; how: by what it is fitted; times: its budget over that of others.
    """

    times: float = 1.0

    words: str
    source: str
    how: str

    def fit(self, recordings: Sequence[Recording], budget_seconds: float, seed: int, most: int = 10**9) -> Fitted:
        """Fit to the identification samples of recordings; none but these chooses the size.

        Args:
            recordings: with one input and one output; recordings without identification samples are left out.
            budget_seconds: processor seconds, after which the best model so far counts.
            seed: of all that is drawn.
            most: evaluations or updates of each candidate, see `Budget`.

        Raises:
            InputRefused: several inputs, no sample to identify from, or no time.
            SolverFailed: no candidate could be simulated within the budget.
        """
        if not budget_seconds > 0.0:
            raise InputRefused(f"budget = {budget_seconds}: give a positive number of processor seconds")
        single(recordings, "this model has one input and one output")
        used = [r for r in recordings if r.mask("identification").any()]
        if not used:
            raise InputRefused("no recording is for identification: set `use: identification` for some")
        self.warm()
        return self._fit(used, Budget(budget_seconds, most), seed)

    def warm(self) -> None:  # noqa: B027
        """Compile or load what is not part of the fit; its time does not count."""

    @abstractmethod
    def _fit(self, recordings: Sequence[Recording], budget: Budget, seed: int) -> Fitted: ...


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
        check = [m if k == aside else np.zeros_like(m) for k, m in enumerate(masks)]
    else:
        check = [np.zeros_like(m) for m in masks]
        for mask, late in zip(masks, check, strict=True):
            samples = np.flatnonzero(mask)
            late[samples[round((1.0 - _END) * samples.size) :]] = True
    return Split(tuple(m & ~c for m, c in zip(masks, check, strict=True)), tuple(check))


@dataclass(frozen=True)
class Scales:
    """Typical sizes: input ``u``, output ``y`` (both SI, half ranges) and ``rate``, the highest angular frequency."""

    u: float
    y: float
    rate: float


def scales_of(recordings: Sequence[Recording]) -> Scales:
    """Return the typical sizes of the identification samples."""
    u = max(float(np.abs(r.u).max()) for r in recordings)
    y = max(0.5 * float(np.ptp(r.y[r.mask("identification")])) for r in recordings)
    return Scales(u or 1.0, y or 1.0, 2.0 * np.pi * highest(recordings))


def run_in(recording: Recording) -> int:
    """Return the samples in front of a periodic recording that it is run through first; 0 for another start."""
    return recording.cycle or (recording.t.size if recording.start.state == "periodic" else 0)


def highest(recordings: Sequence[Recording]) -> float:
    """Return the highest frequency [Hz] of any input; that of the strongest line where no band is recognised."""
    bands = [excitation_of(r.u, r.dt).high_Hz for r in recordings]
    return max(b if b > 0.0 else dominant_frequency(r) for b, r in zip(bands, recordings, strict=True))


def over_noise(fitted: Fitted, recordings: Sequence[Recording], masks: Sequence[Mask]) -> float:
    """Return the root mean square of the residual over noise on masks, each recording's mean residual taken out.

    A recording that is set aside whole has its zero from itself, as the scored ones have it from their first samples.
    Infinite where the model diverged.
    """
    squares: list[Array] = []
    for r, mask in zip(recordings, masks, strict=True):
        if mask.any():
            error = (r.y - anchored(r, fitted.simulate(r), fitted.free(r)))[mask] / r.noise
            squares.append((error - error.mean()) ** 2)
    total = np.concatenate(squares) if squares else np.array([np.inf])
    return float(np.sqrt(total.mean())) if np.isfinite(total).all() else math.inf
