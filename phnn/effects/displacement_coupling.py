"""A transducer ratio that follows the displacement."""

from __future__ import annotations

from phnn.effects import Effect, Parts, Scales, bounded, constant, has_transducer, kinds
from phnn.network.elements import Modulation


def grid(scales: Scales) -> list[dict[str, float]]:
    """One point: the law is linear in its strength."""
    return [{"kappa_a": 1e-3, "q_a": scales.displacement}]


EFFECT = Effect(
    name="displacement_coupling",
    kind=kinds.RATIO_BY_DISPLACEMENT,
    equation=r"\alpha(q) = \alpha (1 + \kappa_a\, q/q_a)",
    statement="The transducer ratio follows the displacement: it changes by the share {kappa_a} per {q_a}.",
    fingerprint="Even harmonics and a mean shift with the product of voltage and displacement, weaker and turned in "
    "phase above the resonance.",
    separation="A small sine on several offsets of the voltage, below and above the resonance: a coupling that follows "
    "the displacement changes its gain with the offset and leaves the resonance where it is.",
    references=("van der Schaft & Jeltsema 2014, Port-Hamiltonian Systems Theory, ch. 2 (modulated transformer)",),
    declares=(
        bounded("kappa_a", "1", "change of coupling", -3.0, 3.0, 0.05, strength=True),
        constant("q_a", "m", "reference displacement of the coupling"),
    ),
    adds=Parts(modulations=(Modulation("alpha", "q", "affine", ("kappa_a", "q_a")),)),
    grid=grid,
    applies=has_transducer,
    neighbours=("electrostriction", "quadratic_stiffness", "sensor_nonlinearity"),
)
