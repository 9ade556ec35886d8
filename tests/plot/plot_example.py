"""A small campaign of a known model, with white noise, and every plot of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from campaigns import GENTLE

import phnn
from phnn.models.actuator import hrc
from phnn.plot.frequency import residual_tests, response, whiteness
from phnn.plot.signals import balance, hysteresis, outputs
from phnn.recordings.recording import Campaign, Part, Recording, Start, unrecorded
from phnn.setup import Setup
from phnn.trajectory import simulate

VALUES = GENTLE
NOISE, DT, SAMPLES = 50e-9, 1e-4, 2000
MODEL = phnn.Model(Setup(hrc(1, VALUES)), 2)
WRONG = phnn.Model(Setup(hrc(1, VALUES | {"d_1": 4.0, "C_1": 3.0e-7})), 2)
LINEAR = phnn.Model(Setup(hrc(0, {n: VALUES[n] for n in ("m", "k", "b", "alpha")})), 2)
T = DT * np.arange(SAMPLES)


def sine(frequency: float, amplitude: float) -> np.ndarray:
    """(N,) input, V."""
    return amplitude * np.sin(2.0 * np.pi * frequency * T)


def recording(
    name: str,
    u: np.ndarray,
    period: float | None = None,
    model: phnn.Model = MODEL,
    noise: float = NOISE,
    seed: int = 0,
) -> Recording:
    """What a model does under an input, with noise."""
    blank = unrecorded(name, T, u)
    y = simulate(model.setup, blank, 2).y + noise * np.random.default_rng(seed).standard_normal(SAMPLES)
    part = Part(name, 0, SAMPLES, "identification")
    return replace(
        blank, y=y, parts=(part,), noise=noise or 1e-12, noise_source="stated", period=period, start=Start("rest", 0.0)
    )  # fmt: skip


def campaign_of(*recordings: Recording) -> Campaign:
    """Recordings without a folder."""
    return Campaign(recordings, {}, {}, "command", (), False, "nowhere")


@cache
def campaign() -> Campaign:
    """Two amplitudes of one sine, another sine, and a broadband input."""
    smooth = np.convolve(np.random.default_rng(1).standard_normal(SAMPLES), np.hanning(25) / 6.0, "same")
    return campaign_of(
        recording("large", sine(20.0, 60.0), 0.05, seed=2),
        recording("small", sine(20.0, 30.0), 0.05, seed=3),
        recording("fast", sine(50.0, 60.0), 0.02, seed=4),
        recording("broad", 40.0 * smooth * np.minimum(1.0, T / 5e-3), seed=5),
    )


FREQUENCIES = np.array([5.0, 20.0, 50.0, 200.0])

# What each function draws, and the number of its panels.
PLOTS: dict[str, tuple[Callable[[], Any], int]] = {
    "compare": (lambda: outputs(MODEL, campaign()), 8),
    "residuals": (lambda: whiteness(residual_tests(MODEL, campaign(), ["large", "broad"])), 6),
    "loops": (lambda: hysteresis(MODEL, campaign()), 2),
    "bode": (lambda: response(MODEL, FREQUENCIES, 60.0, campaign=campaign()).plot(), 3),
    "energy": (lambda: balance(MODEL.trajectory(T, sine(20.0, 60.0))).plot(), 3),
}


@cache
def computed(kind: str) -> Any:
    """A plot, computed once."""
    return PLOTS[kind][0]()
