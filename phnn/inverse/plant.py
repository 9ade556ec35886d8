"""The complete model backwards and forwards, at one sampling interval."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.inverse.amplifier import command, command_at_rest
from phnn.inverse.flat import FlatNetwork
from phnn.inverse.limits import limited
from phnn.inverse.options import InverseOptions
from phnn.inverse.path import path_through
from phnn.inverse.sensor import displacement
from phnn.inverse.signal import Signal, reachable
from phnn.recordings.recording import unrecorded
from phnn.setup import Setup
from phnn.simulate import simulate

Array = NDArray[np.float64]

_FORCE = "the force that the voltage can give"


class Attempt(NamedTuple):
    """Attributes:
    command: (N,) at the samples [V], and where it is not what was asked for.
    before: the command before the first sample [V].
    output: (N,) of the complete model under it [m].
    """

    command: Signal
    before: float
    output: Array


@dataclass(frozen=True)
class Plant:
    """A model that is to follow references.

    Attributes:
        setup: the model; substeps: integration steps in an interval; dt: interval of the samples [s].
        options: limits, and what the command does between its samples.
    """

    setup: Setup
    substeps: int
    dt: float
    options: InverseOptions

    @cached_property
    def network(self) -> FlatNetwork:
        """The inverse of the network."""
        return FlatNetwork(self.setup)

    def backwards(self, output: Array, known: Array | None = None) -> tuple[Signal, float, Array]:
        """The command for an output (N,), whatever its limits.

        Args:
            known: (n+1,) port voltage at the nodes for nearly the same output.

        Returns:
            The command at the samples [V], the one before them, and the port voltage at the nodes.
        """
        q = displacement(self.setup, reachable(output), self.dt, strict=known is None)
        path = path_through(q.values, self.dt, self.substeps)
        port = self.network.voltage(path, known)
        moved = Signal(path.q, np.repeat(q.lost, self.substeps)[: path.q.size], q.causes)
        asked = command(self.setup, moved.then(port.x, port.missed != 0.0, _FORCE), path.h)
        before = command_at_rest(self.setup, self.network.at_rest(float(q.values[0]))[0])
        return self._sampled(asked), before, port.x

    def forwards(self, asked: Signal, before: float) -> Attempt:
        """Simulate the model under a command within its limits."""
        if self.options.limits is not None:
            before = float(np.clip(before, *self.options.limits))
        kept = limited(asked, before, self.dt, self.options)
        t = self.dt * np.arange(kept.values.size)
        recording = unrecorded("inverse", t, kept.values, self.options.hold, before)
        return Attempt(kept, before, np.asarray(simulate(self.setup, recording, self.substeps).y))

    def _sampled(self, asked: Signal) -> Signal:
        """A signal at the nodes, at the samples: its value there, or its mean while a sample is held."""
        n = self.substeps
        if self.options.hold == "cubic":
            return Signal(asked.values[::n], asked.lost[::n], asked.causes)
        means = (0.5 * (asked.values[1:] + asked.values[:-1])).reshape(-1, n).mean(axis=1)
        lost = asked.lost[:-1].reshape(-1, n).any(axis=1)
        return Signal(np.append(means, asked.values[-1]), np.append(lost, asked.lost[-1]), asked.causes)
