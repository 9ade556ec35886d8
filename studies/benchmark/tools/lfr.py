"""Augmentation of the base model's linear fractional representation, with a group lasso over locations, as a tool.

After Györök, Drenth, Verhoek, Péni, Schoukens & Tóth (2026, arXiv 2604.11421) and Hoekstra et al. (2024, arXiv
2404.01901): a first-principles model and learned blocks are joined in one linear fractional representation, and a
group lasso (as Bemporad 2025, IEEE Trans. Autom. Control) removes the blocks that the data do not need. Here a block
stands at each location of the actuator; base parameters move freely beside them and are not penalised:

    amplifier    functions of V, V̇           add to the voltage
    coupling     functions of V, q            add to the force
    mechanical   functions of q, v, v̇         add to the force
    hysteron     functions of q, v, V_i       add to the force, or multiply the thresholds
    electrical   states that integrate V_i    add to the force
    thermal      slow states driven by v²     add to the force, times V
    sensor       functions of q, v            add to the output

The authors train all by simulation. This tool selects locations to first order about the identified base model, in
which the problem is convex: the blocks are linear in their coefficients, and the output responds to each by the base
model's sensitivities. Where something strong is missing that first order is rough; so phnn's learned elements at the
best three locations are trained by simulation beside, and one that predicts more takes the location and the
predictions. There is no algebraic loop, since no block acts on its own input at once.

The paper recovers a structure and no names. Names are read from the channel that alone predicts held-out stretches
best at the first location, by `NAMES`. Settings were chosen on cases of a benchmark of seed 903 that was written for
that purpose.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phnn.derivatives import input_force, output_derivatives
from phnn.diagnose.linearised import LinearisedFit, prepare
from phnn.diagnose.locations import low_pass, play_operator, rate
from phnn.effects import Effect, Scales
from phnn.effects.learned import learned_elements
from phnn.errors import PhnnError
from phnn.identification.fit import Fit, fit
from phnn.identification.plan import Plan
from phnn.network.roles import thresholds
from phnn.recordings import read
from phnn.trajectory import Trajectory, simulate
from studies.benchmark.bench import Answer
from studies.benchmark.tools.common import (
    PLACES,
    base_of,
    evaluated,
    fitted_with,
    in_turns,
    left,
    orthonormal,
    predictions,
    whole,
)

Array = NDArray[np.float64]
Channel = tuple[str, str]

# What a channel is called in the catalogue.
NAMES: dict[Channel, str] = {
    ("amplifier", "lag"): "amplifier_lowpass",
    ("amplifier", "limit"): "amplifier_saturation",
    ("amplifier", "slew"): "slew_limit",
    ("amplifier", "offset"): "amplifier_offset",
    ("coupling", "square of the voltage"): "electrostriction",
    ("coupling", "voltage times displacement"): "displacement_coupling",
    ("coupling", "past voltage"): "depolarisation",
    ("mechanical", "even spring"): "quadratic_stiffness",
    ("mechanical", "odd spring"): "cubic_stiffness",
    ("mechanical", "stop"): "contact_stop",
    ("mechanical", "drag"): "quadratic_drag",
    ("mechanical", "friction"): "coulomb_friction",
    ("mechanical", "memory"): "creep",
    ("mechanical", "mode"): "second_mode",
    ("mechanical", "load"): "constant_load",
    ("hysteron", "play"): "extra_hysteron",
    ("hysteron", "by displacement"): "hysteresis_asymmetry",
    ("hysteron", "by rate"): "rate_dependent_threshold",
    ("electrical", "leakage"): "charge_leakage",
    ("thermal", "warmth"): "self_heating",
    ("sensor", "curve"): "sensor_nonlinearity",
    ("sensor", "lag"): "sensor_lag",
    ("sensor", "play"): "output_backlash",
    ("sensor", "drift"): "sensor_drift",
}
# Thresholds of ramps and radii of plays, in units of the largest value.
_RAMPS, _RADII = (0.3, 0.6, 0.8), (0.05, 0.15, 0.3, 0.6)
# Time constants of fast and of slow first-order states, in periods of the slowest and the fastest excitation; widths of
# smoothed friction.
_FAST, _SLOW, _SMOOTH = (0.02, 0.1), (0.1, 0.5, 2.5), (0.02, 0.1)
# Of the group lasso: rounds, tolerance, penalties and the last one over the first.
_ROUNDS, _TOLERANCE, _PENALTIES, _LAST = 500, 1e-6, 30, 1e-3
# Stretches of each recording that take turns to be left out; simulations of a learned element's fit.
_STRETCHES, _USES, _SIMULATIONS = 10, ("identification", "held"), 15
_RIDGE = 1e-6  # keeps normal matrices regular
# Share of what is left out that has to be predicted, or else nothing is missing; share of the best prediction that the
# chosen places have to reach.
_WORTH, _ENOUGH = 0.05, 0.95
# Share of the energy above the noise that the blocks have to predict for a name to be claimed.
_UNDERSTOOD = 0.6
# Probability that nothing is missing, or that it is; that it is not listed where blocks do not understand it, and
# where they do. Gains of channels are compared by their power of this exponent.
_NONE, _FOUND, _UNLISTED, _REST = 0.85, 0.95, 0.6, 0.1
_SHARP = 12.0


@dataclass(frozen=True)
class Blocks:
    """Responses of the output to all functions of all blocks.

    Attributes:
        columns: (N, F) weighted responses; channels: (F,) location and channel that each belongs to.
    """

    columns: Array
    channels: tuple[Channel, ...]

    def of(self, places: Iterable[str]) -> list[int]:
        """Return the columns of some locations."""
        wanted = set(places)
        return [i for i, (place, _) in enumerate(self.channels) if place in wanted]

    def of_channel(self, channel: Channel) -> list[int]:
        """Return the columns of a channel."""
        return [i for i, own in enumerate(self.channels) if own == channel]


@dataclass(frozen=True)
class _Signals:
    """(n,) local signals during the steps, in units of their largest value; ``h``: steps [s]; ``y``: (N,) samples."""

    q: Array
    v: Array
    voltage: Array
    rate: Array
    held: tuple[Array, ...]
    h: Array
    y: Array
    t: Array


def raw_responses(trajectory: Trajectory, scales: Scales) -> tuple[Array, tuple[Channel, ...]]:
    """Return (N, F) changes of the output [m] by each function, and the channels that these belong to."""
    s = _signals(trajectory, scales)
    volts, forces, outputs = (list(of(s, scales)) for of in (_amplifier, _forces, _sensor))
    network = trajectory.setup.network
    unit, names = scales.stiffness * scales.displacement, thresholds(network)
    rates = [("by rate", np.abs(s.v)), ("by rate", np.sqrt(np.abs(s.v) + 1e-6))]
    on_thresholds = [("by displacement", s.q), ("by displacement", s.q**2), *rates]
    varied = [(("hysteron", kind), n, network.parameters[n].value * f) for kind, f in on_thresholds for n in names]
    pushed = [*(input_force(trajectory, scales.voltage * f) for _, f in volts), *(unit * f for _, f in forces)]
    through = output_derivatives(trajectory, (), (), np.column_stack(pushed), [(n, f) for _, n, f in varied])
    columns = np.hstack([through, *(scales.displacement * f[:, None] for _, f in outputs)])
    channels = [c for c, _ in (*volts, *forces)] + [c for c, _, _ in varied] + [c for c, _ in outputs]
    return columns, tuple(channels)


def _signals(trajectory: Trajectory, scales: Scales) -> _Signals:
    u, h = trajectory.u[:, 0], trajectory.h
    slope = np.gradient(u, np.cumsum(h)) / (2.0 * np.pi * scales.fastest)
    network, states = trajectory.setup.network, trajectory.states
    mid = 0.5 * (states[1:] + states[:-1])
    held = tuple(
        mid[:, i] / max(float(np.abs(mid[:, i]).max()), 1e-300)
        for i, name in enumerate(network.state_names)
        if name.startswith("Q_")
    )
    return _Signals(
        trajectory.mid_displacement / scales.displacement, trajectory.velocity / scales.velocity, u / scales.voltage,
        slope / scales.voltage, held, h, trajectory.y / scales.displacement, trajectory.t,
    )  # fmt: skip


def _amplifier(s: _Signals, scales: Scales) -> Iterator[tuple[Channel, Array]]:
    """Yield what adds to the voltage."""
    for share in _FAST:
        yield ("amplifier", "lag"), low_pass(s.voltage, s.h, share / scales.fastest, float(s.voltage[0])) - s.voltage
    for x in (s.voltage**3, s.voltage**5, *(np.sign(s.voltage) * np.maximum(abs(s.voltage) - c, 0.0) for c in _RAMPS)):
        yield ("amplifier", "limit"), x
    for c in _RAMPS:
        excess = np.sign(s.rate) * np.maximum(np.abs(s.rate) - c, 0.0)
        yield ("amplifier", "slew"), low_pass(excess, s.h, _FAST[1] / scales.fastest, 0.0)
    yield ("amplifier", "offset"), np.ones_like(s.q)


def _forces(s: _Signals, scales: Scales) -> Iterator[tuple[Channel, Array]]:
    """Yield what adds to the force."""
    slow = [share / scales.slowest for share in _SLOW]
    yield ("coupling", "square of the voltage"), s.voltage**2
    yield ("coupling", "voltage times displacement"), s.voltage * s.q
    for tau in slow:
        yield ("coupling", "past voltage"), s.voltage * low_pass(np.abs(s.voltage), s.h, tau, float(abs(s.voltage[0])))
    yield ("mechanical", "even spring"), s.q**2
    yield from ((("mechanical", "odd spring"), s.q**degree) for degree in (3, 5))
    for c in _RAMPS:
        yield from ((("mechanical", "stop"), np.maximum(side * s.q - c, 0.0)) for side in (1.0, -1.0))
    yield from ((("mechanical", "drag"), x) for x in (s.v * np.abs(s.v), s.v**3))
    yield from ((("mechanical", "friction"), np.tanh(s.v / width)) for width in _SMOOTH)
    for tau in slow:
        yield ("mechanical", "memory"), s.q - low_pass(s.q, s.h, tau, float(s.q[0]))
    for share in _FAST:
        yield ("mechanical", "mode"), s.v - low_pass(s.v, s.h, share / scales.fastest, 0.0)
    yield ("mechanical", "load"), np.ones_like(s.q)
    yield from ((("hysteron", "play"), play_operator(s.q, radius)) for radius in _RADII)
    for held in s.held:
        yield from ((("electrical", "leakage"), low_pass(held, s.h, tau, 0.0)) for tau in slow)
    for tau in (*slow, 10.0 * slow[-1]):
        yield ("thermal", "warmth"), s.voltage * low_pass(s.v**2, s.h, tau, 0.0)


def _sensor(s: _Signals, scales: Scales) -> Iterator[tuple[Channel, Array]]:
    """Yield what adds to the output."""
    h = np.diff(s.t, prepend=s.t[0])
    yield from ((("sensor", "curve"), s.y**degree) for degree in (2, 3))
    for share in _FAST:
        yield ("sensor", "lag"), low_pass(s.y, h, share / scales.fastest, float(s.y[0])) - s.y
    yield ("sensor", "lag"), rate(s.y, s.t) / (2.0 * np.pi * scales.fastest)
    yield from ((("sensor", "play"), play_operator(s.y, radius) - s.y) for radius in _RADII[:2])
    # A first-order state without an input: what is left of its start.
    yield from ((("sensor", "drift"), np.exp(-s.t / (x * max(scales.duration, 1e-300)))) for x in (0.3, 3.0))


def group_lasso(r: Array, groups: Sequence[Array], steps: int = _PENALTIES, least: float = _LAST) -> Array:
    """Return (steps, 1 + G) penalties that fall from the one at which all groups are zero, and the groups' norms.

        min ½‖r − Σ_g U_g β_g‖² + λ Σ_g √p_g ‖β_g‖,     U_gᵀU_g = I

    With groups that are orthonormal within themselves (Simon & Tibshirani 2012) a block of coordinate descent has a
    closed form, ``β_g = (1 − λ√p_g/‖z_g‖)₊ z_g`` with ``z_g = U_gᵀ(r − Σ_{h≠g} U_h β_h)``. A group that is not needed
    is zero exactly.
    """
    edges = np.cumsum([0, *(g.shape[1] for g in groups)])
    own = [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
    joined, weights = np.hstack(groups), np.sqrt(np.diff(edges))
    gram, right = joined.T @ joined, joined.T @ r
    first = max((float(np.linalg.norm(right[o])) / w for o, w in zip(own, weights, strict=True) if w), default=0.0)
    beta, size, path = np.zeros(right.size), max(float(np.linalg.norm(right)), 1e-300), []
    for penalty in first * np.geomspace(1.0, least, steps):
        for _ in range(_ROUNDS):
            before = beta.copy()
            for rows, limit in zip(own, penalty * weights, strict=True):
                z = right[rows] - gram[rows] @ beta + beta[rows]
                length = float(np.linalg.norm(z))
                beta[rows] = z * (1.0 - limit / length) if length > limit else 0.0
            if max(float(np.linalg.norm((beta - before)[rows])) for rows in own) < _TOLERANCE * size:
                break
        path.append([float(penalty), *(float(np.linalg.norm(beta[rows])) for rows in own)])
    return np.array(path)


def _trained(base: Fit, plan: Plan, places: Iterable[str]) -> tuple[float, Fit, Effect] | None:
    """Train the learned elements of some locations by simulation on half of the stretches; return the best one.

    Returns:
        The share of the base model's squares that it leaves in the other half, the fit and the element.
    """
    stretches = in_turns(plan, _STRETCHES, _USES)
    nothing = fit(base.setup, stretches, base.variables.names, base.held, _SIMULATIONS, origin=base)
    alone, scales, wanted, trained = left(nothing, _USES[1]), prepare(nothing).scales, set(places), []
    for effect in learned_elements().values():
        if effect.location not in wanted or not effect.can_be_added_to(nothing.setup):
            continue
        for point in effect.grid(scales)[:1]:
            try:
                one = fitted_with(nothing, effect, point, _SIMULATIONS)
                trained.append((left(one, _USES[1]) / alone, one, effect))
            except PhnnError:
                continue
    return min(trained, key=lambda t: t[0], default=None)


@dataclass(frozen=True)
class Evidence:
    """Sums of squares left out, by what may explain them.

    Attributes:
        alone: with the base model; joint: with the blocks of the chosen places; size: samples.
        places: the chosen ones, the best one first; further: those that enter later along the path.
        channels: what each channel of the chosen places leaves alone.
    """

    alone: float
    joint: float
    size: int
    places: tuple[str, ...]
    further: tuple[str, ...]
    channels: dict[Channel, float]

    @property
    def missing(self) -> bool:
        """Whether the blocks predict more than could be chance."""
        return bool(self.places) and self.joint < (1.0 - _WORTH) * self.alone

    @property
    def ranked(self) -> tuple[str, ...]:
        """All places, the best one first."""
        return (*self.places, *self.further)

    def with_first(self, place: str, share: float, found: Blocks, folds: Folds) -> Evidence:
        """Return the evidence where a block that was trained by simulation leaves less: its place alone is chosen."""
        rest = tuple(name for name in self.ranked if name != place)
        channels = {c: folds.left(found.of_channel(c)) for c in dict.fromkeys(found.channels) if c[0] == place}
        return Evidence(self.alone, share * self.alone, self.size, (place,), rest, channels)


class Folds:
    """Left-out predictions of linear models on stretches that take turns, from products over each half."""

    def __init__(self, linearised: LinearisedFit, found: Blocks) -> None:
        base, r = linearised.fit.jacobian, linearised.fit.residual
        joined = np.hstack([base, found.columns])
        self.sizes = np.maximum(np.linalg.norm(joined, axis=0), 1e-300)
        joined = joined / self.sizes
        stretches = in_turns(linearised.plan, _STRETCHES, _USES).recordings
        halves = [np.concatenate([x.mask(use) for x in stretches]) for use in _USES]
        self.base, self.size = base.shape[1], r.size
        self._grams = [joined[h].T @ joined[h] for h in halves]
        self._rights = [joined[h].T @ r[h] for h in halves]
        self._squares = [float(r[h] @ r[h]) for h in halves]

    def left(self, columns: Sequence[int]) -> float:
        """Return the sum of squares that the base model and some columns, fitted on either half, leave on the other."""
        total = 0.0
        for here, there in ((0, 1), (1, 0)):
            beta, use = self._solved(self._grams[here], self._rights[here], columns)
            gram, right = self._grams[there][np.ix_(use, use)], self._rights[there][use]
            total += self._squares[there] - float(2.0 * beta @ right - beta @ gram @ beta)
        return total

    def fitted(self, columns: Sequence[int]) -> tuple[Array, Array]:
        """Return coefficients of base parameters and of some columns, fitted to all samples."""
        beta, use = self._solved(self._grams[0] + self._grams[1], self._rights[0] + self._rights[1], columns)
        found = beta / self.sizes[use]
        return found[: self.base], found[self.base :]

    def _solved(self, gram: Array, right: Array, columns: Sequence[int]) -> tuple[Array, NDArray[np.int64]]:
        use = np.concatenate([np.arange(self.base), self.base + np.asarray(columns, dtype=np.int64)])
        ridge = np.where(np.arange(use.size) < self.base, 1e-9, _RIDGE)
        return np.linalg.solve(gram[np.ix_(use, use)] + np.diag(ridge), right[use]), use


def answer(folder: Path, seed: int) -> Answer:
    """Augment the base model at every place, keep what the group lasso keeps, and read a name from it."""
    base = base_of(folder, seed)
    linearised = evaluated(base.fit, whole(base.fit.plan))
    each = linearised.plan.each(lambda _, t: raw_responses(t, linearised.scales), linearised.trajectories)
    found = Blocks(linearised.stack([columns for columns, _ in each]), each[0][1])
    folds = Folds(linearised, found)
    evidence = _weighed(linearised, found, folds)
    predicted = predictions(base.fit, folder)
    if not evidence.missing:
        return read_off(evidence, predicted)
    best = _trained(base.fit, linearised.plan, evidence.ranked[:PLACES])
    predicted = _augmented(linearised, found, folds, evidence.places, folder, predicted)
    if best is not None and best[0] < evidence.joint / evidence.alone:
        share, fitted, effect = best
        predicted = predictions(fitted, folder)
        evidence = evidence.with_first(effect.location, share, found, folds)
    return read_off(evidence, predicted)


def _weighed(linearised: LinearisedFit, found: Blocks, folds: Folds) -> Evidence:
    """Return the fewest locations along the path of the group lasso that predict nearly as well as the best do."""
    names = list(dict.fromkeys(place for place, _ in found.channels))
    projected = linearised.project(found.columns)
    bases = [orthonormal(projected[:, found.of([name])]) for name in names]
    norms = group_lasso(linearised.residual, bases)[:, 1:]
    steps = [[i for i in np.argsort(-own, kind="stable").tolist() if own[i] > 0.0] for own in norms]
    # A single place is tried in any case: the penalty favours places with few functions.
    tried = {frozenset(names[i] for i in step) for step in steps} | {frozenset([name]) for name in names}
    left = {places: folds.left(found.of(places)) for places in tried}
    alone, best = folds.left([]), min(left.values())
    enough = alone - _ENOUGH * max(alone - best, 0.0)
    chosen = min((p for p in tried if left[p] <= enough), key=lambda p: (len(p), left[p]))
    singly = {name: folds.left(found.of([name])) for name in chosen}
    ordered = tuple(sorted(chosen, key=lambda name: singly[name]))
    # What stays only until the penalty falls is named last.
    entered = dict.fromkeys(names[i] for step in steps for i in step)
    rest = tuple(name for name in entered if name not in ordered)
    channels = {c: folds.left(found.of_channel(c)) for c in dict.fromkeys(found.channels) if c[0] in chosen}
    return Evidence(alone, left[chosen], folds.size, ordered, rest, channels)


def read_off(evidence: Evidence, predicted: dict[str, Array]) -> Answer:
    """Return the answer that blocks give: names by `NAMES`."""
    gain, places = evidence.alone - evidence.joint, evidence.ranked[:PLACES]
    if not evidence.missing:
        return Answer({}, none=_NONE, places=places, predictions=predicted)
    gains = {c: max(evidence.alone - left, 0.0) / gain for c, left in evidence.channels.items()}
    total = sum(g**_SHARP for g in gains.values())
    understood = gain >= _UNDERSTOOD * max(evidence.alone - evidence.size, 1e-300)
    unlisted = _REST if understood else _UNLISTED
    listed = _FOUND - unlisted
    names: dict[str, float] = {}
    for channel, g in gains.items():
        name = NAMES[channel]
        names[name] = names.get(name, 0.0) + (listed * g**_SHARP / total if total > 0.0 else 0.0)
    return Answer(names, 1.0 - _FOUND, unlisted, places, predicted)


def _augmented(
    linearised: LinearisedFit, found: Blocks, folds: Folds, places: Sequence[str], folder: Path, base: dict[str, Array]
) -> dict[str, Array]:  # fmt: skip
    """Return predictions with the chosen blocks, to first order; those of the base model where they cannot be had."""
    fitted, plan = linearised.fit, linearised.plan
    chosen = found.of(places)
    step, beta = folds.fitted(chosen)
    names = fitted.variables.names
    slopes = [fitted.setup.parameters[n].slope(fitted.setup.parameters[n].value) for n in names]
    predicted = {}
    for recording in read(folder / "exam", need_output=False).recordings:
        try:
            trajectory = simulate(fitted.setup, recording, plan.finest)
            columns, _ = raw_responses(trajectory, linearised.scales)
            moved = output_derivatives(trajectory, names) * slopes
        except PhnnError:
            return base
        # The Jacobian is that of the residual: its coefficients are steps of the parameters with the other sign.
        predicted[recording.name] = trajectory.y - moved @ step[: len(names)] + columns[:, chosen] @ beta
    return predicted
