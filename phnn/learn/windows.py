"""Recordings cut into windows: what a solver integrates at once.

A window of samples ``[first, last]`` shares its last sample with the first of the next one. Only the displacement is
measured; charges and momentum are hidden. So the state at the beginning of a window is estimated beside the
parameters, except where the recording begins at rest without input, which is the zero state of every model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from phnn.errors import InputRefused
from phnn.recordings.driving import input_before
from phnn.recordings.recording import Part, Recording
from phnn.signals.reconstruct import substep_counts, substep_input


@dataclass(frozen=True, eq=False)
class Window:
    """A stretch of a recording.

    Attributes:
        recording: its index; name: its name; first, last: its first and last sample.
        start: time of the first sample [s].
        fine: (n, 3) input at the start, middle and end of every step [V].
        h: (n,) steps [s].
        nodes: (last − first + 1,) step index of every sample, the first 0.
        known: begins at the zero state.
        continues: whether the window before it belongs to the same recording.
    """

    recording: int
    name: str
    first: int
    last: int
    start: float
    fine: Tensor
    h: Tensor
    nodes: Tensor
    known: bool
    continues: bool

    @property
    def times(self) -> Tensor:
        """(n+1,) time of the nodes of the steps [s]."""
        return self.start + torch.cat([self.h.new_zeros(1), self.h.cumsum(0)])

    @property
    def mean(self) -> Tensor:
        """(n,) mean inputs of the steps, by Simpson's rule."""
        return (self.fine[:, 0] + 4.0 * self.fine[:, 1] + self.fine[:, 2]) / 6.0


def thinned(recording: Recording, stride: int) -> Recording:
    """Every ``stride``-th sample of a recording, its noise and its parts as they are.

    Raises:
        InputRefused: too few samples would be left.
    """
    if stride == 1:
        return recording
    if recording.t.size < 8 * stride:
        raise InputRefused(
            f"stride = {stride} leaves {recording.t.size // stride} samples of {recording.name}: lower it"
        )
    parts = tuple(replace(p, first=-(-p.first // stride), last=-(-p.last // stride)) for p in recording.parts)
    return replace(
        recording.only(slice(None, None, stride)),
        parts=tuple(Part(p.name, p.first, p.last, p.use) for p in parts),
    )


def starts_at_zero(recording: Recording) -> bool:
    """Whether a recording begins at rest without input."""
    return recording.start.state == "rest" and recording.start.input_before == 0.0


def windows_of(recordings: Sequence[Recording], length: int, substeps: int) -> list[Window]:
    """The windows of recordings, in order.

    Args:
        length: samples of a window, 0 for whole recordings.
        substeps: steps a sample interval; more of them follow a jump of the input.
    """
    return [w for i, r in enumerate(recordings) for w in _windows(i, r, length, substeps)]


def _windows(index: int, recording: Recording, length: int, substeps: int) -> list[Window]:
    counts = substep_counts(recording.u, input_before(recording, recording.u), substeps)
    fine = substep_input(recording.u, counts, recording.interpolation, clock=recording.clock)
    h = np.repeat((recording.dt if recording.clock is None else np.diff(recording.t)) / counts, counts)
    nodes = np.concatenate([[0], np.cumsum(counts)])
    intervals = recording.t.size - 1
    pieces = 1 if length == 0 else max(1, round(intervals / (length - 1)))
    edges = np.linspace(0, intervals, pieces + 1).round().astype(int)
    found = []
    for first, last in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        steps = slice(nodes[first], nodes[last])
        found.append(
            Window(
                index, recording.name, first, last, float(recording.t[first]), torch.from_numpy(fine[steps].copy()),
                torch.from_numpy(h[steps].copy()), torch.from_numpy(nodes[first : last + 1] - nodes[first]),
                first == 0 and starts_at_zero(recording), first > 0,
            )
        )  # fmt: skip
    return found
