"""Creep: a Maxwell cell beside the spring."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from phnn.effects.effect import Effect, Plausible, Scales, has_motion, with_network
from phnn.network.elements import Coupling, Resistor, Storage
from phnn.parameters import positive
from phnn.setup import Setup


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``F += −k_s s``, ``ṡ = v − s/τ``: storage ``s`` with ``J[s, p] = 1`` and a linear resistor."""
    return with_network(
        setup,
        setup.network.extend(
            storages=(Storage("s", "spring", ("k_s",), "m"),),
            resistors=(Resistor("creep", "maxwell", {"s": 1.0}, ("k_s", "tau_s")),),
            couplings=(Coupling("s", "p", 1.0),),
            parameters=(
                positive("k_s", values["k_s"], "N/m", "stiffness of the relaxing spring", 1e8),
                positive("tau_s", values["tau_s"], "s", "creep time", 1e3),
            ),
        ),
    )


def grid(scales: Scales) -> list[dict[str, float]]:
    """Relaxation times from the fastest period to the longest recording."""
    shortest = 0.1 / scales.fastest
    times = np.geomspace(shortest, 2.0 * scales.duration, 10)
    return [{"k_s": 1e-3 * scales.stiffness, "tau_s": float(t)} for t in times]


EFFECT = Effect(
    name="creep",
    location="mechanical",
    kind="memory",
    equation=r"F_s = k_s\,s, \quad \dot{s} = v - s/\tau_s",
    statement="Part of the stiffness relaxes: a spring of {k_s} gives way with a time constant of {tau_s}, so the "
    "displacement goes on growing after a change of voltage.",
    fingerprint="The displacement goes on growing long after a step, and the gain falls slowly towards high "
    "frequencies at a nearly constant phase.",
    separation="A step to a constant voltage held ten times the creep time and back to zero: creep recovers its whole "
    "way, a drifting sensor does not turn round and a hysteron stops.",
    references=("Findley, Lai & Onaran 1976, Creep and Relaxation of Nonlinear Viscoelastic Materials",),
    passive=True,
    strength="k_s",
    one_sided=True,
    grid=grid,
    build=build,
    parameters=("k_s", "tau_s"),
    plausible={
        "k_s": Plausible(0.0, 0.25, "piezo actuators creep by up to a quarter of a step in minutes to hours", over="k"),
        "tau_s": Plausible(1e-3, 1e5, "creep goes on over many decades of time, from milliseconds to days"),
    },
    applies=has_motion,
    neighbours=("extra_hysteron", "sensor_drift"),
    at_most=3,
)
