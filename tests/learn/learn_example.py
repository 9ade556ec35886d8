"""Small recordings of a gentle actuator, and plants to train on them."""

from __future__ import annotations

from functools import cache
from typing import Any

import campaigns
import numpy as np
import torch

from phnn.learn.solvers import NetworkPlant, Plant
from phnn.learn.starts import typical_states
from phnn.models.actuator import hrc
from phnn.models.neural import LearnedLaws, Motion, neural_hrc
from phnn.nn import LearnedSystem, Scales
from phnn.nn.learned_system import NeuralODE
from phnn.recordings.recording import Recording
from phnn.setup import Setup

VALUES = campaigns.GENTLE
NOISE = 60e-9
SCALES = Scales(1.0 / (2 * np.pi * 150.0), 75.0, 1.2e-4)


@cache
def recording(frequency: float = 50.0, samples: int = 81, amplitude: float = 75.0, seed: int = 0) -> Recording:
    """One period of a sine through the true actuator."""
    t = np.arange(samples) / (samples - 1) / frequency
    u = amplitude * np.sin(2 * np.pi * frequency * t)
    return campaigns.recorded(Setup(hrc(1, VALUES)), f"sine_{frequency:03.0f}", t, u, NOISE, seed)


def recordings() -> list[Recording]:
    """Two frequencies."""
    return [recording(50.0), recording(120.0, seed=1)]


def parametric(**moved: float) -> NetworkPlant:
    """The parametric network, some values moved."""
    network = hrc(1, VALUES | moved)
    return NetworkPlant(network, typical_states(network, recordings()))


def neural(width: int = 4, start: str = "none", **others: Any) -> NetworkPlant:
    """A network with a learned resistor, and other learned laws where they are given."""
    network = neural_hrc(1, LearnedLaws(width, **others), start, VALUES, Motion(speed=0.06), ("m",))
    return NetworkPlant(network, typical_states(network, recordings()))


def fully_neural(states: int = 3, width: int = 6, seed: int = 0) -> NetworkPlant:
    """A learned system whose energy is not the quadratic one it starts with."""
    system = LearnedSystem(states, ("voltage",), width, SCALES, seed)
    with torch.no_grad():
        heights = system.network.shared_energies[0].law.heights
        heights.normal_(generator=torch.Generator().manual_seed(seed)).mul_(0.3)
    return NetworkPlant(system.as_network(), torch.tensor([SCALES.output, *[1.0] * (states - 1)], dtype=torch.float64))


def neural_ode(states: int = 3, width: int = 6, seed: int = 0) -> Plant:
    """A black-box plant."""
    return Plant(NeuralODE(SCALES, states, width, seed), torch.ones(states, dtype=torch.float64))
