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
from phnn.trajectory import Trajectory

Array = NDArray[np.float64]
# Functions (n or N, F) along a trajectory; a law (M, F) of one variable (M,).
Functions = Callable[[Trajectory, Scales], Array]
Law = Callable[[Array, Scales], Array]
# Name and unit of a variable, and its values along a trajectory.
Axis = tuple[str, Callable[[Trajectory], Array]]
# A signal (n,) over its scale with its value before; times or limits (F,); names of parameters of a network.
Signal = Callable[[Trajectory, Scales], tuple[Array, float]]
Sizes = Callable[[Scales], Array]
Names = Callable[[Network], list[str]]

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


def integral_while_within(x: Array, h: Array, limit: float) -> Array:
    """Return the integral of ``x`` since its magnitude last reached a limit."""
    total = np.append(0.0, np.cumsum(h * x))
    reached = np.where(np.abs(x) < limit, 0, np.arange(1, x.size + 1))
    return np.asarray(total[1:] - total[np.maximum.accumulate(reached)])


def resonator(x: Array, h: Array, frequency: float, ratio: float) -> Array:
    """Return (N, 2) the two states of an oscillator that a signal drives, in phase and in quadrature, from rest: real
    and imaginary part of ``z`` with ``ż = λ (z − x)``, ``λ = ω (−ζ + i √(1 − ζ²))``, undamped frequency ``ω/2π`` and
    damping ratio ``ζ``."""
    tau = (ratio + 1j * np.sqrt(1.0 - ratio**2)) / (2.0 * np.pi * frequency)
    z = low_pass(x.astype(np.complex128), h, tau, 0j)
    return np.column_stack([z.real, z.imag])


def rate(x: Array, h: Array) -> Array:
    """Return the derivative of a signal known at the mid-points of the steps."""
    return np.gradient(x, np.cumsum(h) - 0.5 * h) if x.size > 2 else np.zeros_like(x)


@dataclass(frozen=True)
class Group:
    """Local functions of one kind, zero for zero motion.

    Attributes:
        kind: which kind of element, and at which location.
        enters: `FORCE`, `VOLTAGE` or `OUTPUT`; or `PARAMETER`: the functions scale the parameters that ``varied`` finds
            in a network, as a law or a transformer that is modulated would.
        axis: name of the variable against which the learned function is drawn, with its unit; empty where the
            functions have memory and no static picture.
        static: the same functions of the axis variable alone.
    """

    kind: Kind
    enters: str
    functions: Functions
    axis: str = ""
    static: Law | None = None
    varied: Names = lambda _: []


def _powers(scale: str, *exponents: int) -> Law:
    """Return the law with powers of a variable over one of the scales."""
    return lambda x, scales: (x / getattr(scales, scale))[:, None] ** exponents


def _elastic(q: Array, scales: Scales) -> Array:
    s = q / scales.displacement
    ramps = [np.maximum(side * s - c, 0.0) for side in (1.0, -1.0) for c in (0.0, 0.25, 0.5, 0.7, 0.85)]
    return np.column_stack([s**2, s**3, s**5, *ramps])


def _dissipative(v: Array, scales: Scales) -> Array:
    w, slow = v / scales.velocity, scales.slowest / scales.fastest
    speeds = (0.03 * slow, 0.3 * slow, 0.03, 0.3)
    return np.column_stack([*(np.tanh(w / c) for c in speeds), np.abs(w) * w, w**3])


def _by_speed(v: Array, scales: Scales) -> Array:
    w = np.abs(v) / scales.velocity
    return np.column_stack([w, w / (w + 0.05)])


def _limit(u: Array, scales: Scales) -> Array:
    w = u / scales.voltage
    return np.column_stack([np.sign(w) * np.maximum(np.abs(w) - c, 0.0) for c in (0.4, 0.6, 0.75, 0.85, 0.92, 0.97)])


def _travel(trajectory: Trajectory, scales: Scales) -> tuple[Array, float]:
    """Return the displacement over its scale, and its first value."""
    s = trajectory.mid_displacement / scales.displacement
    return s, float(s[0])


def _command(trajectory: Trajectory, scales: Scales) -> tuple[Array, float]:
    """Return the input over its scale, and its value before the recording."""
    return trajectory.u[:, 0] / scales.voltage, trajectory.recording.input_before / scales.voltage


