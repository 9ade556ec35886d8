"""Quadratic drag on the moving mass."""

from __future__ import annotations

from phnn.effects import Effect, Parts, Scales, has_motion, kinds, positive
from phnn.network.elements import Resistor


def grid(scales: Scales) -> list[dict[str, float]]:
    """One point: the law is linear in its strength."""
    force = 1e-4 * scales.stiffness * scales.displacement
    return [{"c_2": force / scales.velocity**2}]


EFFECT = Effect(
    name="quadratic_drag",
    kind=kinds.DISSIPATIVE,
    equation=r"F_d = c_2 |v| v",
    statement="A resistance of {c_2} grows with the square of the velocity, so that fast motion is damped more than "
    "slow motion.",
    fingerprint="The resonance peak grows broader with the amplitude, while slow motion does not change.",
    separation="Sines at the resonance of rising amplitude, the terminal voltage recorded as well: drag limits the "
    "motion, a slew limit the voltage.",
    references=("Batchelor 1967, An Introduction to Fluid Dynamics, sec. 5.11",),
    declares=(
        positive("c_2", "N s²/m²", "quadratic drag", 1e8, strength=True).plausibly(
            0.0,
            0.012,
            "drag in air, ½ ρ C A with 1.2 kg/m³, C up to 2 and an area up to 100 cm²",
            outside="it is not air: a liquid, a narrow gap, or another loss that grows as fast",
        ),
    ),
    adds=Parts(resistors=(Resistor("quadratic_drag", "quadratic_drag", {"p": 1.0}, ("c_2",)),)),
    grid=grid,
    applies=has_motion,
    neighbours=("slew_limit",),
)
