"""Creep: a Maxwell cell beside the spring."""

from __future__ import annotations

import numpy as np

from phnn.effects import Effect, Parts, Scales, has_motion, kinds, positive
from phnn.network.elements import Coupling, Resistor, Storage


def grid(scales: Scales) -> list[dict[str, float]]:
    """Relaxation times from the fastest period to the longest recording."""
    times = np.geomspace(0.1 / scales.fastest, 2.0 * scales.duration, 10)
    return [{"k_s": 1e-3 * scales.stiffness, "tau_s": float(t)} for t in times]


EFFECT = Effect(
    name="creep",
    kind=kinds.MEMORY,
    equation=r"F_s = k_s\,s, \quad \dot{s} = v - s/\tau_s",
    statement="Part of the stiffness relaxes: a spring of {k_s} gives way with a time constant of {tau_s}, so the "
    "displacement goes on growing after a change of voltage.",
    fingerprint="The displacement goes on growing long after a step, and the gain falls slowly towards high "
    "frequencies at a nearly constant phase.",
    separation="A step to a constant voltage held ten times the creep time and back to zero: creep recovers "
    "completely, a drifting sensor goes on in one direction, a hysteron stops.",
    references=("Findley, Lai & Onaran 1976, Creep and Relaxation of Nonlinear Viscoelastic Materials",),
    declares=(
        positive("k_s", "N/m", "stiffness of the relaxing spring", 1e8, strength=True).plausibly(
            0.0, 0.25, "piezo actuators creep by up to a quarter of a step in minutes to hours", over="k"
        ),
        positive("tau_s", "s", "creep time", 1e3).plausibly(
            1e-3, 1e5, "creep goes on over many decades of time, from milliseconds to days"
        ),
    ),
    adds=Parts(
        (Storage("s", "spring", ("k_s",), "m"),),
        (Resistor("creep", "maxwell", {"s": 1.0}, ("k_s", "tau_s")),),
        (Coupling("s", "p", 1.0),),
    ),
    grid=grid,
    applies=has_motion,
    neighbours=("extra_hysteron", "sensor_drift"),
    at_most=3,
)