def _behind(signal: Signal, follow: Callable[..., Array], sizes: Sizes) -> Functions:
    """Return the functions by which a signal is ahead of what follows it with some times or limits."""

    def functions(trajectory: Trajectory, scales: Scales) -> Array:
        x, before = signal(trajectory, scales)
        return np.column_stack([x - follow(x, trajectory.h, size, before) for size in sizes(scales)])

    return functions


def _lag_times(scales: Scales) -> Array:
    return np.array([0.02, 0.1, 0.4, 2.0, 10.0]) / (2.0 * np.pi * scales.fastest)


def _acceleration(trajectory: Trajectory, scales: Scales) -> Array:
    return rate(trajectory.velocity, trajectory.h) / (scales.velocity * scales.fastest)


def _modes(trajectory: Trajectory, scales: Scales) -> Array:
    a, h = _acceleration(trajectory, scales), trajectory.h
    times = 1.0 / (2.0 * np.pi * scales.fastest * np.array([3.0, 10.0]))
    return np.column_stack([a, *(low_pass(low_pass(a, h, t, 0.0), h, t, 0.0) for t in times)])


def _ringing(trajectory: Trajectory, scales: Scales) -> Array:
    a = _acceleration(trajectory, scales)
    return np.hstack([np.zeros((a.size, 0)), *(resonator(a, trajectory.h, f, _RATIO) for f in scales.peaks)])


def _charged(trajectory: Trajectory, scales: Scales) -> tuple[list[str], Array]:
    """Return the storages that hysterons charge, and their voltages (n, S) over the scale."""
    storages, charged = trajectory.setup.network.storages, charges(trajectory.setup.network)
    held = [i for i in trajectory.program.dissipative if storages[i].name in charged]
    return [storages[i].name for i in held], trajectory.efforts[:, held] / scales.voltage


def _hysteron(trajectory: Trajectory, scales: Scales) -> Array:
    s, _ = _travel(trajectory, scales)
    stops = [s - play_operator(s, r) for r in (0.01, 0.03, 0.06, 0.12, 0.25, 0.5)]
    return np.column_stack([*stops, _charged(trajectory, scales)[1]])


def _leakage(trajectory: Trajectory, scales: Scales) -> Array:
    times = np.geomspace(1.0 / scales.fastest, scales.duration, 4)
    network, h = trajectory.setup.network, trajectory.h
    widths = {n: network.parameters[r.parameters[1]].value for r in hysterons(network) for n in r.on}
    columns = [np.zeros((h.size, 0))]
    names, efforts = _charged(trajectory, scales)
    for name, e in zip(names, np.ascontiguousarray(efforts.T), strict=True):
        # What leaked away while a hysteron held is made up for as soon as it gives way.
        held = integral_while_within(e, h, widths.get(name, np.inf) / scales.voltage)
        columns += [low_pass(e, h, t, float(e[0])) for t in times] + [held / scales.duration]
    return np.column_stack(columns)


def _slowly(trajectory: Trajectory, scales: Scales, *driving: Array) -> Array:
    """Return states that follow what drives them over a good part of the recordings, from none at the start."""
    times = np.geomspace(0.05 * scales.duration, 5.0 * scales.duration, 3)
    return np.column_stack([low_pass(x, trajectory.h, t, 0.0) for x in driving for t in times])


def _polarisation(trajectory: Trajectory, scales: Scales) -> Array:
    w = np.abs(trajectory.u[:, 0]) / scales.voltage
    return _slowly(trajectory, scales, *(np.maximum(w - c, 0.0) for c in (0.3, 0.6, 0.85)))


def _lag_or_play(trajectory: Trajectory, scales: Scales) -> Array:
    q = trajectory.signal / scales.sensed
    mid = 0.5 * (q[1:] + q[:-1])
    lags = [q - np.append(q[0], low_pass(mid, trajectory.h, t, float(q[0]))) for t in _lag_times(scales)[[0, 2]]]
    samples = trajectory.nodes[trajectory.lead :]
    plays = [q[samples] - play_operator(q[samples], r) for r in (0.002, 0.01, 0.03)]
    return np.column_stack([*(lag[samples] for lag in lags), *plays])


_drifts = _powers("duration", 1, 2)


def _clock(trajectory: Trajectory, scales: Scales) -> Array:
    velocity = np.gradient(trajectory.y, trajectory.t) if trajectory.t.size > 1 else np.zeros_like(trajectory.y)
    return _drifts(trajectory.t, scales) * (velocity / scales.sensed_rate)[:, None]


