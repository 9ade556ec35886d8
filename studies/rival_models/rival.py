"""The interface of a rival: fitted to recordings, it answers whole recordings and single samples."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.errors import InputRefused
from phnn.identification.prepare import single
from phnn.recordings.recording import Recording
from studies.rival_models.budget import Budget

Array = NDArray[np.float64]
State = Any

_SHOWN = 1e-4  # least singular value, over the largest, of a zero and initial state that samples tell


class Stepper(ABC):
    """A model that takes one input sample and gives one output sample, for a loop that is closed around it.

    Attributes:
        dt: sampling interval, s.
    """

    dt: float

    @abstractmethod
    def rest(self, u: float) -> State:
        """The state after a long rest at the input ``u`` [SI]."""

    @abstractmethod
    def step(self, state: State, u: float) -> tuple[State, float]:
        """The next state, and the output [SI] at the sample whose input is ``u`` [SI]; the zero is the model's own."""

    def run(self, state: State, u: Array) -> tuple[State, Array]:
        """Step through many samples; a model with a faster way than `step` overrides this.

        Args:
            state: in front of the first sample; it stays as it is.
            u: (N,) inputs [SI], one at least.

        Returns:
            The state behind the last sample, and (N,) outputs [SI]: those of `step`, as long as they are finite.
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
        """``(N,)`` output [SI] from the recording's start, its zero left out; measured outputs only begin it."""

    @abstractmethod
    def stepper(self, dt: float) -> Stepper:
        """The model sample by sample.

        Raises:
            InputRefused: the model lives at another sampling interval than ``dt``.
        """

    def free(self, recording: Recording) -> Array:
        """``(N, K)`` responses to unknown initial states; K is 0 where the start tells them."""
        return np.zeros((recording.t.size, 0))

    def outputs(self, recordings: Sequence[Recording]) -> list[Array]:
        """``(N,)`` outputs [SI]; zero and unknown initial state come from the identification or nuisance samples."""
        return [anchored(r, self.simulate(r), self.free(r)) for r in recordings]

    def _same_interval(self, dt: float) -> None:
        own = self.dt
        if own is not None and abs(dt - own) > 1e-9 * own:
            raise InputRefused(f"dt = {dt:g} s: this model steps at {own:g} s, close the loop at that interval")


def anchored(recording: Recording, y: Array, free: Array) -> Array:
    """``(N,)`` response with the recording's own zero and initial state, by least squares.

    The samples are those of `phnn.identification.evaluate`: for identification, else those before the scored ones, else
    all. An output that nobody recorded leaves the response as it is.
    """
    if not np.isfinite(recording.y).all():
        return y
    masks = (recording.mask("identification"), recording.mask("nuisance"), np.ones(y.size, dtype=bool))
    mask = next(m for m in masks if m.any())
    columns = np.column_stack([np.ones(y.size), free])
    if not np.isfinite(y).all():
        return y
    # Over their largest value in the whole recording: a response that the samples hardly show, and that is large
    # elsewhere, is left out.
    columns = columns / np.maximum(np.abs(columns).max(axis=0), 1e-300)
    found = np.linalg.lstsq(columns[mask], (recording.y - y)[mask], rcond=_SHOWN)[0]
    return np.asarray(y + columns @ found)


class Rival(ABC):
    """A kind of model with its rule for choosing a size.

    Attributes:
        words: what it is; source: who proposed it; how: by what it is fitted.
    """

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
