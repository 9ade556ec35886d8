"""The location of the mismatch: whose local variables predict the residual of recordings that were left out.

A dictionary holds generic local functions: what a missing element at a location could do, without naming any. Every
group belongs to a location and a kind of element. Its functions use only variables that are local to it (powers of
``q`` at a spring, functions of ``v`` at a damper, …), evaluated on the simulated base trajectory. They enter as a force
on the junction, as a change of the port's voltage, of a parameter, or at the output.

For every location the residual of some recordings is regressed (ridge) on the responses to the location's
local functions, base sensitivities free beside them; the fit then predicts the residual of the others. The
score is the share of the explainable residual that is predicted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.derivatives import input_force, output_derivatives
from phnn.diagnose.linearised import LinearisedFit
from phnn.diagnose.lines import drift_share, line_share
from phnn.effects import Kind, Scales, kinds
from phnn.integrate.cache import entry
from phnn.network.elements import Network
from phnn.network.roles import capacitances, charges, dampings, hysterons, ratios, thresholds
from phnn.recordings.driving import input_before
from phnn.simulate import Trajectory

Array = NDArray[np.float64]

# Damping ratio of modes at the peaks of the residual's spectrum.
_RATIO = 0.01
# Ridges of a regression; stretches of time that are left out in turn where there is one recording.
_RIDGES, _FOLDS = (1e-6, 1e-4, 1e-2, 1e-1, 1.0), 6
# Locations whose shares differ by less explain a residual equally well. No other recording can test a slow drift, whose
# coefficients are free: its share counts less where locations are compared.
_TIED, _DRIFT_WEIGHT = 0.03, 0.7
FORCE, VOLTAGE, OUTPUT, PARAMETER = "force", "voltage", "output", "parameter"


@entry
def low_pass(x: Any, h: Any, tau: Any, before: Any) -> Any:
    """Return a first-order low-pass of ``x`` with time constant ``tau`` and steps ``h``, in equilibrium at ``before``
    when it begins."""
    out, state = np.empty_like(x), before
    for n in range(x.size):
        state += (x[n] - state) * (1.0 - np.exp(-h[n] / tau))
        out[n] = state
    return out


@entry
def rate_limited(x: Any, h: Any, limit: Any, before: Any) -> Any:
    """Return ``x`` followed at a rate of at most ``limit``, with steps ``h``, from ``before``."""
    out, state = np.empty_like(x), before
    for n in range(x.size):
        state += min(max(x[n] - state, -limit * h[n]), limit * h[n])
        out[n] = state
    return out


@entry
def play_operator(x: Any, radius: Any) -> Any:
    """Return the play (backlash) of half-width ``radius`` from the virgin state."""
    out, state = np.empty_like(x), 0.0
    for n in range(x.size):
        state = min(max(state, x[n] - radius), x[n] + radius)
        out[n] = state
    return out


@entry
def integral_while_within(x: Any, h: Any, limit: Any) -> Any:
    """Return the integral of ``x`` since its magnitude last reached a limit."""
    out, state = np.empty_like(x), 0.0
    for n in range(x.size):
        state = state + h[n] * x[n] if abs(x[n]) < limit else 0.0
        out[n] = state
    return out


def resonator(x: Array, h: Array, frequency: float, ratio: float) -> Array:
    """Return (N, 2) the two states of an oscillator that a signal drives, in phase and in quadrature, from rest.

    ``ż = λ (z − x)``, ``λ = ω (−ζ + i √(1 − ζ²))``: real and imaginary part of ``z``.

    Args:
        frequency: undamped, ``ω / 2π``; ratio: of damping, ``ζ``.
    """
    tau = (ratio + 1j * np.sqrt(1.0 - ratio**2)) / (2.0 * np.pi * frequency)
    z = low_pass(x.astype(np.complex128), h, tau, 0j)
    return np.column_stack([z.real, z.imag])


def rate(x: Array, h: Array) -> Array:
    """Return the derivative of a signal known at the mid-points of the steps."""
    middle = np.concatenate([[0.0], np.cumsum(h)])
    middle = 0.5 * (middle[1:] + middle[:-1])
    return np.gradient(x, middle) if x.size > 2 else np.zeros_like(x)


@dataclass(frozen=True)
class Group:
    """Local functions of one kind.

    Attributes:
        kind: which kind of element, and at which location.
        enters: `FORCE`, `VOLTAGE` or `OUTPUT`; or `PARAMETER`: the functions scale the parameters that ``varies`` finds
            in a network, as a law or a transformer that is modulated would.
        functions: ``(trajectory, scales) -> (n or N, F)``; zero for zero motion.
        axis: name of the variable against which the learned function is drawn, with its unit; empty where the
            functions have memory and no static picture.
        static: ``x -> (len(x), F)`` the same functions of the axis variable alone.
    """

    kind: Kind
    enters: str
    functions: Callable[[Trajectory, Scales], Array]
    axis: str = ""
    static: Callable[[Array, Scales], Array] | None = None
    varies: Callable[[Network], list[str]] | None = None

    @property
    def location(self) -> str:
        """Canonical location."""
        return self.kind.location

    @property
    def detail(self) -> str:
        """Name of the kind of element."""
        return self.kind.name

    def varied(self, network: Network) -> list[str]:
        """Return the names of the parameters that its functions scale in a network."""
        return self.varies(network) if self.varies is not None else []


def _elastic(q: Array, scales: Scales) -> Array:
    s = q / scales.displacement
    ramps = [np.maximum(side * s - c, 0.0) for side in (1.0, -1.0) for c in (0.0, 0.25, 0.5, 0.7, 0.85)]
    return np.column_stack([s**2, s**3, s**5, *ramps])


def _dissipative(v: Array, scales: Scales) -> Array:
    w = v / scales.velocity
    slow = scales.slowest / scales.fastest
    speeds = (0.03 * slow, 0.3 * slow, 0.03, 0.3)
    return np.column_stack([*(np.tanh(w / c) for c in speeds), np.abs(w) * w, w**3])


def _memory_times(scales: Scales) -> Array:
    return np.geomspace(0.1 / scales.fastest, scales.duration, 8)


def _memory(trajectory: Trajectory, scales: Scales) -> Array:
    s = trajectory.mid_displacement / scales.displacement
    return np.column_stack([s - low_pass(s, trajectory.h, t, float(s[0])) for t in _memory_times(scales)])


def _after_a_step(t: Array, scales: Scales) -> Array:
    return np.column_stack([np.exp(-t / tau) for tau in _memory_times(scales)])


def _modes(trajectory: Trajectory, scales: Scales) -> Array:
    a = _acceleration(trajectory, scales)
    times = 1.0 / (2.0 * np.pi * scales.fastest * np.array([3.0, 10.0]))
    filtered = [low_pass(low_pass(a, trajectory.h, t, 0.0), trajectory.h, t, 0.0) for t in times]
    return np.column_stack([a, *filtered])


def _ringing(trajectory: Trajectory, scales: Scales) -> Array:
    a = _acceleration(trajectory, scales)
    found = [resonator(a, trajectory.h, f, _RATIO) for f in scales.peaks]
    return np.column_stack(found) if found else np.zeros((a.size, 0))


def _acceleration(trajectory: Trajectory, scales: Scales) -> Array:
    return rate(trajectory.velocity, trajectory.h) / (scales.velocity * scales.fastest)


def _by_displacement(q: Array, scales: Scales) -> Array:
    s = q / scales.displacement
    return np.column_stack([s, s**2])


def _by_speed(v: Array, scales: Scales) -> Array:
    w = np.abs(v) / scales.velocity
    return np.column_stack([w, w / (w + 0.05)])


def _hysteron(trajectory: Trajectory, scales: Scales) -> Array:
    s = trajectory.mid_displacement / scales.displacement
    radii = (0.01, 0.03, 0.06, 0.12, 0.25, 0.5)
    stops = [s - play_operator(s, r) for r in radii]
    charged = [trajectory.efforts[:, i] / scales.voltage for i in _electrical_leaves(trajectory)]
    return np.column_stack([*stops, *charged])


def _leakage(trajectory: Trajectory, scales: Scales) -> Array:
    times = np.geomspace(1.0 / scales.fastest, scales.duration, 4)
    network, h = trajectory.setup.network, trajectory.h
    widths = {n: network.parameters[r.parameters[1]].value for r in hysterons(network) for n in r.on}
    columns = []
    for i in _electrical_leaves(trajectory):
        e = trajectory.efforts[:, i] / scales.voltage
        columns += [low_pass(e, h, t, float(e[0])) for t in times]
        # What leaked away while a hysteron held is made up for as soon as it gives way.
        limit = widths.get(network.storages[i].name, np.inf) / scales.voltage
        columns.append(integral_while_within(e, h, limit) / scales.duration)
    return np.column_stack(columns) if columns else np.zeros((trajectory.velocity.size, 0))


def _by_charge(trajectory: Trajectory, scales: Scales) -> Array:
    return np.asarray((trajectory.efforts[:, _electrical_leaves(trajectory)] / scales.voltage) ** 2)


def _electrical_leaves(trajectory: Trajectory) -> list[int]:
    network = trajectory.setup.network
    charged = charges(network)
    return [i for i in trajectory.program.dissipative if network.storages[i].name in charged]


def _coupling(u: Array, scales: Scales) -> Array:
    w = u / scales.voltage
    return np.column_stack([w**2, w**3])


def _lag_times(scales: Scales) -> Array:
    return np.array([0.02, 0.1, 0.4, 2.0, 10.0]) / (2.0 * np.pi * scales.fastest)


def _lag_after_a_step(t: Array, scales: Scales) -> Array:
    return np.column_stack([np.exp(-t / tau) for tau in _lag_times(scales)])


def _command(trajectory: Trajectory, scales: Scales) -> tuple[Array, float]:
    """The input over its scale, and its value before the recording."""
    before = input_before(trajectory.recording, trajectory.recording.u)
    return trajectory.u[:, 0] / scales.voltage, before / scales.voltage


def _amplifier_lag(trajectory: Trajectory, scales: Scales) -> Array:
    u, before = _command(trajectory, scales)
    return np.column_stack([u - low_pass(u, trajectory.h, t, before) for t in _lag_times(scales)])


def _amplifier_limit(u: Array, scales: Scales) -> Array:
    w = u / scales.voltage
    return np.column_stack([np.sign(w) * np.maximum(np.abs(w) - c, 0.0) for c in (0.4, 0.6, 0.75, 0.85, 0.92, 0.97)])


def _amplifier_slew(trajectory: Trajectory, scales: Scales) -> Array:
    u, before = _command(trajectory, scales)
    rates = 2.0 * np.pi * scales.fastest * np.array([0.5, 0.9, 2.0, 10.0])
    return np.column_stack([u - rate_limited(u, trajectory.h, r, before) for r in rates])


def _polarisation(trajectory: Trajectory, scales: Scales) -> Array:
    w = np.abs(trajectory.u[:, 0]) / scales.voltage
    return _slowly(trajectory, scales, *(np.maximum(w - c, 0.0) for c in (0.3, 0.6, 0.85)))


def _warmth(trajectory: Trajectory, scales: Scales) -> Array:
    power = (trajectory.velocity / scales.velocity) ** 2
    return _slowly(trajectory, scales, power)


def _slowly(trajectory: Trajectory, scales: Scales, *driving: Array) -> Array:
    """States that follow what drives them over a good part of the recordings, from none at the start."""
    times = np.geomspace(0.05 * scales.duration, 5.0 * scales.duration, 3)
    return np.column_stack([low_pass(x, trajectory.h, t, 0.0) for x in driving for t in times])


def _sensor_static(q: Array, scales: Scales) -> Array:
    s = q / scales.sensed
    return np.column_stack([s**2, s**3])


def _sensor_memory(trajectory: Trajectory, scales: Scales) -> Array:
    q = trajectory.signal / scales.sensed
    mid = 0.5 * (q[1:] + q[:-1])
    lags = [q - np.append(q[0], low_pass(mid, trajectory.h, t, float(q[0]))) for t in _lag_times(scales)[[0, 2]]]
    samples = trajectory.nodes[trajectory.lead :]
    plays = [q[samples] - play_operator(q[samples], r) for r in (0.002, 0.01, 0.03)]
    return np.column_stack([*(lag[samples] for lag in lags), *plays])


def _sensor_gain(trajectory: Trajectory, scales: Scales) -> Array:
    return _drifts(trajectory.t, scales) * (trajectory.y / scales.sensed)[:, None]


def _sensor_clock(trajectory: Trajectory, scales: Scales) -> Array:
    velocity = np.gradient(trajectory.y, trajectory.t) if trajectory.t.size > 1 else np.zeros_like(trajectory.y)
    return _drifts(trajectory.t, scales) * (velocity / scales.sensed_rate)[:, None]


def _drifts(t: Array, scales: Scales) -> Array:
    x = t / scales.duration
    return np.column_stack([x, x**2])


def _lines(trajectory: Trajectory, scales: Scales) -> Array:
    columns = []
    for line in (50.0, 60.0, 100.0, 120.0):
        if line * 2.2 < 1.0 / trajectory.recording.dt:
            columns += [np.sin(2 * np.pi * line * trajectory.t), np.cos(2 * np.pi * line * trajectory.t)]
        else:
            columns += [np.zeros_like(trajectory.t)] * 2
    return np.column_stack(columns)


def _static(
    kind: Kind,
    enters: str,
    variable: tuple[str, Callable[[Trajectory], Array]],
    law: Callable[[Array, Scales], Array],
    varies: Callable[[Network], list[str]] | None = None,
) -> Group:
    """Return the group of a law of one variable: the name and unit of its axis, and its values along a trajectory."""
    axis, along = variable
    return Group(kind, enters, lambda trajectory, scales: law(along(trajectory), scales), axis, law, varies)


_Q, _V = ("displacement [m]", attrgetter("mid_displacement")), ("velocity [m/s]", attrgetter("velocity"))
_Y, _T = (_Q[0], attrgetter("y")), ("time [s]", attrgetter("t"))
_U = "voltage [V]", lambda trajectory: trajectory.u[:, 0]
_AFTER_A_STEP = "time after a step [s]"

GROUPS = (
    _static(kinds.ELASTIC, FORCE, _Q, _elastic),
    _static(kinds.DISSIPATIVE, FORCE, _V, _dissipative),
    _static(kinds.DAMPING_BY_DISPLACEMENT, PARAMETER, _Q, _by_displacement, dampings),
    Group(kinds.MEMORY, FORCE, _memory, _AFTER_A_STEP, _after_a_step),
    Group(kinds.MODE, FORCE, _modes),
    Group(kinds.RINGING_MODE, FORCE, _ringing),
    Group(kinds.SHAPE, FORCE, _hysteron),
    _static(kinds.THRESHOLD_BY_DISPLACEMENT, PARAMETER, _Q, _by_displacement, thresholds),
    _static(kinds.THRESHOLD_BY_RATE, PARAMETER, _V, _by_speed, thresholds),
    Group(kinds.CAPACITANCE_BY_CHARGE, PARAMETER, _by_charge, varies=capacitances),
    Group(kinds.LEAKAGE, FORCE, _leakage),
    _static(kinds.FORCE_BY_VOLTAGE, FORCE, _U, _coupling),
    _static(kinds.RATIO_BY_DISPLACEMENT, PARAMETER, _Q, _by_displacement, ratios),
    Group(kinds.RATIO_BY_PAST_VOLTAGE, PARAMETER, _polarisation, varies=ratios),
    Group(kinds.LAG, VOLTAGE, _amplifier_lag, _AFTER_A_STEP, _lag_after_a_step),
    _static(kinds.LIMIT, VOLTAGE, _U, _amplifier_limit),
    Group(kinds.SLEW, VOLTAGE, _amplifier_slew),
    Group(kinds.RATIO_BY_WARMTH, PARAMETER, _warmth, varies=ratios),
    _static(kinds.SENSOR_NONLINEAR, OUTPUT, _Y, _sensor_static),
    Group(kinds.LAG_OR_PLAY, OUTPUT, _sensor_memory),
    Group(kinds.GAIN_DRIFT, OUTPUT, _sensor_gain),
    Group(kinds.CLOCK, OUTPUT, _sensor_clock),
    _static(kinds.DRIFT, OUTPUT, _T, _drifts),
    Group(kinds.LINES, OUTPUT, _lines),
)


@dataclass(frozen=True)
class Responses:
    """Responses of the output to all local functions.

    Attributes:
        columns: (N, F) weighted, centred, normalised.
        norms: (F,) what the columns were divided by.
        owner: (F,) index into `GROUPS`.
    """

    columns: Array
    norms: Array
    owner: NDArray[np.int64]


@dataclass(frozen=True)
class Location:
    """Where the mismatch is.

    Attributes:
        name: best location; detail: its best kind of element.
        tied: locations that explain as much.
        scores: share that each location explains; details: the same by ``location/detail``.
        ranks: by either name, the share by which locations and kinds of elements are compared: what no other recording
            can tell of counts less there, for nothing has tested it.
        group: index of the best group; weights: its fitted coefficients, with their covariance.
    """

    name: str
    detail: str
    tied: tuple[str, ...]
    scores: dict[str, float]
    details: dict[str, float]
    ranks: dict[str, float]
    group: int
    weights: Array
    weight_covariance: Array


@dataclass(frozen=True)
class _Products:
    """Inner products of the base and of the columns beside it, over the rows of every fold.

    Attributes:
        grams: (K+F, K+F) of the base and the columns with themselves; rights: (K+F,) with the residual.
        squares: of the residual with itself.
        base: K, how many of them belong to the base; size: number of all rows.
    """

    grams: Sequence[Array]
    rights: Sequence[Array]
    squares: Sequence[float]
    base: int
    size: int

    @cached_property
    def alone(self) -> float:
        """Sum of squares on the left-out folds with the base alone."""
        return self.error(np.arange(self.base))

    def error(self, use: NDArray[np.int64], ridges: Sequence[float] = (0.0,)) -> float:
        """Return the sum of squares on the left-out folds, each predicted from all others by a few of the columns, with
        the best of some ridges on those beside the base."""
        block = np.ix_(use, use)
        grams, rights = [g[block] for g in self.grams], [b[use] for b in self.rights]
        total_gram, total_right = np.sum(grams, axis=0), np.sum(rights, axis=0)

        def left(ridge: float) -> float:
            # The base was fitted to all recordings: what is left out may move it only weakly.
            penalty = np.diag(np.where(use < self.base, 1.0, ridge) + 1e-12)
            total = 0.0
            for gram, right, square in zip(grams, rights, self.squares, strict=True):
                w = np.linalg.solve(total_gram - gram + penalty, total_right - right)
                total += square - float(2.0 * w @ right - w @ gram @ w)
            return total

        return min(left(ridge) for ridge in ridges)


def responses(linearised: LinearisedFit, measured: bool = False) -> Responses:
    """Return the responses of all local functions, by one forward-sensitivity sweep a recording.

    Args:
        measured: the input was measured where it acts, so that nothing before it can be the culprit.
    """
    parts = linearised.plan.each(lambda r, t: _responses_of(t, linearised, measured), linearised.trajectories)
    columns = linearised.stack([p[0] for p in parts])
    norms = np.linalg.norm(columns, axis=0)
    usable = norms > 1e-12 * norms.max()
    # A function that these recordings never excite keeps its place, as a column of zeros.
    norms = np.where(usable, norms, np.inf)
    return Responses(columns / norms, norms, parts[0][1])


def _responses_of(trajectory: Trajectory, linearised: LinearisedFit, measured: bool) -> tuple[Array, NDArray[np.int64]]:
    """(N, F) responses of one recording and the owners of the columns: forces, varied parameters, outputs."""
    scales = linearised.scales
    owners: dict[str, list[int]] = {FORCE: [], PARAMETER: [], OUTPUT: []}
    forces, varied, outputs = [], [], []
    network = trajectory.setup.network
    for index, group in enumerate(GROUPS):
        functions = group.functions(trajectory, scales)
        if not _exists(group, network, measured):
            functions = np.zeros_like(functions)
        if group.enters == OUTPUT:
            outputs.append(functions * scales.sensed)
            owners[OUTPUT] += [index] * functions.shape[1]
        elif group.enters == PARAMETER:
            names = group.varied(network)
            varied += [(n, network.parameters[n].value * f) for n in names for f in functions.T]
            owners[PARAMETER] += [index] * (functions.shape[1] * len(names))
        else:
            unit = scales.stiffness * scales.displacement
            volts = group.enters == VOLTAGE
            forces.append(input_force(trajectory, functions * scales.voltage) if volts else functions * unit)
            owners[FORCE] += [index] * functions.shape[1]
    if trajectory.program.junctions:
        through = output_derivatives(trajectory, (), (), np.hstack(forces), varied)
    else:
        # Nothing moves that a force could act on.
        through = np.zeros((trajectory.y.size, len(owners[FORCE]) + len(owners[PARAMETER])))
    return np.hstack([through, *outputs]), np.array(owners[FORCE] + owners[PARAMETER] + owners[OUTPUT])


def _exists(group: Group, network: Network, measured: bool) -> bool:
    """Whether the system has such a place: hysterons, a transducer, an amplifier whose command was recorded."""
    if group.location in ("hysteron", "electrical"):
        return bool(hysterons(network))
    if group.location in ("coupling", "thermal"):
        return bool(ratios(network))
    return not (group.location == "amplifier" and measured)


def locate(linearised: LinearisedFit, given: Responses | None = None, measured: bool = False) -> Location:
    """Score every location by generalisation to left-out recordings.

    Args:
        given: responses of the local functions, where they are known.
        measured: as in `responses`.
    """
    found = given if given is not None else responses(linearised, measured)
    folds = _products(linearised, found)
    details = {f"{g.location}/{g.detail}": _generalise(folds, found.owner == i) for i, g in enumerate(GROUPS)}
    # Lines have a phase of their own in every recording: only their frequency can be known from others. Nothing can of
    # a slow drift: functions that other recordings test come first where they explain much of the same.
    ranks = dict(details)
    for detail, saved, worth in (("environment/lines", line_share, 1.0), ("sensor/drift", drift_share, _DRIFT_WEIGHT)):
        share = min(saved(linearised) / _explainable(linearised), 1.0)
        details[detail], ranks[detail] = max(details[detail], share), max(ranks[detail], worth * share)
    names = list(dict.fromkeys(g.location for g in GROUPS))
    scores = {}
    for name in names:
        members = [i for i, g in enumerate(GROUPS) if g.location == name]
        joint = _generalise(folds, np.isin(found.owner, members))
        # A location may be explained best by one kind of element or by several together.
        inside = [f"{name}/{GROUPS[i].detail}" for i in members]
        scores[name], ranks[name] = (max([joint] + [of[d] for d in inside]) for of in (details, ranks))
    best = max(names, key=lambda n: ranks[n])
    detail = max((g.detail for g in GROUPS if g.location == best), key=lambda d: ranks[f"{best}/{d}"])
    group = next(i for i, g in enumerate(GROUPS) if (g.location, g.detail) == (best, detail))
    weights, covariance = _weights(linearised, found, group)
    tied = tuple(n for n in names if n != best and ranks[n] >= ranks[best] - _TIED)
    return Location(best, detail, tied, scores, details, ranks, group, weights, covariance)


def _folds(linearised: LinearisedFit) -> list[NDArray[np.int64]]:
    """Rows to leave out together: recordings, or stretches of time where there is one recording."""
    blocks: Sequence[slice] = linearised.slices
    if len(blocks) == 1:
        rows = np.arange(blocks[0].start, blocks[0].stop)
        return list(np.array_split(rows, _FOLDS))
    groups: list[list[int]] = [[] for _ in range(min(_FOLDS, len(blocks)))]
    for i in range(len(blocks)):
        groups[i % len(groups)].append(i)
    return [np.concatenate([np.arange(blocks[i].start, blocks[i].stop) for i in g]) for g in groups]


def _products(linearised: LinearisedFit, found: Responses) -> _Products:
    """Those of the base with all columns: every group of functions takes its own of them."""
    r, base = linearised.residual, linearised.basis
    # Projected columns need no help from the base to fit all recordings, so that its prior shrinks nothing true.
    columns = linearised.project(found.columns)
    grams, rights, squares = [], [], []
    for fold in _folds(linearised):
        design, left = np.hstack([base[fold], columns[fold]]), r[fold]
        grams.append(design.T @ design)
        rights.append(design.T @ left)
        squares.append(float(left @ left))
    return _Products(grams, rights, squares, base.shape[1], r.size)


def _generalise(folds: _Products, chosen: NDArray[np.bool_]) -> float:
    """Share of the explainable residual predicted on what was left out, best over the ridge grid.

    Args:
        chosen: (F,) the columns that may explain it.
    """
    if not chosen.any():
        return 0.0
    use = np.concatenate([np.arange(folds.base), folds.base + np.flatnonzero(chosen)])
    explained = folds.alone - folds.error(use, _RIDGES)
    return float(np.clip(explained / _at_least(folds.alone - folds.size, folds.size), 0.0, 1.0))


def _explainable(linearised: LinearisedFit) -> float:
    """Sum of squares in excess of the noise."""
    r = linearised.residual
    return _at_least(float(r @ r) - r.size, r.size)


def _at_least(excess: float, size: int) -> float:
    """An excess is known only to the spread of a sum of squares; below that no share of it can be large."""
    return max(excess, 2.0 * (2.0 * size) ** 0.5)


def _weights(linearised: LinearisedFit, found: Responses, group: int) -> tuple[Array, Array]:
    """Coefficients of one group's functions fitted to the whole residual, in the units of the functions."""
    mine = found.owner == group
    x = linearised.project(found.columns[:, mine])
    gram = x.T @ x + 1e-4 * np.eye(x.shape[1])
    inverse = np.linalg.inv(gram)
    weights = inverse @ (x.T @ linearised.residual)
    rest = linearised.residual - x @ weights
    spread = float(rest @ rest / rest.size)
    norms = found.norms[mine]
    return weights / norms, spread * (inverse @ (x.T @ x) @ inverse) / np.outer(norms, norms)


