"""The state in which a recording begins, from its first samples alone, the model held."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from phnn.identification.fit import Fit, fit_problem
from phnn.identification.plan import Plan
from phnn.identification.problem import Problem
from phnn.identification.variables import Variables, variables_of
from phnn.recordings.recording import Recording
from phnn.setup import Setup

Array = NDArray[np.float64]

# Samples beyond those that are fitted: an input between samples depends on the ones after it.
_BEYOND = 200
# An initial state is sought from so many states drawn from its prior, for thresholds bend the way to it: a few
# evaluations from each, and enough from the best ones, until one leaves hardly more than the noise.
_DRAWN, _FEW, _BEST, _ENOUGH, _SEED = 5, 12, 3, 60, 0
_NOISE = 1.2


def estimated_start(setup: Setup, recording: Recording, substeps: int, use: str = "nuisance") -> Array | None:
    """(N,) initial state of a recording, estimated from the samples of one use, those of the head that is not scored;
    None where its start says it."""
    setup, plan = _head_of(setup, recording, substeps, use)
    variables = variables_of(setup, plan, ())
    if not variables.unknown:
        return None
    starts = [variables.expected[recording.name].mean, *_draws(variables, recording.name, _DRAWN)]
    begun = sorted(
        (_fitted(setup, plan, _beginning(variables, recording.name, x), use, _FEW) for x in starts), key=_cost
    )
    ended: list[Fit] = []
    for found in begun[:_BEST]:
        last = _beginning(variables, recording.name, found.initial(recording.name))
        ended.append(_fitted(setup, plan, last, use, _ENOUGH))
        if ended[-1].chi2 <= _NOISE**2:
            break
    return min(ended, key=_cost).initial(recording.name)


def likely_start(setup: Setup, recording: Recording, substeps: int) -> Array | None:
    """(N,) the state in which a recording begins: estimated where its output was recorded and has a head, else the one
    that is expected before any sample is seen; None where its start says it."""
    if recording.mask("nuisance").any() and np.isfinite(recording.y).all():
        return estimated_start(setup, recording, substeps)
    known = variables_of(setup, Plan((recording,), {recording.name: substeps}, workers=1), ()).expected
    return known[recording.name].mean if recording.name in known else None


def _cost(fitted: Fit) -> float:
    return fitted.cost


def _head_of(setup: Setup, recording: Recording, substeps: int, use: str) -> tuple[Setup, Plan]:
    """A recording as far as its head is concerned, and the setup for it.

    A slow drift is ignored: over so short a part it looks like a decaying motion.
    """
    setup = replace(setup, own=setup.own._replace(drift_terms=0))
    last = int(np.flatnonzero(recording.mask(use))[-1]) + 1 + _BEYOND
    # Which lines a recording can hold is asked of the whole of it; what comes later takes time to simulate and tells
    # nothing of the initial state.
    head = recording if setup.own.lines else recording.only(slice(last))
    return setup, Plan((head,), {recording.name: substeps}, workers=1)


def _draws(variables: Variables, name: str, count: int) -> list[Array]:
    """Initial states drawn from the prior."""
    rng, expected = np.random.default_rng(_SEED), variables.expected[name]
    return [expected.mean + expected.spread * rng.standard_normal(expected.mean.size) for _ in range(count)]


def _beginning(variables: Variables, name: str, state: Array | None) -> Variables:
    return variables if state is None else replace(variables, origin={name: state})


def _fitted(setup: Setup, plan: Plan, variables: Variables, use: str, evaluations: int) -> Fit:
    return fit_problem(Problem(setup, plan, variables, use), max_evaluations=evaluations)


def with_starts(setup: Setup, plan: Plan) -> Fit:
    """A setup on a plan, its parameters held, with every unknown initial state estimated recording by recording."""
    variables = variables_of(setup, plan, ())
    unknown = [r for r in plan.recordings if r.name in variables.unknown]
    found = {r.name: estimated_start(setup, r, plan.steps_of(r), "identification") for r in unknown}
    origin = dict(variables.origin) | {n: state for n, state in found.items() if state is not None}
    return _fitted(setup, plan, replace(variables, origin=origin), "identification", 1)
