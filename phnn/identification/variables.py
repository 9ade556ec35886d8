"""The vector that a fit moves: coordinates of parameters, scaled initial states, instants of jumps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from phnn.errors import SolverFailed
from phnn.identification.plan import Plan
from phnn.passage import is_displacement
from phnn.recordings.driving import unknown_instants
from phnn.recordings.recording import Recording
from phnn.setup import Setup
from phnn.trajectory import Trajectory, simulate

# A recording that begins in the middle of an operation has been moving before. Its state is then most likely one that
# the model passes through whenever the input has the same value and moves the same way, once what it was at first is
# forgotten: the later part of a simulation on the recording's own input shows these states.

# Inputs nearer than this, as a share of the input's range, count as the same value.
_NEAR = 0.1
# What comes before this share of a recording may still hold what the simulation began with.
_FORGOTTEN = 0.2
# With fewer such samples all of the recording's states come into question.
_FEWEST = 5
# Least spread, as a share of the range of a state: history may have been another than the recording's own input.
_LEAST = 0.2
# Spread of an initial displacement that was recorded, as a share of its range.
_RECORDED = 1e-4


@dataclass(frozen=True)
class Expected:
    """A normal distribution of the initial state, its states independent.

    Attributes:
        mean, spread: (N,) its mean and standard deviations, in the units of the states.
    """

    mean: Array
    spread: Array


def expected_start(trajectory: Trajectory, scales: Array) -> Expected:
    """The distribution of the state in which a recording begins.

    Args:
        trajectory: of the recording, from rest.
        scales: (N,) range of every state, which is not zero.
    """
    states = trajectory.states[trajectory.nodes[trajectory.lead :]]
    u = trajectory.recording.u
    way = np.sign(np.gradient(u)) if u.size > 1 else np.zeros(1)
    alike = (np.abs(u - u[0]) <= _NEAR * np.ptp(u)) & (way == way[0])
    alike[: int(_FORGOTTEN * u.size)] = False
    met = states[alike] if alike.sum() >= _FEWEST else states
    mean = met.mean(axis=0) if alike.sum() >= _FEWEST else states[0].copy()
    spread = np.maximum(met.std(axis=0), _LEAST * scales)
    place = trajectory.program.travel
    if place >= 0 and is_displacement(trajectory.setup, trajectory.recording):
        # Where the imposed motion begins was recorded.
        mean[place], spread[place] = states[0, place], _RECORDED * scales[place]
    return Expected(mean, spread)


Array = NDArray[np.float64]

# Standard deviations: an initial state that is farther off than that takes the place of physics that the model lacks.
_FARTHEST, _ROUNDING = 20.0, 1.0 + 1e-9


@dataclass(frozen=True)
class Variables:
    """The vector an optimiser moves: estimation coordinates ``z`` of parameters, scaled initial states, instants.

    Attributes:
        names: parameters.
        unknown: names of the recordings whose initial state is estimated.
        scales: (L+1,) typical size of each state.
        origin: initial states to which the scaled changes are added, by recording; those of other recordings are held.
        instants: (G,) starting values of the instants of jumps, in sample intervals, by recording.
        expected: what is known of an initial state before its samples are seen, by recording.
    """

    names: tuple[str, ...]
    unknown: tuple[str, ...]
    scales: Array
    origin: Mapping[str, Array]
    instants: Mapping[str, Array] = field(default_factory=dict)
    expected: Mapping[str, Expected] = field(default_factory=dict)

    def start(self, setup: Setup) -> Array:
        """``z`` of a setup, initial states at their origin."""
        parameters = setup.parameters
        z = [parameters[n].to_coordinate(parameters[n].value) for n in self.names]
        states = np.zeros(len(self.unknown) * self.scales.size)
        return np.concatenate([z, states, *self.instants.values()])

    def bounds(self, setup: Setup) -> tuple[Array, Array]:
        """Bounds declared on the parameters; initial states are free; a jump stays within its sample interval."""
        pairs = [setup.parameters[n].coordinate_bounds for n in self.names]
        free = np.full(len(self.unknown) * self.scales.size, np.inf)
        within = np.ones(sum(x.size for x in self.instants.values()))
        lower = np.concatenate([[p[0] for p in pairs], -free, 0.0 * within])
        return lower, np.concatenate([[p[1] for p in pairs], free, within])

    def setup(self, template: Setup, z: Array) -> Setup:
        """The setup at ``z``."""
        parameters = template.parameters
        values = {}
        for n, c in zip(self.names, z[: len(self.names)], strict=True):
            p = parameters[n]
            values[n] = float(np.clip(p.from_coordinate(float(c)), p.lower, p.upper))
        return template.with_values(values)

    def initial(self, recording: Recording, z: Array) -> Array | None:
        """Initial state of a recording at ``z``; None where its start says it."""
        if recording.name not in self.unknown:
            return self.origin.get(recording.name)
        return self.origin[recording.name] + z[self._states_of(recording.name)] * self.scales

    def prior(self, z: Array) -> Array:
        """(P, K+1) derivatives of ``(x₀ − mean)/spread`` of every estimated initial state by ``z``, and these numbers
        themselves: rows beside those of the samples."""
        size = self.scales.size
        rows = np.zeros((len(self.unknown) * size, z.size + 1))
        for i, name in enumerate(self.unknown):
            first, known = len(self.names) + i * size, self.expected[name]
            mine = slice(i * size, (i + 1) * size)
            rows[mine, first : first + size] = np.diag(self.scales / known.spread)
            state = self.origin[name] + z[first : first + size] * self.scales
            rows[mine, -1] = (state - known.mean) / known.spread
        return rows

    def can_begin(self, z: Array) -> bool:
        """Whether initial states lie within `_FARTHEST` of what is expected, or no farther off than their origin."""
        for name in self.unknown:
            known, origin = self.expected[name], self.origin[name]
            state = origin + z[self._states_of(name)] * self.scales
            most = np.maximum(_FARTHEST * known.spread, np.abs(origin - known.mean))
            if (np.abs(state - known.mean) > most * _ROUNDING).any():
                return False
        return True

    def timed(self, recording: Recording, z: Array) -> Recording:
        """The recording with the instants of its jumps at ``z``."""
        if recording.name not in self.instants:
            return recording
        return replace(recording, instants=np.clip(z[self._instants_of(recording)], 0.0, 1.0))

    def columns(self, setup: Setup, recording: Recording, derivatives: Array) -> Array:
        """Derivatives by parameters, instants and initial states of a recording put into their places in ``z``."""
        count = len(self.names)
        slopes = np.array([setup.parameters[n].slope(setup.parameters[n].value) for n in self.names])
        if not self.unknown and not self.instants:
            return np.asarray(derivatives * slopes)
        out = np.zeros((derivatives.shape[0], self.start(setup).size))
        out[:, :count] = derivatives[:, :count] * slopes
        if recording.name in self.instants:
            own = self.instants[recording.name].size
            out[:, self._instants_of(recording)] = derivatives[:, count : count + own]
        if recording.name in self.unknown:
            out[:, self._states_of(recording.name)] = (
                derivatives[:, derivatives.shape[1] - self.scales.size :] * self.scales
            )
        return out

    def _states_of(self, name: str) -> slice:
        first = len(self.names) + self.unknown.index(name) * self.scales.size
        return slice(first, first + self.scales.size)

    def _instants_of(self, recording: Recording) -> slice:
        first = len(self.names) + len(self.unknown) * self.scales.size
        for name, values in self.instants.items():
            if name == recording.name:
                return slice(first, first + values.size)
            first += values.size
        raise KeyError(recording.name)


def variables_of(setup: Setup, plan: Plan, names: Sequence[str]) -> Variables:
    """The variables of a fit: the named parameters, initial states where a start is unknown, instants of jumps."""
    instants = {r.name: x for r in plan.recordings if (x := unknown_instants(r)).size}
    unknown = [r for r in plan.recordings if starts_unknown(r)]
    if not unknown:
        return Variables(tuple(names), (), np.zeros(0), {}, instants)
    trajectories = {r.name: _first_guess(setup, r, plan.steps_of(r)) for r in unknown}
    spread = np.max([np.ptp(t.states, axis=0) for t in trajectories.values()], axis=0)
    scales = np.where(spread > 0.0, spread, 1.0)
    expected = {n: expected_start(t, scales) for n, t in trajectories.items()}
    origin = {n: e.mean for n, e in expected.items()}
    return Variables(tuple(names), tuple(trajectories), scales, origin, instants, expected)


def _first_guess(setup: Setup, recording: Recording, substeps: int) -> Trajectory:
    """A simulation from rest under the first input; from nothing stored where that input lets nothing rest."""
    try:
        return simulate(setup, recording, substeps)
    except SolverFailed:
        return simulate(setup, recording, substeps, initial=np.zeros(len(setup.network.state_names)))


def starts_unknown(recording: Recording) -> bool:
    """Whether the initial state of a recording has to be estimated."""
    return recording.start.state == "unknown" or aperiodic(recording)


def aperiodic(recording: Recording) -> bool:
    """Whether a recording is said to start in a steady cycle of which it holds no whole one: its start is unknown."""
    return recording.start.state == "periodic" and not recording.cycle