def _lines(trajectory: Trajectory, _: Scales) -> Array:
    """Return sine and cosine of the mains and its harmonic, zero where the sampling is too slow for them."""
    lines = np.array([50.0, 60.0, 100.0, 120.0])
    phase, seen = 2.0 * np.pi * np.outer(trajectory.t, lines), lines * 2.2 < 1.0 / trajectory.recording.dt
    return np.hstack([np.sin(phase) * seen, np.cos(phase) * seen])


def _static(kind: Kind, enters: str, variable: Axis, law: Law, varied: Names = lambda _: []) -> Group:
    """Return the group of a law of one variable: the name and unit of its axis, and its values along a trajectory."""
    axis, along = variable
    return Group(kind, enters, lambda trajectory, scales: law(along(trajectory), scales), axis, law, varied)


def _after_a_step(kind: Kind, enters: str, signal: Signal, times: Sizes) -> Group:
    """Return the group of functions that forget a signal with some times, drawn as they decay after a step."""
    functions = _behind(signal, low_pass, times)
    return Group(kind, enters, functions, "time after a step [s]", lambda t, s: np.exp(-t[:, None] / times(s)))


_Q, _V = ("displacement [m]", attrgetter("mid_displacement")), ("velocity [m/s]", attrgetter("velocity"))
_Y, _T = (_Q[0], attrgetter("y")), ("time [s]", attrgetter("t"))
_U = "voltage [V]", lambda trajectory: trajectory.u[:, 0]
_BY_DISPLACEMENT = _powers("displacement", 1, 2)
_SLEWS = 2.0 * np.pi * np.array([0.5, 0.9, 2.0, 10.0])

GROUPS = (
    _static(kinds.ELASTIC, FORCE, _Q, _elastic),
    _static(kinds.DISSIPATIVE, FORCE, _V, _dissipative),
    _static(kinds.DAMPING_BY_DISPLACEMENT, PARAMETER, _Q, _BY_DISPLACEMENT, dampings),
    _after_a_step(kinds.MEMORY, FORCE, _travel, lambda s: np.geomspace(0.1 / s.fastest, s.duration, 8)),
    Group(kinds.MODE, FORCE, _modes),
    Group(kinds.RINGING_MODE, FORCE, _ringing),
    Group(kinds.SHAPE, FORCE, _hysteron),
    _static(kinds.THRESHOLD_BY_DISPLACEMENT, PARAMETER, _Q, _BY_DISPLACEMENT, thresholds),
    _static(kinds.THRESHOLD_BY_RATE, PARAMETER, _V, _by_speed, thresholds),
    Group(kinds.CAPACITANCE_BY_CHARGE, PARAMETER, lambda t, s: _charged(t, s)[1] ** 2, varied=capacitances),
    Group(kinds.LEAKAGE, FORCE, _leakage),
    _static(kinds.FORCE_BY_VOLTAGE, FORCE, _U, _powers("voltage", 2, 3)),
    _static(kinds.RATIO_BY_DISPLACEMENT, PARAMETER, _Q, _BY_DISPLACEMENT, ratios),
    Group(kinds.RATIO_BY_PAST_VOLTAGE, PARAMETER, _polarisation, varied=ratios),
    _after_a_step(kinds.LAG, VOLTAGE, _command, _lag_times),
    _static(kinds.LIMIT, VOLTAGE, _U, _limit),
    Group(kinds.SLEW, VOLTAGE, _behind(_command, rate_limited, lambda s: s.fastest * _SLEWS)),
    Group(kinds.RATIO_BY_WARMTH, PARAMETER, lambda t, s: _slowly(t, s, (t.velocity / s.velocity) ** 2), varied=ratios),
    _static(kinds.SENSOR_NONLINEAR, OUTPUT, _Y, _powers("sensed", 2, 3)),
    Group(kinds.LAG_OR_PLAY, OUTPUT, _lag_or_play),
    Group(kinds.GAIN_DRIFT, OUTPUT, lambda t, s: _drifts(t.t, s) * (t.y / s.sensed)[:, None]),
    Group(kinds.CLOCK, OUTPUT, _clock),
    _static(kinds.DRIFT, OUTPUT, _T, _drifts),
    Group(kinds.LINES, OUTPUT, _lines),
)


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


