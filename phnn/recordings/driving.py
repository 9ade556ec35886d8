"""The input of a recording on the sub-steps of a simulation, and the unknown instants of its jumps."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.recordings.recording import Recording
from phnn.signals.reconstruct import (
    WITH_BREAKS,
    Reconstruction,
    mean_input,
    starts_with_jump,
    substep_counts,
    substep_input,
)

Array = NDArray[np.float64]

# Jumps of a recording whose instants are estimated one by one. More of them come from one clock: their instants lie
# equally far behind the sample before.
_ALONE = 24
# Periods that miss whole samples by less than this over the recording let their jumps share an instant.
_WHOLE = 0.02


class Driving(NamedTuple):
    """Attributes:
    counts: (N−1,) sub-steps of every sample interval, those of the lead before them.
    lead: samples before the first recorded one: a cycle where the recording starts in a steady one; the input before
        where the recording starts with a jump from it, whose instant is not known.
    command: the first input; further: (n, F) means of the other ones.
    group: (J,) which of the recording's instants each jump of the first input has.
    lengths: (N−1,) of the sample intervals, in mean ones.
    """

    counts: NDArray[np.int64]
    lead: int
    command: Reconstruction
    further: Array
    group: NDArray[np.int64]
    lengths: Array

    def fine(self, recording: Recording) -> Array:
        """(n, 3) the first input with jumps at the recording's instants."""
        return self.command.fine(self.instants(recording)[self.group])

    def slopes(self, recording: Recording) -> Array:
        """(n, G) derivatives of the mean first input by the recording's instants."""
        return self.command.slopes(self.instants(recording)[self.group], self.group)

    def instants(self, recording: Recording) -> Array:
        """(G,) the recording's instants; those that are assumed where it has none for the jumps of this input."""
        count = int(self.group.max(initial=-1)) + 1
        if recording.instants is not None and recording.instants.size == count:
            return recording.instants
        return np.array([self.command.nominal[self.group == g][0] for g in range(count)])


class _Same:
    """An array as the key of a cache: equal to itself alone."""

    __slots__ = ("array",)

    def __init__(self, array: Array) -> None:
        self.array = array

    def __hash__(self) -> int:
        return id(self.array)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and other.array is self.array


def driving_of(recording: Recording, substeps: int, method: str | None = None) -> Driving:
    """The input of a recording between its samples; kept, because every candidate model sees the same one.

    Args:
        substeps: steps a sample interval, more of them after jumps.
        method: another reconstruction than the recording's.
    """
    given = _Given(
        _Same(recording.u), tuple(_Same(x) for x in recording.further.values()), recording.cycle,
        input_before(recording, recording.u), (recording.period or 0.0) / recording.dt,
        None if recording.clock is None else _Same(recording.t),
    )  # fmt: skip
    return _driving(given, substeps, method or recording.interpolation)


class _Given(NamedTuple):
    """What a recording says of its inputs, as the key of a cache.

    Attributes:
        u: the first input; further: the other ones.
        cycle: samples of a steady cycle; before: the input before the first sample.
        period: of the input in sample intervals; 0 for none.
        times: sampling instants that are not uniform, s.
    """

    u: _Same
    further: tuple[_Same, ...]
    cycle: int
    before: float
    period: float
    times: _Same | None


@lru_cache(maxsize=64)
def _driving(given: _Given, substeps: int, method: str) -> Driving:
    cycle, before = given.cycle, given.before
    lead, samples, others = cycle, given.u.array, [x.array for x in given.further]
    if cycle:
        samples, *others = (np.concatenate([x[:cycle], x]) for x in (samples, *others))
    elif method in WITH_BREAKS and starts_with_jump(samples, before):
        lead, samples = 1, np.concatenate([[before], samples])
        others = [np.concatenate([x[:1], x]) for x in others]
    counts = substep_counts(samples, before, substeps)
    for x in others:
        counts = np.maximum(counts, substep_counts(x, float(x[0]), substeps))
    counts, clock, lengths = made_periodic(counts, cycle), None, np.ones(counts.size)
    if given.times is not None:
        t = given.times.array
        clock = np.concatenate([-np.arange(lead, 0.0, -1.0), t * (t.size - 1) / t[-1]])
        lengths = np.diff(clock)
        # As many steps in a unit of time, whatever the intervals.
        counts = counts * np.maximum(np.rint(lengths / np.median(lengths)), 1.0).astype(np.int64)
    command = Reconstruction(samples, counts, method, clock=clock)
    means = np.zeros((int(counts.sum()), len(others)))
    for k, x in enumerate(others):
        means[:, k] = mean_input(substep_input(x, counts, method, clock=clock))
    means.flags.writeable = False
    group = _shared(command.breaks.jumps, cycle, given.period, samples.size)
    if group.max(initial=-1) + 1 < group.size:
        # Jumps that share an instant have to mean the same by it.
        command = replace(command, sharp=True)
    return Driving(counts, lead, command, means, group, lengths)


def _shared(jumps: NDArray[np.int64], cycle: int, period: float, samples: int) -> NDArray[np.int64]:
    """(J,) numbers of the instants: those of one phase of the cycle share one, and all do where there are many."""
    whole = round(period)
    if cycle:
        jumps = jumps % cycle
    elif whole and abs(period - whole) * samples / period < _WHOLE:
        jumps = jumps % whole
    group = np.unique(jumps, return_inverse=True)[1].astype(np.int64)
    return group if group.max(initial=-1) < _ALONE else np.zeros_like(group)


def unknown_instants(recording: Recording) -> Array:
    """(G,) present values of the instants that are to be estimated."""
    return driving_of(recording, 1).instants(recording)


def input_before(recording: Recording, samples: Array) -> float:
    """The input before the first sample; the first sample itself where the start does not say."""
    return recording.start.input_before if recording.start.state == "rest" else float(samples[0])


def made_periodic(x: Any, cycle: int) -> Any:
    """(n, …) quantities of the steps of a simulation, the first cycle replaced by the second, which is periodic.

    A recording of one cycle lacks the last interval of its second cycle, but there the first is periodic too.
    """
    return np.concatenate([x[cycle : 2 * cycle], x[min(cycle, x.shape[0] - cycle) :]]) if cycle else x
