"""Matched accuracy: the loosest setting with which a solver meets a target, recording by recording.

A solver climbs a ladder of tolerances or sub-steps. The error of a recording is the relative norm of what is computed
for it, and every recording has to meet the target: it is the worst one that counts. Whoever solves recordings with
different settings may choose them separately, peers as well as phnn.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.case import Array, Solve

_TRIALS = 3

Prepare = Callable[[Sequence[float]], Solve]


@dataclass(frozen=True)
class Solver:
    """One way to solve the case.

    Attributes:
        name: in the tables.
        rungs: settings of its ladder, the loosest first.
        prepare: settings by recording to a solve that is ready to run.
        note: what is special about this variant of it, for the table.
    """

    name: str
    rungs: tuple[float, ...]
    prepare: Prepare
    note: str = ""


@dataclass(frozen=True)
class Choice:
    """What a solver needs for a target.

    Attributes:
        solver: the solver, or the fastest of its variants.
        target: relative error that the worst recording must meet.
        settings: by recording; None where the ladder does not reach the target.
        error: of the worst recording with these settings, or the least that was reached.
    """

    solver: Solver
    target: float
    settings: tuple[float, ...] | None
    error: float

    def setting(self) -> str:
        """The settings in short, for the table."""
        if self.settings is None:
            return ""
        ends = dict.fromkeys((min(self.settings), max(self.settings)))
        # A number of sub-steps is 1 or more, a tolerance is less.
        if min(ends) >= 1.0:
            text = " to ".join(f"{s:.0f}" for s in ends) + " sub-steps"
        else:
            text = "tolerance " + " to ".join(f"{s:.0e}" for s in ends)
        return text + (f", {self.solver.note}" if self.solver.note else "")


def relative_errors(value: Array, truth: Array) -> Array:
    """(R,) ``‖value_r − truth_r‖ / ‖truth_r‖``; infinite where the value is not finite."""
    errors = np.linalg.norm(value - truth, axis=1) / np.linalg.norm(truth, axis=1)
    return np.where(np.isfinite(errors), errors, np.inf)


def climb(solver: Solver, truth: Array, targets: Sequence[float]) -> list[Choice]:
    """The loosest settings for every target.

    Args:
        truth: (R, …) what is to be computed.
    """
    errors: list[Array] = []
    for rung in solver.rungs:
        # One rung beyond, for those who have to tighten.
        enough = bool(errors) and (np.min(errors, axis=0) <= min(targets)).all()
        errors.append(relative_errors(solver.prepare([rung] * len(truth))(), truth))
        if enough:
            break
    table = np.array(errors)
    return [_confirmed(solver, truth, target, table) for target in targets]


def _confirmed(solver: Solver, truth: Array, target: float, table: Array) -> Choice:
    """The loosest settings by a table (rungs, R) of errors, tightened until their own run meets the target.

    A run with different settings may differ from the climb in the last bits, and an adaptive solver that accepts or
    rejects its steps by them in more than these.
    """
    met = table <= target
    while met.any(axis=0).all():
        first = met.argmax(axis=0)
        settings = tuple(solver.rungs[i] for i in first)
        errors = relative_errors(solver.prepare(settings)(), truth)
        if errors.max() <= target:
            return Choice(solver, target, settings, float(errors.max()))
        met[first[errors > target], np.flatnonzero(errors > target)] = False
    return Choice(solver, target, None, float(table.min(axis=0).max()))


def choose(variants: Sequence[Solver], truth: Array, targets: Sequence[float]) -> list[Choice]:
    """The fastest variant of a solver for every target, each with its own loosest settings."""
    climbed = [climb(v, truth, targets) for v in variants]
    return [_fastest([choices[i] for choices in climbed]) for i in range(len(targets))]


def _fastest(choices: Sequence[Choice]) -> Choice:
    able = [c for c in choices if c.settings is not None]
    if len(able) < 2:
        return able[0] if able else min(choices, key=lambda c: c.error)
    return min(able, key=_trial)


def _trial(choice: Choice) -> float:
    """Seconds of the fastest of a few runs."""
    solve = choice.solver.prepare(choice.settings or ())
    seconds = []
    for _ in range(_TRIALS):
        begin = time.perf_counter()
        solve()
        seconds.append(time.perf_counter() - begin)
    return min(seconds)
