"""Base models to which effects are added when they are checked, each with a short recording that moves it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from phnn.configuration import config_folder
from phnn.effects.effect import Effect, Scales
from phnn.models.actuator import from_paper
from phnn.models.network_file import load_network
from phnn.recordings.recording import Recording, Start
from phnn.setup import Setup
from phnn.trajectory import Trajectory, simulate


@dataclass(frozen=True, eq=False)
class Home:
    """A base model, the sizes met in its recordings, and one of them."""

    setup: Setup
    scales: Scales
    drive: Recording


def driven(t: np.ndarray, u: np.ndarray) -> Recording:
    """A recording from rest without an output: samples at ``t`` (N,) [s] of an input ``u`` (N,)."""
    unknown = np.full(t.size, np.nan)
    return Recording(
        "home", t, u, unknown, Start("rest"), "cubic", (), 1e-8, "assumed", np.ones(1), None, {}, "made"
    )  # fmt: skip


@cache
def actuator() -> Home:
    """The piezo actuator of the paper: two amplitudes of a sine from rest."""
    scales = Scales(
        voltage=75.0, displacement=1.2e-4, velocity=0.1, stiffness=24579.0, transducer=0.046, slowest=20.0,
        fastest=150.0, duration=0.02, noise=5e-8,
    )  # fmt: skip
    t = np.arange(401) * 5e-5
    u = 75.0 * np.sin(2 * np.pi * 100.0 * t) * np.where(t < 0.01, 0.4, 1.0)
    return Home(Setup(from_paper()), scales, driven(t, u))


@cache
def tanks() -> Home:
    """A pump that fills two tanks by swells of two sizes."""
    scales = Scales(
        voltage=1e-4, displacement=1.4e-3, velocity=2e-4, stiffness=1.0, transducer=1.0, slowest=0.02, fastest=0.05,
        duration=100.0, noise=1e-6,
    )  # fmt: skip
    t = np.arange(401) * 0.25
    u = 5e-5 * (1.0 - np.cos(2 * np.pi * 0.04 * t)) * np.where(t < 50.0, 0.4, 1.0)
    return Home(Setup(load_network(config_folder() / "network" / "tanks.yaml")), scales, driven(t, u))


def home_of(effect: Effect) -> Home | None:
    """The base model for an effect: the actuator if the effect applies to it, else the tanks; None if it applies to
    neither."""
    return next((h for h in (actuator(), tanks()) if effect.can_be_added_to(h.setup)), None)


def simulated(setup: Setup, home: Home) -> Trajectory:
    """A setup driven by the recording of a home."""
    return simulate(setup, home.drive)


@cache
def base_of(home: Home) -> Trajectory:
    """The simulation without an effect."""
    return simulated(home.setup, home)


# The first grid point changes the output hardly; multiplied by this factor, its strength is visible.
_SEEN = 50.0


def point(effect: Effect, home: Home) -> dict[str, float]:
    """The first point of the effect's grid, scaled to a visible strength."""
    return effect.scaled(effect.grid(home.scales)[0], _SEEN)


def added(effect: Effect, values: dict[str, float], home: Home) -> Trajectory:
    """The simulation with one effect at parameter values [SI]."""
    return simulated(effect.add_to(home.setup, values), home)
