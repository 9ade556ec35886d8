"""Cubic stiffness: a spring that hardens or softens symmetrically."""

from __future__ import annotations

from phnn.effects import Effect, Placed, Scales, bounded, constant, has_spring, kinds
from phnn.effects.additions import bent_spring
from phnn.setup import Setup


def bend(setup: Setup, parameters: Placed) -> Setup:
    """Effort of ``q`` becomes ``k q (1 + κ₃ s² + c s⁴)``, ``s = q/q₀``; ``c`` completes a softening spring."""
    return bent_spring(setup, "cubic_spring", parameters)


def grid(scales: Scales) -> list[dict[str, float]]:
    """One point: the law is linear in its strength."""
    return [{"kappa_3": 1e-3, "q_0": scales.displacement}]


EFFECT = Effect(
    name="cubic_stiffness",
    kind=kinds.ELASTIC,
    equation=r"F_k = k\,q\,(1 + \kappa_3 (q/q_0)^2)",
    statement="The stiffness depends on the amplitude: at a displacement of {q_0} the spring force differs by the "
    "share {kappa_3} from a straight line.",
    fingerprint="A third harmonic that grows with the cube of the amplitude, and a resonance that moves with the "
    "amplitude.",
    separation="Sweeps through the resonance at several amplitudes: a stiffness moves it on every one, a saturated "
    "amplifier only beyond its limit.",
    references=("Kovacic & Brennan 2011, The Duffing Equation",),
    declares=(
        bounded("kappa_3", "1", "cubic stiffness", -2.0, 20.0, 0.05, strength=True),
        constant("q_0", "m", "reference displacement of the cubic stiffness"),
    ),
    adds=bend,
    grid=grid,
    applies=has_spring,
    neighbours=("amplifier_saturation",),
)