def responses(linearised: LinearisedFit, measured: bool = False) -> tuple[Array, NDArray[np.int64]]:
    """Return the weighted responses (N, F) of the output to all local functions, by one forward-sensitivity sweep a
    recording, and their owners (F,) in `GROUPS`.

    Args:
        measured: the input was measured where it acts, so that nothing before it can be the culprit.
    """
    parts = linearised.plan.each(lambda r, t: _responses_of(t, linearised, measured), linearised.trajectories)
    return linearised.stack([p[0] for p in parts]), parts[0][1]


def _responses_of(trajectory: Trajectory, linearised: LinearisedFit, measured: bool) -> tuple[Array, NDArray[np.int64]]:
    """Return (N, F) responses of one recording and the owners of the columns: forces, varied parameters, outputs."""
    scales, network = linearised.scales, trajectory.setup.network
    owners: dict[str, list[int]] = {FORCE: [], PARAMETER: [], OUTPUT: []}
    forces, varied, outputs = [], [], []
    # Places that not every system has: hysterons, a transducer, an amplifier whose command was recorded.
    present = {"amplifier": not measured, "hysteron": hysterons(network), "coupling": ratios(network)}
    present |= {"electrical": present["hysteron"], "thermal": present["coupling"]}
    for index, group in enumerate(GROUPS):
        functions = group.functions(trajectory, scales)
        if not present.get(group.kind.location, True):
            functions = np.zeros_like(functions)
        names = group.varied(network) if group.enters == PARAMETER else [""]
        owners[FORCE if group.enters == VOLTAGE else group.enters] += [index] * functions.shape[1] * len(names)
        if group.enters == OUTPUT:
            outputs.append(functions * scales.sensed)
        elif group.enters == PARAMETER:
            varied += [(n, network.parameters[n].value * f) for n in names for f in functions.T]
        elif group.enters == VOLTAGE:
            forces.append(input_force(trajectory, functions * scales.voltage))
        else:
            forces.append(functions * (scales.stiffness * scales.displacement))
    if trajectory.program.junctions:
        through = output_derivatives(trajectory, (), (), np.hstack(forces), varied)
    else:
        # Nothing moves that a force could act on.
        through = np.zeros((trajectory.y.size, len(owners[FORCE]) + len(owners[PARAMETER])))
    return np.hstack([through, *outputs]), np.array(owners[FORCE] + owners[PARAMETER] + owners[OUTPUT])


def locate(linearised: LinearisedFit, measured: bool = False) -> Location:
    """Score every location by generalisation to left-out recordings.

    Args:
        measured: as in `responses`.
    """
    columns, owner = responses(linearised, measured)
    norms = np.linalg.norm(columns, axis=0)
    # A function that these recordings never excite keeps its place, as a column of zeros.
    norms = np.where(norms > 1e-12 * norms.max(), norms, np.inf)
    columns /= norms
    share = _generalisation(linearised, columns)
    details = {g.kind.key: share(owner == i) for i, g in enumerate(GROUPS)}
    # Lines have a phase of their own in every recording: only their frequency can be known from others. Nothing can of
    # a slow drift: functions that other recordings test come first where they explain much of the same.
    ranks, size = dict(details), linearised.residual.size
    explainable = _at_least(float(linearised.residual @ linearised.residual) - size, size)
    for kind, saved, worth in ((kinds.LINES, line_share, 1.0), (kinds.DRIFT, drift_share, _DRIFT_WEIGHT)):
        alone = min(saved(linearised) / explainable, 1.0)
        details[kind.key], ranks[kind.key] = max(details[kind.key], alone), max(ranks[kind.key], worth * alone)
    names, scores = list(dict.fromkeys(g.kind.location for g in GROUPS)), {}
    for name in names:
        # A location may be explained best by one kind of element or by several together.
        members = [i for i, g in enumerate(GROUPS) if g.kind.location == name]
        joint = share(np.isin(owner, members))
        scores[name], ranks[name] = (
            max([joint, *(of[GROUPS[i].kind.key] for i in members)]) for of in (details, ranks)
        )
    best = max(names, key=lambda n: ranks[n])
    index, group = max(
        ((i, g) for i, g in enumerate(GROUPS) if g.kind.location == best), key=lambda item: ranks[item[1].kind.key]
    )
    tied = tuple(n for n in names if n != best and ranks[n] >= ranks[best] - _TIED)
    weights = _weights(linearised, columns[:, owner == index], norms[owner == index])
    return Location(best, group.kind.name, tied, scores, details, ranks, index, *weights)


