"""Cubic stiffness: a spring that hardens or softens symmetrically."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.effects.bent import bent_spring
from phnn.effects.effect import Effect, Scales, has_spring, no_range, with_network
from phnn.parameters import Parameter, constant
from phnn.setup import Setup


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """Effort of ``q`` becomes ``k q (1 + κ₃ s² + c s⁴)``, ``s = q/q₀``; ``c`` completes a softening spring."""
    extra = (
        Parameter("kappa_3", values["kappa_3"], "1", -2.0, 20.0, typical=0.05, description="cubic stiffness"),
        constant("q_0", values["q_0"], "m", "reference displacement of the cubic stiffness"),
    )
    return with_network(setup, bent_spring(setup.network, "cubic_spring", extra))


def grid(scales: Scales) -> list[dict[str, float]]:
    """The law is linear in its strength: one point."""
    return [{"kappa_3": 1e-3, "q_0": scales.displacement}]


EFFECT = Effect(
    name="cubic_stiffness",
    location="mechanical",
    kind="elastic",
    equation=r"F_k = k\,q\,(1 + \kappa_3 (q/q_0)^2)",
    statement="The stiffness depends on the amplitude: at a displacement of {q_0} the spring force differs by the "
    "share {kappa_3} from a straight line.",
    fingerprint="A third harmonic that grows with the cube of the amplitude, and a resonance that moves with the "
    "amplitude.",
    separation="Sweeps through the resonance at several amplitudes: a stiffness moves it on every one, a saturated "
    "amplifier only beyond its limit.",
    references=("Kovacic & Brennan 2011, The Duffing Equation",),
    passive=True,
    strength="kappa_3",
    one_sided=False,
    grid=grid,
    build=build,
    parameters=("kappa_3", "q_0"),
    plausible=no_range("kappa_3", "q_0"),
    applies=has_spring,
    neighbours=("amplifier_saturation",),
)
