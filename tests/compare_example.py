"""A gentle actuator's recordings, and settings of a comparison that cost little."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import campaigns
import numpy as np

from phnn.comparison.models import Settings
from phnn.configuration import compose
from phnn.models.actuator import hrc
from phnn.recordings.recording import Recording
from phnn.setup import Setup

NOISE = 60e-9
MANIFEST = f"""{campaigns.KNOWN}recordings:
  - {{file: sine_050Hz_75V.csv, use: identification}}
  - {{file: sine_100Hz_75V.csv, use: identification}}
  - {{file: sine_070Hz_75V.csv, use: confirmation}}
  - {{file: sine_070Hz_30V.csv, use: confirmation}}
"""
DRIVES = ((50.0, 75.0), (100.0, 75.0), (70.0, 75.0), (70.0, 30.0))
# A handful of steps of training each.
QUICK = (
    "starts=1", "workers=1", "budget=1.0", "models=all", "phs_neural.model.width=3",
    "phs_neural.stages.whole.gauss_newton=2", "phs_neural_adjoint.model.width=3",
    "phs_neural_adjoint.stages.whole.lbfgs=2",
    *(f"{m}.model.width=3" for m in ("neural_phs", "neural_ode")),
    *(f"{m}.model.states=3" for m in ("neural_phs", "neural_ode")),
    *(f"{m}.stages.{s}.lbfgs=1" for m in ("neural_phs", "neural_ode") for s in ("short", "long")),
    *(f"{m}.stages.{s}.lbfgs_iterations=1" for m in ("neural_phs", "neural_ode") for s in ("short", "long")),
    *(f"{m}.stages.long.window=51" for m in ("neural_phs", "neural_ode")),
    *(f"{m}.{key}" for m in ("neural_phs", "neural_ode") for key in ("longest_step=0.7", "least_per_period=20")),
)  # fmt: skip


@cache
def recording(frequency: float = 50.0, amplitude: float = 75.0) -> Recording:
    """Two and a half periods of a sine."""
    t = np.arange(251) / (100 * frequency)
    u = amplitude * np.sin(2 * np.pi * frequency * t)
    name = f"sine_{frequency:03.0f}Hz_{amplitude:g}V"
    return campaigns.recorded(Setup(hrc(1, campaigns.GENTLE)), name, t, u, NOISE, int(frequency))


def written(folder: Path) -> Path:
    """The recordings as a folder."""
    return campaigns.written(folder, (recording(*drive) for drive in DRIVES), MANIFEST)


def settings(*overrides: str) -> Settings:
    """Settings of the configuration with some moved."""
    return Settings.from_config(compose("compare", [*QUICK, *overrides]))