def recording_scores(linearised: LinearisedFit) -> dict[str, float]:
    """Return the residual over noise of every identification recording."""
    return {
        r.name: float(np.sqrt(np.mean(linearised.fit.residual[s] ** 2)))
        for r, s in zip(linearised.plan.recordings, linearised.slices, strict=True)
    }


def strongest_frequencies(linearised: LinearisedFit, count: int = 5) -> list[float]:
    """Return the frequencies [Hz] that carry most of the residual above the noise, over all recordings."""
    peaks: list[tuple[float, float]] = []
    for recording, rows in zip(linearised.plan.recordings, linearised.slices, strict=True):
        r = linearised.fit.residual[rows]
        power = np.abs(np.fft.rfft(r * np.hanning(r.size))) ** 2 / (0.375 * r.size)
        grid = np.fft.rfftfreq(r.size, recording.dt)
        top = [i for i in np.argsort(power)[-3:] if power[i] > 10.0 and grid[i] > 0.0]
        peaks += [(float(power[i]), float(grid[i])) for i in top]
    return [round(f, 3) for _, f in sorted(peaks, reverse=True)[:count]]


def strongest_times(linearised: LinearisedFit, count: int = 3) -> list[float]:
    """Return the instants [s] of the largest residuals in the recording that fits worst."""
    worst = max(recording_scores(linearised).items(), key=lambda item: item[1])[0]
    for recording, rows in zip(linearised.plan.recordings, linearised.slices, strict=True):
        if recording.name == worst:
            r = np.abs(linearised.fit.residual[rows])
            t = recording.t[recording.mask("identification")]
            return [float(x) for x in t[np.sort(np.argsort(r)[-count:])]]
    return []
