"""A learned transducer ratio: a cubic of the displacement."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.effects.effect import Effect, Scales, has_transducer, no_range, with_network
from phnn.effects.learned.strengths import each, within
from phnn.network.elements import Modulation
from phnn.parameters import Parameter, constant
from phnn.setup import Setup

_STRENGTHS = ("kappa_P1", "kappa_P2", "kappa_P3")
_MOST, _TYPICAL, _SMALL = 3.0, 0.05, 1e-3


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``α`` becomes ``α (1 + κ₁ s + κ₂ s² + κ₃ s³)``, ``s = q/q_P``, in the port and in all couplings alike."""
    parameters = [
        Parameter(n, values[n], "1", -_MOST, _MOST, typical=_TYPICAL, description="learned change of coupling")
        for n in _STRENGTHS
    ]
    parameters.append(constant("q_P", values["q_P"], "m", "reference displacement of the learned coupling"))
    law = Modulation("alpha", "q", "cubic", (*_STRENGTHS, "q_P"))
    return with_network(setup, setup.network.extend(modulations=(law,), parameters=tuple(parameters)))


def grid(scales: Scales) -> list[dict[str, float]]:
    """Each power alone; the law is linear in the strengths."""
    return each(_STRENGTHS, zip(_STRENGTHS, strict=True), _SMALL, {"q_P": scales.displacement})


EFFECT = Effect(
    name="learned_ratio_of_displacement",
    location="coupling",
    kind="ratio that follows the displacement",
    equation=r"\alpha(q) = \alpha (1 + \kappa_{P1} s + \kappa_{P2} s^2 + \kappa_{P3} s^3), \quad s = q/q_P",
    statement="The transducer ratio follows the displacement: at {q_P} it changes by the shares {kappa_P1} "
    "(proportional), {kappa_P2} (square) and {kappa_P3} (cube).",
    fingerprint="Harmonics and a mean shift with the product of voltage and displacement, weaker and turned in phase "
    "above the resonance.",
    separation="A small sine on several offsets of the voltage, below and above the resonance: a coupling that follows "
    "the displacement changes its gain with the offset and leaves the resonance where it is.",
    references=("van der Schaft & Jeltsema 2014, Port-Hamiltonian Systems Theory, ch. 2 (modulated transformer)",),
    passive=True,
    strength=_STRENGTHS[0],
    strengths=_STRENGTHS,
    one_sided=False,
    grid=grid,
    build=build,
    rescale=within(dict.fromkeys(_STRENGTHS, (-_MOST, _MOST))),
    parameters=(*_STRENGTHS, "q_P"),
    plausible=no_range(*_STRENGTHS, "q_P"),
    applies=has_transducer,
    neighbours=("displacement_coupling", "electrostriction"),
)
