"""A learned transducer ratio: a cubic of the displacement."""

from __future__ import annotations

from phnn.effects import Effect, Parts, Scales, constant, has_transducer, kinds
from phnn.effects.learned.strengths import Within, each, either, named
from phnn.network.elements import Modulation

_MOST, _TYPICAL, _SMALL = 3.0, 0.05, 1e-3
_CHANGES = either(
    dict.fromkeys(("kappa_P1", "kappa_P2", "kappa_P3"), _MOST), "1", "learned change of coupling", _TYPICAL
)


def grid(scales: Scales) -> list[dict[str, float]]:
    """Each power alone: the law is linear in the strengths."""
    return each(_CHANGES, _SMALL, {"q_P": scales.displacement})


EFFECT = Effect(
    name="learned_ratio_of_displacement",
    kind=kinds.RATIO_BY_DISPLACEMENT,
    equation=r"\alpha(q) = \alpha (1 + \kappa_{P1} s + \kappa_{P2} s^2 + \kappa_{P3} s^3), \quad s = q/q_P",
    statement="The transducer ratio follows the displacement: at {q_P} it changes by the shares {kappa_P1} "
    "(proportional), {kappa_P2} (square) and {kappa_P3} (cube).",
    fingerprint="Harmonics and a mean shift with the product of voltage and displacement, weaker and turned in phase "
    "above the resonance.",
    separation="A small sine on several offsets of the voltage, below and above the resonance: a coupling that follows "
    "the displacement changes its gain with the offset and leaves the resonance where it is.",
    references=("van der Schaft & Jeltsema 2014, Port-Hamiltonian Systems Theory, ch. 2 (modulated transformer)",),
    declares=(*_CHANGES, constant("q_P", "m", "reference displacement of the learned coupling")),
    adds=Parts(modulations=(Modulation("alpha", "q", "cubic", (*named(_CHANGES), "q_P")),)),
    grid=grid,
    applies=has_transducer,
    neighbours=("displacement_coupling", "electrostriction"),
    rescale=Within(_CHANGES),
)
