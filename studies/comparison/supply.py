"""A necessary condition of passivity that every model from voltage to displacement can be held against.

The source drives the actuator through the coupling alone, with the force ``αV`` on the moving mass: the power that it
supplies is ``αV q̇``, whatever hysterons do. From rest nothing is stored yet, so that a passive actuator has

    W(t) = ∫_0^t V q̇ dt ≥ 0     for every input and every t,

since ``αW = H(x(t)) − H(0) + dissipation``. A model that falls below has given back more than it was given. It needs no
state of the model, hence judges all kinds alike; it is necessary, not sufficient. A model that is passive for another
pair of port variables than voltage and displacement may well violate it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np
import torch
from numpy.typing import NDArray

from phnn.errors import SolverFailed
from phnn.learn.plant import Plant
from phnn.learn.solvers import Solver
from phnn.learn.windows import windows_of
from phnn.recordings.recording import Recording, dominant_frequency, unrecorded
from phnn.setup import Setup
from phnn.simulate import simulate

Array = NDArray[np.float64]
Response = Callable[[Sequence[Recording]], list[Array]]

_TONES, _SAMPLES, _PERIODS = 4, 257, 2
_DECADES, _WEAKEST = 1.0, 0.03
# What counts as extracted, over all that went to and fro: more than solvers and the trapezoidal rule are wrong by.
_TOLERANCE = 1e-3
_BATCH = 1000


def supply(respond: Response, recordings: Sequence[Recording], count: int, seed: int = 0) -> tuple[int, int]:
    """Simulate a model from rest under random inputs and account for the energy that it was supplied with.

    Args:
        respond: displacement (N,) for inputs from rest.
        recordings: give frequencies and largest input: those for identification.
        count: how many inputs.
        seed: of the inputs.

    Returns:
        Under how many inputs ``W`` falls below zero by more than a thousandth of ``∫|V q̇| dt``, or the output leaves
        the finite numbers; and how many could be simulated.
    """
    inputs, shares = random_inputs(recordings, count, seed), list[float]()
    for first in range(0, count, _BATCH):
        batch = inputs[first : first + _BATCH]
        with suppress(SolverFailed):
            shares += [extracted(r.u, q) for r, q in zip(batch, respond(batch), strict=True)]
    return sum(s > _TOLERANCE for s in shares), len(shares)


def extracted(u: Array, q: Array) -> float:
    """Largest energy below zero over all that went to and fro, ``max_t −W(t) / ∫|V q̇| dt``; ∞ if ``q`` diverged."""
    if not np.isfinite(q).all():
        return float("inf")
    power = 0.5 * (u[1:] + u[:-1]) * np.diff(q)
    moved = float(np.abs(power).sum())
    return max(0.0, -float(np.cumsum(power).min()) / moved) if moved else 0.0


def random_inputs(recordings: Sequence[Recording], count: int, seed: int) -> list[Recording]:
    """Sums of four sines from zero within the decade below the highest frequency, peaks over a range of sizes."""
    random = np.random.default_rng(seed)
    highest = max(dominant_frequency(r) for r in recordings)
    largest = max(float(np.abs(r.u).max()) for r in recordings)
    found = []
    for k in range(count):
        frequencies = highest * 10.0 ** (-_DECADES * random.random(_TONES))
        t = np.linspace(0.0, _PERIODS / frequencies.min(), _SAMPLES)
        u = np.sin(2.0 * np.pi * np.outer(t, frequencies)) @ random.standard_normal(_TONES)
        u *= largest * _WEAKEST ** random.random() / np.abs(u).max()
        found.append(unrecorded(f"random {k}", t, u))
    return found


def of_setup(setup: Setup) -> Response:
    """The response of a network behind its amplifier."""

    def respond(inputs: Sequence[Recording]) -> list[Array]:
        return [simulate(setup, r).y for r in inputs]

    return respond


def of_plant(plant: Plant, solver: Solver) -> Response:
    """The response of a trained model, all inputs at once."""

    @torch.no_grad()
    def respond(inputs: Sequence[Recording]) -> list[Array]:
        windows = windows_of(inputs, 0, 1)
        states = solver(plant, windows, torch.zeros(len(inputs), plant.scale.numel(), dtype=torch.float64))
        return [plant.measured(x).numpy() for x in states]

    return respond
