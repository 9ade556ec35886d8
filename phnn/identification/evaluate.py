"""Score a model on every part of every recording, held-out ones included."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from phnn.identification.fit import TOLERANCE, Fit, carried, fit_problem
from phnn.identification.plan import Plan
from phnn.identification.problem import Problem, Variables, beyond_limit, constant_and_own, own_parts, variables_of
from phnn.recordings.excitation import instants_known, unknown_instants
from phnn.recordings.recording import Part, Recording, Start
from phnn.rescue import attempt
from phnn.setup import NOTHING, Setup
from phnn.trajectory import simulate

Array = NDArray[np.float64]

# Samples beyond those that are fitted: an input between samples depends on the ones after it.
_BEYOND = 200
# An initial state is sought from several states, for thresholds bend the way to it: a few evaluations from each, and
# enough from the best ones, until one leaves hardly more than the noise.
_FEW, _BEST, _ENOUGH = 12, 3, 60
_NOISE = 1.2
# What the input may have done before: turning points from its first value, as multiples of its range.
_HISTORIES = ((1.0, 0.0), (-1.0, 1.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0), (1.0, -1.0, 0.0), (0.0, -1.0, 0.0))
# Tolerance of a state that is sought near another one.
_ROUGH = 1e-4


# A model, and the state (N,) in which it begins a recording.
Begun = tuple[Setup, Array]


def estimated_start(
    setup: Setup, recording: Recording, substeps: int, use: str = "nuisance", near: Begun | None = None
) -> Array | None:
    """Return (N,) initial state of a recording, estimated from the samples of one use, those of the head that is not
    scored; None where its start says it.

    Args:
        near: where another model begins: sought from there and from what is expected, in a fraction of the time.
    """
    setup, plan = _head_of(setup, recording, substeps, use)
    variables, name = variables_of(setup, plan, ()), recording.name
    if not variables.unknown:
        return None
    known = variables.expected[name]

    def begun_at(state: Array, evaluations: int, tolerance: float = TOLERANCE) -> Fit:
        problem = Problem(setup, plan, replace(variables, origin={name: state}), use)
        return fit_problem(problem, None, evaluations, tolerance)

    if near is not None:
        states = (known.mean, carried(near[1], near[0], setup, known.mean))
        return min((begun_at(state, _ENOUGH, _ROUGH) for state in states), key=lambda f: f.cost).initial(name)
    pasts = (known.mean, *_histories(setup, plan, substeps))
    begun = sorted((begun_at(state, _FEW) for state in pasts), key=lambda f: f.cost)
    ended: list[Fit] = []
    for first in begun[:_BEST]:
        ended.append(begun_at(first.initial_states[name], _ENOUGH))
        if ended[-1].chi2 <= _NOISE**2:
            break
    return min(ended, key=lambda f: f.cost).initial(name)


def _histories(setup: Setup, plan: Plan, substeps: int) -> list[Array]:
    """Return states (N,) to which an input leads that has come from rest by one turning point or two.

    What a material remembers of its past are the turning points of its input: their mean is no past.
    """
    (recording,) = plan.recordings
    states, size = [], float(np.ptp(recording.u))
    for history in _HISTORIES:
        turns = recording.u[0] + size * np.array(history)
        u = np.interp(np.linspace(0.0, turns.size - 1.0, recording.u.size), np.arange(turns.size), turns)
        past = replace(recording, u=u, start=Start("rest", float(turns[0])), instants=None)
        if (before := attempt("history of a recording", partial(simulate, setup, past, substeps), None)) is not None:
            states.append(before.states[-1])
    return states


def likely_start(setup: Setup, recording: Recording, substeps: int) -> Array | None:
    """Return (N,) the state in which a recording begins: estimated where its output was recorded and has a head, else
    the one that is expected before any sample is seen; None where its start says it."""
    if recording.mask("nuisance").any() and np.isfinite(recording.y).all():
        return estimated_start(setup, recording, substeps)
    known = variables_of(setup, Plan((recording,), {recording.name: substeps}, workers=1), ()).expected
    return known[recording.name].mean if recording.name in known else None


def _head_of(setup: Setup, recording: Recording, substeps: int, use: str) -> tuple[Setup, Plan]:
    """Return a recording as far as its head is concerned, and the setup for it.

    A slow drift is ignored: over so short a part it looks like a decaying motion.
    """
    setup = replace(setup, own=setup.own._replace(drift_terms=0))
    last = int(np.flatnonzero(recording.mask(use))[-1]) + 1 + _BEYOND
    # Which lines a recording can hold is asked of the whole of it; what comes later takes time to simulate and tells
    # nothing of the initial state.
    head = recording if setup.own.lines else recording.only(slice(last))
    return setup, Plan((head,), {recording.name: substeps}, workers=1)


def with_starts(setup: Setup, plan: Plan) -> Fit:
    """A setup on a plan, its parameters held, with every unknown initial state estimated recording by recording."""
    variables = variables_of(setup, plan, ())
    unknown = [r for r in plan.recordings if r.name in variables.unknown]
    starts = {r.name: estimated_start(setup, r, plan.steps_of(r), "identification") for r in unknown}
    origin = dict(variables.origin) | {n: state for n, state in starts.items() if state is not None}
    return fit_problem(Problem(setup, plan, replace(variables, origin=origin)), max_evaluations=1)


# Evaluations for the instants of jumps: few, for the output is nearly linear in them.
_INSTANTS = 15


@dataclass(frozen=True)
class PartScore:
    """Attributes:
    fit_percent: ``100 (1 − ‖y − ŷ‖/‖y − mean(y)‖)``; rmse: SI; residual_over_noise: rmse over the noise floor.
    """

    name: str
    use: str
    fit_percent: float
    rmse: float
    residual_over_noise: float

    @property
    def numbers(self) -> dict[str, float]:
        """Return the three scores by name."""
        return {n: getattr(self, n) for n in ("fit_percent", "rmse", "residual_over_noise")}


@dataclass(frozen=True)
class Evaluation:
    """Model output by recording, zero and nuisances included, and the scores of its parts."""

    outputs: Mapping[str, Array]
    parts: tuple[PartScore, ...]

    def table(self) -> dict[str, dict[str, float]]:
        """Return the scores by part name."""
        return {p.name: p.numbers for p in self.parts}

    def over_noise(self, use: str) -> float:
        """Return the root mean square of the residual over noise over the parts of one use; NaN without any."""
        ratios = [p.residual_over_noise for p in self.parts if p.use == use]
        return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else float("nan")


def evaluate(
    setup: Setup, plan: Plan, initial: Mapping[str, Array], near: Mapping[str, Begun] | None = None
) -> Evaluation:
    """Simulate all recordings of a plan and score their parts.

    The zero of a recording comes from its identification part where it has one, else from its nuisance part, unless it
    is a parameter that all recordings share. The initial state of a recording whose start is unknown and that took no
    part in the fit comes from the same part. The nuisances of the setup are fitted to the whole recording, scored or
    not: nothing predicts them, so what is left beside them is what a model can be held to. The same holds for the
    instants at which the input jumps, unless the fit has estimated them.

    Args:
        initial: initial states estimated by the fit, by recording name.
        near: where another model begins other recordings, see `estimated_start`.
    """

    def one(recording: Recording) -> Array:
        initial_state = initial.get(recording.name)
        if not setup.has_zero and recording.offset != "own":
            recording = replace(recording, offset="own")
        nuisance, steps = recording.mask("nuisance"), plan.steps_of(recording)
        if initial_state is None and nuisance.any():
            initial_state = estimated_start(setup, recording, steps, near=(near or {}).get(recording.name))
        if not instants_known(recording):
            recording, _ = with_instants(setup, recording, steps, initial_state)
        y = simulate(setup, recording, steps, initial=initial_state).y
        mask = zero_mask(recording)
        if setup.own != NOTHING:
            # From all samples: a stretch shorter than a period could not tell them from the zero.
            y = y + _own_parts(setup, recording, y)
        if recording.offset == "own":
            hidden = beyond_limit(recording, y, mask)
            counted = mask if hidden is None else mask & ~hidden
            y = y + np.mean((recording.y - y)[counted if counted.any() else mask])
        return recording.sensor.limited(np.asarray(y))

    outputs = plan.each(one, simulations=1.0)
    return scored(plan.recordings, {r.name: y for r, y in zip(plan.recordings, outputs, strict=True)})


def zero_mask(recording: Recording) -> NDArray[np.bool_]:
    """Return (N,) samples that give the zero of an output: those for identification, else for nuisances, else all."""
    masks = (recording.mask("identification"), recording.mask("nuisance"), np.ones(recording.t.size, dtype=bool))
    return next(m for m in masks if m.any())


def with_zero(recording: Recording, y: Array) -> Array:
    """Return an output (N,) with the recording's own zero."""
    return np.asarray(y + np.mean((recording.y - y)[zero_mask(recording)]))


