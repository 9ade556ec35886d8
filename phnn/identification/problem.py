"""The weighted residual of a setup on a campaign, and its derivatives.

    r = (y − ŷ(θ) − zero − nuisances) / σ     over the samples of one use, recording by recording

The displacement zero and the nuisances of the setup (lines, slow drift) enter linearly; they are projected out of
residual and derivatives (variable projection), so that no optimiser sees them. Initial states of recordings with an
unknown start are variables beside ``θ``, and so are the instants at which an input jumps between two samples. An
initial state has a prior, see `expected_start`: what the samples do not show of it stays near to what the
model knows of its own motion. Samples at a limit of the sensor are censored.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.derivatives import output_derivatives
from phnn.errors import SolverFailed
from phnn.identification.plan import Plan
from phnn.integrate.kernel import work_of
from phnn.integrate.program import compile_network
from phnn.recordings.excitation import unknown_instants
from phnn.recordings.recording import Recording, dominant_frequency
from phnn.setup import NOTHING, Own, Setup
from phnn.signals.least_squares import triangle
from phnn.trajectory import Trajectory, is_displacement, simulate

Array = NDArray[np.float64]

# Directions weaker than this share of the strongest are rounding: two lines that one part cannot tell apart.
_RANK = 1e-9


def line_columns(recording: Recording, frequencies: Sequence[float]) -> Array:
    """Return (N, 2L) cosine and sine of every line at the samples of a recording.

    Left out are lines at or above the Nyquist frequency, which look like other ones, and lines with less than one
    period in the recording, which look like a zero that moves.

    Args:
        frequencies: of the lines [Hz].
    """
    held = _held(recording, frequencies)
    phase = 2.0 * np.pi * np.outer(recording.t, held)
    return np.stack([np.cos(phase), np.sin(phase)], axis=-1).reshape(recording.t.size, 2 * len(held))


def _held(recording: Recording, frequencies: Sequence[float]) -> list[float]:
    """Return the lines that a recording can hold."""
    duration = recording.t.size * recording.dt
    return [f for f in dict.fromkeys(frequencies) if 1.0 / duration <= f < 0.5 / recording.dt]


def drift_columns(recording: Recording, count: int) -> Array:
    """Return (N, C) drift basis: half-cosines ``cos(πmt/T)`` over a recording, ``m = 1, …``, at most ``count``.

    All are slower than the input, if there is one: a faster drift cannot be told from a response.
    """
    duration, orders = recording.t.size * recording.dt, np.arange(1, _slow(recording, count) + 1)
    return np.asarray(np.cos(np.pi / duration * np.outer(recording.t - recording.t[0], orders)))


def _slow(recording: Recording, count: int) -> int:
    """Return the number of half-cosines, at most ``count``, that are slower than the input of a recording."""
    if not count or not np.ptp(recording.u) > 0.0:
        return count
    duration = recording.t.size * recording.dt
    return min(count, max(math.ceil(2.0 * dominant_frequency(recording) * duration - 1e-6) - 1, 1))


def own_columns(recording: Recording, nuisances: Own) -> Array:
    """Return (N, K) basis of all nuisances of a recording but its zero."""
    return np.hstack([line_columns(recording, nuisances.lines), drift_columns(recording, nuisances.drift_terms)])


def own_size(recording: Recording, nuisances: Own) -> int:
    """Return the number of these columns."""
    return 2 * len(_held(recording, nuisances.lines)) + _slow(recording, nuisances.drift_terms)


def without_nuisances(
    values: Array, mask: NDArray[Any], recording: Recording, nuisances: Own = NOTHING,
    hidden: NDArray[np.bool_] | None = None,
) -> Array:  # fmt: skip
    """Return the masked rows of (N, …) without their mean and nuisances.

    The mean stays where the zero of the output is a parameter that recordings share.

    Args:
        hidden: (N,) samples of no weight, see `phnn.identification.problem.beyond_limit`; their rows are zero.
    """
    if hidden is not None and hidden.any():
        counted = mask & ~hidden
        out = np.zeros((int(mask.sum()), *values.shape[1:]))
        out[counted[mask]] = without_nuisances(values, counted, recording, nuisances)
        return out
    inside = values[mask]
    if inside.size and recording.offset == "own":
        inside -= inside.mean(axis=0)
    if nuisances == NOTHING or not inside.size:
        return inside
    basis = _own_basis(recording, nuisances, mask.tobytes())
    return np.asarray(inside - basis @ (basis.T @ inside))


@lru_cache(maxsize=32)
def _own_basis(recording: Recording, nuisances: Own, mask: bytes) -> Array:
    """Return the orthonormal basis of the nuisances on the masked rows, without their means; cached for all models."""
    columns = own_columns(recording, nuisances)[np.frombuffer(mask, dtype=bool)]
    if not columns.size:
        return np.zeros((columns.shape[0], 0))
    left_vectors, size, _ = np.linalg.svd(columns - columns.mean(axis=0), full_matrices=False)
    return np.asarray(left_vectors[:, size > _RANK * np.sqrt(columns.shape[0])])


def constant_and_own(error: Array, rows: NDArray[np.bool_], recording: Recording, nuisances: Own) -> Array:
    """(N,) zero and nuisances of a recording, fitted to some rows of an error (N,); zero where there are no rows."""
    zero = float(recording.offset == "own")
    if not rows.any():
        return np.zeros(error.size)
    if nuisances == NOTHING:
        return np.full(error.size, zero * error[rows].mean())
    columns = np.column_stack([np.full(recording.t.size, zero), own_columns(recording, nuisances)])
    return np.asarray(columns @ np.linalg.lstsq(columns[rows], error[rows], rcond=_RANK)[0])


def own_parts(error: Array, rows: slice, recording: Recording, nuisances: Own) -> Array:
    """Return (M,) the nuisances in some rows of an error (N,), fitted to these very rows beside a constant."""
    columns = np.column_stack([np.ones(recording.t.size), own_columns(recording, nuisances)])[rows]
    coefficients = np.linalg.lstsq(columns, error[rows], rcond=_RANK)[0]
    return np.asarray(columns[:, 1:] @ coefficients[1:])


Rows = NDArray[np.bool_]

# Rounds after which the samples that count are taken as they are; two or three settle them.
_ROUNDS = 30


def beyond_limit(recording: Recording, y: Array, mask: NDArray[Any], nuisances: Own = NOTHING) -> Rows | None:
    """Return (N,) which masked samples sit at a limit while the model lies beyond it; None where none sits at a limit.

    Args:
        y: (N,) the model's output without zero and nuisances.
        mask: (N,) the samples that are scored.
    """
    if not recording.sensor.is_limited:
        return None
    side = recording.sensor.at_limit(recording.y)
    at_limit = (side != 0) & mask
    if not at_limit.any():
        return None
    error, hidden = recording.y - y, at_limit
    for _ in range(_ROUNDS):
        residual = error - constant_and_own(error, mask & ~hidden, recording, nuisances)
        now = at_limit & (side * residual <= 0.0)
        if np.array_equal(now, hidden):
            break
        hidden = now
    return hidden


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
    """Return the distribution of the state in which a recording begins.

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
    place = trajectory.travel
    if place >= 0 and is_displacement(trajectory.setup, trajectory.recording):
        # Where the imposed motion begins was recorded.
        mean[place], spread[place] = states[0, place], _RECORDED * scales[place]
    return Expected(mean, spread)


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
        """Return ``z`` of a setup, initial states at their origin."""
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
        """Return the setup at ``z``."""
        parameters = template.parameters
        values = {}
        for n, c in zip(self.names, z[: len(self.names)], strict=True):
            p = parameters[n]
            values[n] = float(np.clip(p.from_coordinate(float(c)), p.lower, p.upper))
        return template.with_values(values)

    def initial(self, recording: Recording, z: Array) -> Array | None:
        """Return the initial state of a recording at ``z``; None where its start says it."""
        if recording.name not in self.unknown:
            return self.origin.get(recording.name)
        return self.origin[recording.name] + z[self._states_of(recording.name)] * self.scales

    def prior(self, z: Array) -> Array:
        """Return (P, K+1) derivatives of ``(x₀ − mean)/spread`` of every estimated initial state by ``z``, and these
        numbers themselves: rows beside those of the samples."""
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
        """Return the recording with the instants of its jumps at ``z``."""
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
            instant_count = self.instants[recording.name].size
            out[:, self._instants_of(recording)] = derivatives[:, count : count + instant_count]
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
    # A state that nothing moves may begin anywhere in the range of the output.
    scales = np.where(spread > 0.0, spread, max(1.0, *(float(np.ptp(r.y)) for r in unknown)))
    expected = {n: expected_start(t, scales) for n, t in trajectories.items()}
    origin = {n: e.mean for n, e in expected.items()}
    return Variables(tuple(names), tuple(trajectories), scales, origin, instants, expected)


