"""Models in a closed loop with a compliant load: which of them diverge or give energy.

A spring of stiffness ``k_L`` between the moving mass and a fixed frame pulls with ``−k_L q``, which a model from
voltage to displacement feels as the voltage ``−(k_L/α) q``. At every sample the loop is closed without delay,

    u_n = v_n − (k_L/α) y_n,        y_n = model(state, u_n)

solved for ``u_n`` by secants. A passive actuator with this spring is passive: once the voltage rests at zero, what
moves decays (van der Schaft & Jeltsema 2014, Port-Hamiltonian Systems Theory, Ch. 2). Runs begin at rest under an input
that is not the one at which the drive begins: a wrong initial state.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.errors import PhnnError
from phnn.exporting import Wanted, write
from phnn.model import Model
from studies.rival_models.rival import State, Stepper

Array = NDArray[np.float64]

_SECANTS, _CLOSE = 25, 1e-9
_TONES = 3
# A run has diverged where the output exceeds the largest static one by this factor.
FAR = 10.0
# Growth of the motion at rest, from the third quarter of a run to the fourth, that no decay has; and the least share of
# the largest output that counts as motion.
GROWS, MOVES = 1.05, 1e-3
# What a model that has diverged may raise.
FAILS = (PhnnError, ArithmeticError, ValueError)


class ExportedStepper(Stepper):
    """A port-Hamiltonian model as `phnn export` writes it for a controller.

    Args:
        model: to export; dt: sampling interval, s.
    """

    def __init__(self, model: Model, dt: float) -> None:
        self.dt = dt
        with TemporaryDirectory() as folder:
            (path,) = write(model, Wanted("python", dt=dt, name="stepped"), Path(folder) / "stepped")
            spec = spec_from_file_location("stepped", path)
            assert spec is not None
            assert spec.loader is not None
            self._program = module_from_spec(spec)
            spec.loader.exec_module(self._program)

    def rest(self, u: float) -> Any:
        state = self._program.Model()
        for _ in range(settling(self.dt)):
            state.step(u)
        return state

    def step(self, state: Any, u: float) -> tuple[Any, float]:
        after = copy.deepcopy(state)
        return after, float(after.step(u))


def settling(dt: float) -> int:
    """Samples of a tenth of a second."""
    return max(1, round(0.1 / dt))


@dataclass(frozen=True)
class Loops:
    """Attributes:
    runs: how many; diverged: left the finite numbers or ten times the largest static output; gained: did not diverge,
        and moved more in the last quarter than in the one before, both without drive; unsolved: loop equation without a
        solution at some sample, counted among the diverged.
    """

    runs: int
    diverged: int
    gained: int
    unsolved: int


@dataclass(frozen=True)
class Run:
    """What one run is given: the voltage ``(N,)`` [V], the input before it [V], and ``k_L/α`` [V/m]."""

    v: Array
    before: float
    pull: float


def drawn_runs(
    count: int, times: tuple[float, float], peak: float, highest_Hz: float, stiffness: float, seed: int
) -> list[Run]:
    """Random voltages of three sines from the decade below a frequency for half of each run, then zero.

    Args:
        times: length of a run and sampling interval, s.
        peak: largest voltage, V.
        stiffness: ``k/α`` of the actuator, V/m; the load has between a tenth and three times of it.
        seed: of all draws.
    """
    rng, found = np.random.default_rng(seed), []
    t = np.arange(round(times[0] / times[1])) * times[1]
    for _ in range(count):
        tones = highest_Hz * 10.0 ** -rng.uniform(0.0, 1.0, _TONES)
        v = np.sin(2.0 * np.pi * np.outer(t, tones) + rng.uniform(0.0, 2.0 * np.pi, _TONES)) @ rng.normal(size=_TONES)
        v *= peak * rng.uniform(0.1, 1.0) / np.abs(v).max()
        v[t.size // 2 :] = 0.0
        found.append(Run(v, float(rng.uniform(-peak, peak)), 0.1 * 30.0 ** rng.uniform() * stiffness))
    return found


def closed(stepper: Stepper, runs: Sequence[Run], gain: float) -> Loops:
    """Close the loop around a model.

    Args:
        gain: static displacement per volt of the actuator, m/V.
    """
    diverged = gained = unsolved = 0
    for run in runs:
        far = FAR * gain * max(float(np.abs(run.v).max()), abs(run.before))
        y, solved = _path(stepper, run, far)
        if not solved or y.size < run.v.size:
            diverged += 1
            unsolved += not solved
        elif _grows(y):
            gained += 1
    return Loops(len(runs), diverged, gained, unsolved)


def _grows(y: Array) -> bool:
    """Whether the motion of a whole run grows from the third quarter to the fourth, and is large enough to count."""
    rest = y[y.size // 2 :] - y[-1]
    third, fourth = (float(np.sqrt(np.mean(part**2))) for part in np.array_split(rest, 2))
    return fourth > GROWS * third and fourth > MOVES * float(np.abs(y).max())


def _path(stepper: Stepper, run: Run, far: float) -> tuple[Array, bool]:
    """Output until the end or until it is too far away, and whether every sample had a solution."""
    state, y = stepper.rest(run.before), np.empty(run.v.size)
    u = run.before
    for n, v in enumerate(run.v):
        try:
            found = _solved(partial(stepper.step, state), float(v), run.pull, u)
        except FAILS:
            return y[:n], False
        if found is None:
            return y[:n], False
        state, u, y[n] = found
        if not abs(y[n]) < far:
            return y[:n], True
    return y, True


def _solved(
    step: Callable[[float], tuple[State, float]], v: float, pull: float, guess: float
) -> tuple[State, float, float] | None:
    """State, input and output with ``u = v − pull y(u)``; None where secants find none."""
    scale = abs(v) + abs(guess) + 1.0
    a, b = guess, guess - 1e-3 * scale
    error_a = a - v + pull * step(a)[1]
    for _ in range(_SECANTS):
        after, y = step(b)
        error_b = b - v + pull * y
        if not np.isfinite(error_b):
            return None
        if abs(error_b) <= _CLOSE * scale:
            return after, b, y
        slope = (error_b - error_a) / (b - a) if b != a else 1.0
        a, error_a = b, error_b
        b -= error_b / (slope or 1.0)
    return None