def scored(recordings: Sequence[Recording], outputs: Mapping[str, Array]) -> Evaluation:
    """Score outputs, by recording, on all parts but those for nuisances."""
    parts = ((r, p) for r in recordings for p in r.parts if p.use != "nuisance")
    scores = tuple(score_part(r, outputs[r.name], p.first, p.last, p.name, p.use) for r, p in parts)
    return Evaluation(outputs, scores)


def _own_parts(setup: Setup, recording: Recording, y: Array) -> Array:
    """Return (N,) what a recording adds of its own to the model's output ``y``, up to a constant."""
    hidden = beyond_limit(recording, y, np.ones(recording.t.size, dtype=bool), setup.own)
    if hidden is None:
        return own_parts(recording.y - y, slice(None), recording, setup.own)
    return constant_and_own(recording.y - y, ~hidden, recording, setup.own)


def with_instants(setup: Setup, recording: Recording, substeps: int, initial: Array | None) -> tuple[Recording, Array]:
    """Return the recording with the instants of its input's jumps estimated from its whole output, the model held.

    Args:
        initial: initial state; None where the recording's start says it.

    Returns:
        The recording, unchanged where its output was not recorded or its input has no jumps to be placed, and the
        covariance (G, G) of the estimated instants in sample intervals².
    """
    unknown = unknown_instants(recording)
    if not unknown.size or not np.isfinite(recording.y).all():
        return recording, np.zeros((0, 0))
    whole = replace(recording, parts=(Part(recording.name, 0, recording.t.size, "identification"),))
    plan = Plan((whole,), {recording.name: substeps}, workers=1)
    held = {} if initial is None else {recording.name: initial}
    problem = Problem(setup, plan, Variables((), (), np.zeros(0), held, {recording.name: unknown}))
    fitted = fit_problem(problem, max_evaluations=_INSTANTS)
    return replace(recording, instants=fitted.plan.recordings[0].instants), fitted.scatter.covariance


def score_part(recording: Recording, y: Array, first: int, last: int, name: str, use: str) -> PartScore:
    rows = np.arange(first, last)
    rows = rows if recording.seen is None else rows[recording.seen[rows]]
    measured, model = recording.y[rows], y[rows]
    error = measured - model
    rmse = float(np.sqrt(np.mean(error**2)))
    # The mean of a constant is rounded: the rest beside the mean is no motion.
    span = float(np.linalg.norm(measured - measured.mean())) if np.ptp(measured) > 0.0 else 0.0
    fit_percent = 100.0 * (1.0 - float(np.linalg.norm(error)) / span) if span > 0.0 else float("nan")
    return PartScore(name, use, fit_percent, rmse, rmse / recording.noise)
