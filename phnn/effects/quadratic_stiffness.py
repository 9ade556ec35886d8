"""Quadratic stiffness: a spring that is stiffer on one side."""

from __future__ import annotations

from phnn.effects import Effect, Placed, Scales, bounded, constant, has_spring, kinds
from phnn.effects.additions import bent_spring
from phnn.setup import Setup


def bend(setup: Setup, parameters: Placed) -> Setup:
    """Effort of ``q`` becomes ``k q (1 + κ₂ s + κ₂² s²/3)``, ``s = q/q₂``, hence ``H″ = k (1 + κ₂ s)² ≥ 0``."""
    return bent_spring(setup, "quadratic_spring", parameters)


def grid(scales: Scales) -> list[dict[str, float]]:
    """One point: the law is linear in its strength as long as that is small."""
    return [{"kappa_2": 1e-3, "q_2": scales.displacement}]


EFFECT = Effect(
    name="quadratic_stiffness",
    kind=kinds.ELASTIC,
    equation=r"F_k = k\,q\,(1 + \kappa_2 s + \frac{1}{3}\kappa_2^2 s^2), \quad s = q/q_2",
    statement="The spring is stiffer on one side than on the other: at a displacement of {q_2} its force differs by "
    "the share {kappa_2} from a straight line.",
    fingerprint="A second harmonic and a mean shift with the square of the displacement, and a resonance that moves "
    "with the offset.",
    separation="Sines at the resonance about several offsets of the voltage: only a stiffness moves the resonance to "
    "one side with a positive and to the other with a negative offset.",
    references=("Kovacic & Brennan 2011, The Duffing Equation, ch. 8",),
    declares=(
        bounded("kappa_2", "1", "quadratic stiffness", -3.0, 3.0, 0.05, strength=True),
        constant("q_2", "m", "reference displacement of the quadratic stiffness"),
    ),
    adds=bend,
    grid=grid,
    applies=has_spring,
    neighbours=("electrostriction", "displacement_coupling", "hysteresis_asymmetry", "contact_stop"),
)