def _folds(blocks: Sequence[slice]) -> list[NDArray[np.int64]]:
    """Return rows to leave out together: recordings, or stretches of time where there is one recording."""
    rows = [np.arange(b.start, b.stop) for b in blocks]
    if len(rows) == 1:
        return list(np.array_split(rows[0], _FOLDS))
    return [np.concatenate(rows[i::_FOLDS]) for i in range(min(_FOLDS, len(rows)))]


def _generalisation(linearised: LinearisedFit, columns: Array) -> Callable[[NDArray[np.bool_]], float]:
    """Return the function that gives the share of the explainable residual that some of the columns, by a mask (F,),
    predict on what was left out, best over the ridges."""
    r, base = linearised.residual, linearised.basis
    count = base.shape[1]
    # Projected columns need no help from the base to fit all recordings, so that its prior shrinks nothing true.
    columns = linearised.project(columns)
    folds = []
    for rows in _folds(linearised.slices):
        design, residual = np.hstack([base[rows], columns[rows]]), r[rows]
        folds.append((design.T @ design, design.T @ residual, float(residual @ residual)))

    def error(use: NDArray[np.int64], ridge: float) -> float:
        """Return the sum of squares on the left-out folds, each predicted from all others."""
        parts = [(gram[np.ix_(use, use)], right[use], square) for gram, right, square in folds]
        total_gram, total_right = np.sum([p[0] for p in parts], axis=0), np.sum([p[1] for p in parts], axis=0)
        # The base was fitted to all recordings: what is left out may move it only weakly.
        penalty, total = np.diag(np.where(use < count, 1.0, ridge) + 1e-12), 0.0
        for gram, right, square in parts:
            w = np.linalg.solve(total_gram - gram + penalty, total_right - right)
            total += square - float(2.0 * w @ right - w @ gram @ w)
        return total

    alone = error(np.arange(count), 0.0)

    def share(chosen: NDArray[np.bool_]) -> float:
        if not chosen.any():
            return 0.0
        use = np.append(np.arange(count), count + np.flatnonzero(chosen))
        explained = alone - min(error(use, ridge) for ridge in _RIDGES)
        return float(np.clip(explained / _at_least(alone - r.size, r.size), 0.0, 1.0))

    return share


def _at_least(excess: float, size: int) -> float:
    """Return an excess: it is known only to the spread of a sum of squares, and below that no share of it is large."""
    return max(excess, 2.0 * (2.0 * size) ** 0.5)


def _weights(linearised: LinearisedFit, columns: Array, norms: Array) -> tuple[Array, Array]:
    """Return the coefficients (F,) of functions fitted to the whole residual, and their covariance; ``columns`` (N, F)
    are their responses over ``norms``."""
    x = linearised.project(columns)
    gram = x.T @ x
    inverse = np.linalg.inv(gram + 1e-4 * np.eye(norms.size))
    weights = inverse @ (x.T @ linearised.residual)
    spread = float(np.mean((linearised.residual - x @ weights) ** 2))
    return weights / norms, spread * (inverse @ gram @ inverse) / np.outer(norms, norms)


def where_and_when(linearised: LinearisedFit) -> tuple[dict[str, float], list[float], list[float]]:
    """Return the residual over noise of every identification recording, the five frequencies [Hz] that carry most of
    the residual above the noise, and the three instants [s] of the largest residuals in the recording that fits
    worst."""
    scores: dict[str, float] = {}
    peaks, times = [], []
    for recording, rows in zip(linearised.plan.recordings, linearised.slices, strict=True):
        r = linearised.fit.residual[rows]
        worst, scores[recording.name] = max(scores.values(), default=-1.0), float(np.sqrt(np.mean(r**2)))
        if scores[recording.name] > worst:
            times = recording.t[recording.mask("identification")][np.sort(np.argsort(np.abs(r))[-3:])].tolist()
        power = np.abs(np.fft.rfft(r * np.hanning(r.size))) ** 2 / (0.375 * r.size)
        f = np.fft.rfftfreq(r.size, recording.dt)
        peaks += [(float(power[i]), float(f[i])) for i in np.argsort(power)[-3:] if power[i] > 10.0 and f[i] > 0.0]
    return scores, [round(f, 3) for _, f in sorted(peaks, reverse=True)[:5]], times
