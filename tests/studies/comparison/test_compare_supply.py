"""The energy that random inputs supply from rest: closed forms, passive networks, models that give back too much."""

from __future__ import annotations

from collections.abc import Sequence

import compare_example as example
import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from phnn.errors import SolverFailed
from phnn.learn.plant import LatentPlant
from phnn.learn.solvers import Torchdiffeq, averaged
from phnn.learn.starts import scales_of
from phnn.models.actuator import from_paper, hrc
from phnn.models.bouc_wen import bouc_wen
from phnn.models.fully_neural import FullyNeural
from phnn.models.neural_ode import NeuralODE
from phnn.recordings.recording import Recording
from phnn.setup import Setup
from studies.comparison.supply import extracted, of_plant, of_setup, random_inputs, supply

Array = NDArray[np.float64]
COUNT = 60
RECORDINGS = [example.recording(50.0), example.recording(100.0)]


def test_share_that_a_sine_extracts() -> None:
    phase = np.linspace(0.0, 2.0 * np.pi, 4001)
    u = np.sin(phase)
    # A spring gives back what it got, a resistance nothing, and a negative one all.
    assert extracted(u, u) < 1e-6
    assert extracted(u, 1.0 - np.cos(phase)) == 0.0
    assert extracted(u, np.cos(phase) - 1.0) == pytest.approx(1.0)
    # An output ahead of the input taps the area of its ellipse.
    ahead = np.sin(phase + 0.1) - np.sin(0.1)
    moved = np.abs(np.diff(ahead) * 0.5 * (u[1:] + u[:-1])).sum()
    assert extracted(u, ahead) == pytest.approx(np.pi * np.sin(0.1) / moved, rel=0.05)
    assert extracted(u, np.full(phase.size, np.nan)) == np.inf


def test_inputs_begin_at_rest_and_stay_within_the_recorded() -> None:
    found = random_inputs(RECORDINGS, COUNT, 1)
    peaks = [float(np.abs(r.u).max()) for r in found]
    assert all(r.u[0] == 0.0 for r in found)
    assert max(peaks) <= 75.0
    assert min(peaks) < 10.0
    again = random_inputs(RECORDINGS, COUNT, 1)
    assert all(np.array_equal(a.u, b.u) for a, b in zip(found, again, strict=True))


def test_networks_extract_nothing() -> None:
    for setup in (Setup(from_paper()), Setup(hrc(0, {"m": 1e-3, "k": 2e4, "b": 3.0, "alpha": 0.04}))):
        found = supply(of_setup(setup), RECORDINGS, COUNT)
        assert (found.inputs, found.failed, found.violations, found.worst) == (COUNT, 0, 0, 0.0)


def test_a_block_before_the_network_may_extract() -> None:
    # A Bouc–Wen block of the wrong sign adds to the voltage what it should take away.
    found = supply(of_setup(bouc_wen({"w": -400.0, "gamma": 0.0})), RECORDINGS, COUNT)
    assert found.violations > COUNT // 10
    assert found.worst > 0.01


def test_models_without_a_guarantee_are_counted() -> None:
    with torch.no_grad():
        tame, wild = (LatentPlant(core(scales_of(RECORDINGS), 3, 4)) for core in (FullyNeural, NeuralODE))
        found = supply(of_plant(tame, averaged), RECORDINGS, COUNT)
        assert found.inputs == COUNT
        responses = of_plant(wild, Torchdiffeq(wild, "rk4", adjoint=False))
        assert supply(responses, RECORDINGS, COUNT).violations > 0


def test_what_cannot_be_simulated_is_not_counted_as_passive() -> None:
    def refuse(inputs: Sequence[Recording]) -> list[Array]:
        raise SolverFailed("no step")

    found = supply(refuse, RECORDINGS, COUNT)
    assert (found.inputs, found.failed) == (0, COUNT)
    diverged = supply(lambda inputs: [np.full(r.t.size, np.inf) for r in inputs], RECORDINGS, COUNT)
    assert diverged.violations == COUNT