def _first_guess(setup: Setup, recording: Recording, substeps: int) -> Trajectory:
    """Return a simulation from rest under the first input; from nothing stored where that input lets nothing rest."""
    try:
        return simulate(setup, recording, substeps)
    except SolverFailed:
        return simulate(setup, recording, substeps, initial=np.zeros(len(setup.network.state_names)))


def starts_unknown(recording: Recording) -> bool:
    """Whether the initial state of a recording is to be estimated, as of a cycle of which it holds no whole one."""
    return recording.start.state == "unknown" or (recording.start.state == "periodic" and not recording.cycle)


_FAILED = 1e6
# Simulations that take about as long as the derivatives of one by a variable, and by a few of them.
_DERIVATIVE, _FEW = 0.5, 4.0
# Weight of the present value of an instant, where the output of a seen jump weighs hundreds.
_WEAK = 1e-3


class Problem:
    """Residual and Jacobian for `scipy.optimize.least_squares`.

    The last trajectories and the last derivatives are kept: an optimiser ends where it has been, and what it found is
    asked for once more there.
    """

    def __init__(self, template: Setup, plan: Plan, variables: Variables, use: str = "identification") -> None:
        self.template = template
        self.plan = plan
        self.variables = variables
        self.use = use
        self.masks = [r.mask(use) for r in plan.recordings]
        timed = sum(x.size for x in variables.instants.values())
        self._work = work_of(compile_network(template.network))
        self._weak = np.append(
            np.zeros(len(variables.names) + len(variables.unknown) * variables.scales.size), np.full(timed, _WEAK)
        )
        self._marched: tuple[bytes | None, list[Trajectory]] = (None, [])
        self._differentiated: tuple[bytes | None, list[Array]] = (None, [])

    def trajectories(self, z: Array) -> list[Trajectory]:
        """Return the simulations at ``z``."""
        if self._marched[0] != z.tobytes():
            setup = self.variables.setup(self.template, z)

            def run(recording: Recording) -> Trajectory:
                initial, timed = self.variables.initial(recording, z), self.variables.timed(recording, z)
                return simulate(setup, timed, self.plan.steps_of(recording), initial=initial)

            self._marched = z.tobytes(), self.plan.each(run, simulations=self._work)
        return self._marched[1]

    def residual(self, z: Array) -> Array:
        """Return (N,) weighted residual."""
        if self._differentiated[0] == z.tobytes():
            return np.concatenate([both[:, -1] for both in self._differentiated[1]])
        trajectories = self.trajectories(z)
        return np.concatenate([weighted_residual(t, m) for t, m in zip(trajectories, self.masks, strict=True)])

    def jacobian(self, z: Array) -> Array:
        """Return (N, K) derivatives of the residual by ``z``."""
        return np.concatenate([both[:, :-1] for both in self._with_derivatives(z)])

    def size(self, z: Array) -> Array:
        """Return (K+1,) the residual turned into the last of a few coordinates, where `slopes` are its derivatives.

        If an optimiser needs only products of the two, a step is evaluated without sensitivities.
        """
        turned = np.zeros(z.size + 1)
        length = self._length(z) if self.variables.can_begin(z) else np.inf
        # The optimiser needs numbers: what cannot be, or cannot be simulated, is far from any optimum.
        turned[-1] = length if np.isfinite(length) else _FAILED * np.sqrt(self.samples)
        return turned

    def _length(self, z: Array) -> float:
        """Return the root of the sum of squares of residual and prior; infinite where ``z`` cannot be simulated."""
        try:
            return float(np.hypot(np.linalg.norm(self.residual(z)), np.linalg.norm(self.variables.prior(z)[:, -1])))
        except SolverFailed:
            return np.inf

    def slopes(self, z: Array) -> Array:
        """(K+1, K) the Jacobian in the coordinates of `size`: the same gradient and normal matrix in a small square.

        Factored recording by recording and then together, so that no tall matrix is ever assembled.
        """
        squares = self.plan.each(lambda _, both: triangle(both), self._with_derivatives(z))
        # A jump outside the samples that are fitted has no derivative; an optimiser crawls on a singular matrix.
        stacked = np.concatenate([*squares, self.variables.prior(z), np.diag(np.append(self._weak, 0.0))])
        square = triangle(stacked)
        if not np.isfinite(square).all():
            raise SolverFailed("the derivatives of the output are not finite; narrow the bounds of the parameters")
        # A reflection takes the residual's column to the last axis; from its far side, or else digits would cancel.
        square[-1, -1] = -abs(square[-1, -1])
        normal, slopes = square[:, -1] - self.size(z), square[:, :-1]
        length = float(normal @ normal)
        return slopes - np.outer(normal, 2.0 / length * (normal @ slopes)) if length > 0.0 else slopes

    @property
    def samples(self) -> int:
        """Return how many samples are scored."""
        return sum(int(m.sum()) for m in self.masks)

    def _with_derivatives(self, z: Array) -> list[Array]:
        """Return (N_r, K+1) derivatives of the residual of every recording, and the residual."""
        if self._differentiated[0] != z.tobytes():
            trajectories, setup = self.trajectories(z), self.variables.setup(self.template, z)
            plan = self.plan.derived(setup)

            def one(sparse: Recording, recording: Recording, trajectory: Trajectory, mask: Array) -> Array:
                initial = range(self.variables.scales.size) if recording.name in self.variables.unknown else ()
                instants = recording.name in self.variables.instants
                near = trajectory
                if sparse is not recording:
                    near = simulate(setup, sparse, plan.steps_of(sparse), initial=self.variables.initial(recording, z))
                raw = output_derivatives(near, self.variables.names, tuple(initial), instants=instants)
                columns = self.variables.columns(setup, recording, recording.from_sparse(raw))
                both = np.column_stack([columns, trajectory.y - recording.y])
                hidden = beyond_limit(recording, trajectory.y, mask, setup.own)
                inside = without_nuisances(both, mask, recording, setup.own, hidden)
                inside /= -recording.noise
                return inside

            count = self._work * max(_FEW, _DERIVATIVE * z.size)
            both = plan.each(one, self.plan.recordings, trajectories, self.masks, simulations=count)
            self._differentiated = z.tobytes(), both
        return self._differentiated[1]


def weighted_residual(trajectory: Trajectory, mask: Array) -> Array:
    """Return ``(y − ŷ)/σ`` on the masked samples without what zero and nuisances explain."""
    recording = trajectory.recording
    error, nuisances = recording.y - trajectory.y, trajectory.setup.own
    hidden = beyond_limit(recording, trajectory.y, mask, nuisances)
    return without_nuisances(error, mask, recording, nuisances, hidden) / recording.noise
