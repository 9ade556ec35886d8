"""A second mode: one more mass on a spring and a damper."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from phnn.effects import Effect, Parts, Scales, has_motion, kinds, positive
from phnn.network.elements import Coupling, Resistor, Storage


def grid(scales: Scales) -> list[dict[str, float]]:
    """Weakly and strongly damped modes around the highest excited frequency."""
    mass = 1e-3 * scales.stiffness / (2.0 * np.pi * 2.0 * scales.fastest) ** 2
    rates = [2.0 * np.pi * share * scales.fastest for share in (0.5, 1.0, 1.5, 2.5, 5.0)]
    return [
        {"m_2": mass, "k_2": mass * omega**2, "b_2": 2.0 * ratio * mass * omega}
        for omega in rates
        for ratio in (0.02, 0.2)
    ]


def rescale(values: Mapping[str, float], factor: float) -> dict[str, float]:
    """Scale the mass, the strength; frequency and damping ratio do not change."""
    weight = max(factor, 1e-3)
    return {name: weight * value for name, value in values.items()}


EFFECT = Effect(
    name="second_mode",
    kind=kinds.MODE,
    equation=r"m_2 \dot{v}_2 = k_2 x_2 + b_2 (v - v_2), \quad \dot{x}_2 = v - v_2",
    statement="A second mass of {m_2} moves with the first, held by a stiffness of {k_2} and a damping of {b_2}: there "
    "is one more resonance.",
    fingerprint="The error rises towards one frequency, where it turns its phase, and steps ring with it.",
    separation="A slow sweep over the second frequency: a mode turns the phase by half a turn and back within its "
    "width, a delay goes on turning it in proportion to frequency.",
    references=("Meirovitch 2001, Fundamentals of Vibrations, ch. 5",),
    declares=(
        positive("m_2", "kg", "mass of the second mode", 1e8, strength=True),
        positive("k_2", "N/m", "stiffness of the second mode", 1e8),
        positive("b_2", "N s/m", "damping of the second mode", 1e8),
    ),
    adds=Parts(
        (Storage("x_2", "spring", ("k_2",), "m"), Storage("p_2", "capacitor", ("m_2",), "kg m/s")),
        (Resistor("second_mode", "linear", {"p": 1.0, "p_2": -1.0}, ("b_2",)),),
        (Coupling("x_2", "p", 1.0), Coupling("x_2", "p_2", -1.0)),
    ),
    grid=grid,
    applies=has_motion,
    neighbours=("delay", "sensor_lag"),
    related_kinds=(kinds.RINGING_MODE,),
    rescale=rescale,
)
