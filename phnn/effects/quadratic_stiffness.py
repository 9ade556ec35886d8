"""Quadratic stiffness: a spring that is stiffer on one side."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.effects.bent import bent_spring
from phnn.effects.effect import Effect, Scales, has_spring, no_range, with_network
from phnn.parameters import Parameter, constant
from phnn.setup import Setup


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """Effort of ``q`` becomes ``k q (1 + κ₂ s + κ₂² s²/3)``, ``s = q/q₂``, hence ``H″ = k (1 + κ₂ s)² ≥ 0``."""
    extra = (
        Parameter("kappa_2", values["kappa_2"], "1", -3.0, 3.0, typical=0.05, description="quadratic stiffness"),
        constant("q_2", values["q_2"], "m", "reference displacement of the quadratic stiffness"),
    )
    return with_network(setup, bent_spring(setup.network, "quadratic_spring", extra))


def grid(scales: Scales) -> list[dict[str, float]]:
    """The law is linear in its strength, while that is small: one point."""
    return [{"kappa_2": 1e-3, "q_2": scales.displacement}]


EFFECT = Effect(
    name="quadratic_stiffness",
    location="mechanical",
    kind="elastic",
    equation=r"F_k = k\,q\,(1 + \kappa_2 s + \frac{1}{3}\kappa_2^2 s^2), \quad s = q/q_2",
    statement="The spring is stiffer on one side than on the other: at a displacement of {q_2} its force differs by "
    "the share {kappa_2} from a straight line.",
    fingerprint="A second harmonic and a mean shift with the square of the displacement, and a resonance that moves "
    "with the offset.",
    separation="Sines at the resonance about several offsets of the voltage: only a stiffness moves the resonance to "
    "one side with a positive and to the other with a negative offset.",
    references=("Kovacic & Brennan 2011, The Duffing Equation, ch. 8",),
    passive=True,
    strength="kappa_2",
    one_sided=False,
    grid=grid,
    build=build,
    parameters=("kappa_2", "q_2"),
    plausible=no_range("kappa_2", "q_2"),
    applies=has_spring,
    neighbours=("electrostriction", "displacement_coupling", "hysteresis_asymmetry", "contact_stop"),
)
