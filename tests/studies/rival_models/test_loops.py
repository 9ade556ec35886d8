"""Models in a closed loop with a spring."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from phnn.model import Model
from phnn.models.actuator import hrc
from phnn.setup import Setup
from studies.rival_models.loops import ExportedStepper, Run, closed, drawn_runs
from studies.rival_models.loops import _path as path_of
from studies.rival_models.rival import State, Stepper

DT, M, K, ALPHA = 1e-4, 1e-3, 5e4, 5.0


class Oscillator(Stepper):
    """``m q̈ + b q̇ + k q = α u`` with ``u`` straight between samples, exactly."""

    def __init__(self, b: float) -> None:
        self.dt = DT
        a = np.zeros((4, 4))
        a[0, 1], a[1, :3], a[2, 3] = 1.0, [-K / M, -b / M, ALPHA / M], 1.0 / DT
        self._next = expm(a * DT)[:2]

    def rest(self, u: float) -> State:
        return np.array([ALPHA * u / K, 0.0, u])

    def step(self, state: State, u: float) -> tuple[State, float]:
        x = self._next @ np.append(state, u - state[2])
        return np.append(x, u), float(x[0])


def test_a_loop_with_a_spring_is_a_stiffer_oscillator_once_it_rests() -> None:
    run = Run(np.full(20_000, 40.0), 0.0, 2.0 * K / ALPHA)
    y, solved = path_of(Oscillator(2.0), run, 1.0)
    assert solved
    assert y[-1] == pytest.approx(ALPHA * 40.0 / (3.0 * K), rel=1e-6)


def test_a_model_that_gives_energy_is_found_out() -> None:
    gain = ALPHA / K
    runs = drawn_runs(5, (0.4, DT), 75.0, 150.0, K / ALPHA, 3)
    assert closed(Oscillator(2.0), runs, gain).diverged == 0
    assert closed(Oscillator(2.0), runs, gain).gained == 0
    # Negative damping: some runs leave the range, slower ones only grow.
    assert closed(Oscillator(-2.0), runs, gain).diverged == 5
    slow = closed(Oscillator(-0.01), [Run(r.v, r.before, 0.0) for r in runs], gain)
    assert slow.diverged + slow.gained == 5


class Lost(Oscillator):
    """Leaves the finite numbers, or fails, at the first sample."""

    def __init__(self, fails: bool) -> None:
        super().__init__(2.0)
        self._fails = fails

    def step(self, state: State, u: float) -> tuple[State, float]:
        if self._fails:
            raise ValueError("array must not contain infs or NaNs")
        return state, 1e3


@pytest.mark.parametrize(("fails", "unsolved"), [(True, 2), (False, 0)])
def test_a_model_that_diverges_at_the_first_sample_is_counted(fails: bool, unsolved: int) -> None:
    runs = [Run(r.v, r.before, 0.0) for r in drawn_runs(2, (0.1, DT), 75.0, 150.0, K / ALPHA, 3)]
    found = closed(Lost(fails), runs, ALPHA / K)
    assert (found.diverged, found.unsolved, found.gained) == (2, unsolved, 0)


def test_runs_end_without_drive_and_follow_the_seed() -> None:
    first, again, other = (drawn_runs(2, (0.1, DT), 75.0, 150.0, K / ALPHA, s) for s in (1, 1, 2))
    assert all(np.array_equal(a.v, b.v) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0].v, other[0].v)
    assert all(not r.v[500:].any() and np.abs(r.v).max() <= 75.0 for r in first)
    assert all(0.1 * K / ALPHA <= r.pull <= 3.0 * K / ALPHA for r in first)


def test_an_exported_model_steps_as_it_is_simulated() -> None:
    model = Model(Setup(hrc()))
    t = np.arange(400) * DT
    u = 60.0 * np.sin(2.0 * np.pi * 50.0 * t)
    stepper = ExportedStepper(model, DT)
    state, y = stepper.rest(0.0), []
    for value in u:
        state, out = stepper.step(state, float(value))
        y.append(out)
    # The first sample is reached one step after rest at zero, which changes nothing.
    expected = model.simulate(t, u, hold="linear")
    assert np.max(np.abs(np.array(y) - expected)) < 1e-3 * np.max(np.abs(expected))
