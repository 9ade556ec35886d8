"""Quadratic drag on the moving mass."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.effects.effect import Effect, Plausible, Scales, has_motion, with_network
from phnn.network.elements import Resistor
from phnn.parameters import positive
from phnn.setup import Setup


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """One more resistor on ``p``: ``c₂ |v| v``."""
    return with_network(
        setup,
        setup.network.extend(
            resistors=(Resistor("quadratic_drag", "quadratic_drag", {"p": 1.0}, ("c_2",)),),
            parameters=(positive("c_2", values["c_2"], "N s²/m²", "quadratic drag", 1e8),),
        ),
    )


def grid(scales: Scales) -> list[dict[str, float]]:
    """The law is linear in its strength: one point."""
    force = 1e-4 * scales.stiffness * scales.displacement
    return [{"c_2": force / scales.velocity**2}]


EFFECT = Effect(
    name="quadratic_drag",
    location="mechanical",
    kind="dissipative",
    equation=r"F_d = c_2 |v| v",
    statement="A resistance of {c_2} grows with the square of the velocity, so that fast motion is damped more than "
    "slow motion.",
    fingerprint="The resonance peak grows broader with the amplitude, while slow motion is left as it is.",
    separation="Sines at the resonance of rising amplitude, the terminal voltage recorded as well: drag limits the "
    "motion, a slew limit the voltage.",
    references=("Batchelor 1967, An Introduction to Fluid Dynamics, sec. 5.11",),
    passive=True,
    strength="c_2",
    one_sided=True,
    grid=grid,
    build=build,
    parameters=("c_2",),
    plausible={
        "c_2": Plausible(
            0.0,
            0.012,
            "drag in air, ½ ρ C A with 1.2 kg/m³, C up to 2 and an area up to 100 cm²",
            outside="it is not air: a liquid, a narrow gap, or another loss that grows as fast",
        )
    },
    applies=has_motion,
    neighbours=("slew_limit",),
)
