"""A learned transducer ratio: a parabola of the voltage."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.effects.bent import bent_port
from phnn.effects.effect import Effect, Scales, has_transducer, no_range, with_network
from phnn.effects.learned.strengths import each, within
from phnn.parameters import Parameter, constant
from phnn.setup import Setup

_STRENGTHS = ("a_P1", "a_P2")
_MOST, _TYPICAL, _SMALL = 3.0, 0.05, 1e-3


def applies(setup: Setup) -> bool:
    """A parameter ``alpha`` is the ratio by which a voltage port that is linear or electrostrictive acts on ``p``."""
    laws = [p.law for p in setup.network.ports if p.name == "voltage"]
    return has_transducer(setup) and laws[0] in ("linear", "electrostriction")


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """The port acts through ``ψ(V) = V (1 + a₁ s/2 + a₂ s²/3)``, ``s = V/V_P``: ``α ψ'(V) = α (1 + a₁ s + a₂ s²)``."""
    extra = [
        Parameter(n, values[n], "1", -_MOST, _MOST, typical=_TYPICAL, description="learned change of coupling")
        for n in _STRENGTHS
    ]
    extra.append(constant("V_P", values["V_P"], "V", "reference voltage of the learned coupling"))
    return with_network(setup, bent_port(setup.network, "polynomial", extra))


def grid(scales: Scales) -> list[dict[str, float]]:
    """Each power alone; the law is linear in the strengths."""
    return each(_STRENGTHS, zip(_STRENGTHS, strict=True), _SMALL, {"V_P": scales.voltage})


EFFECT = Effect(
    name="learned_ratio_of_voltage",
    location="coupling",
    kind="force against voltage",
    equation=r"F = \alpha V (1 + \frac{1}{2} a_{P1} s + \frac{1}{3} a_{P2} s^2), \quad s = V/V_P",
    statement="The transducer ratio follows the voltage: at {V_P} it changes by the shares {a_P1} (with the sign of "
    "the voltage) and {a_P2} (on both sides).",
    fingerprint="Harmonics that depend on the voltage alone, the same at every frequency and without a loop.",
    separation="Small sines about several offsets of the voltage, far below and near the resonance.",
    references=("Uchino 1997, Piezoelectric Actuators and Ultrasonic Motors",),
    passive=True,
    strength=_STRENGTHS[0],
    strengths=_STRENGTHS,
    one_sided=False,
    grid=grid,
    build=build,
    rescale=within(dict.fromkeys(_STRENGTHS, (-_MOST, _MOST))),
    parameters=(*_STRENGTHS, "V_P"),
    plausible=no_range(*_STRENGTHS, "V_P"),
    applies=applies,
    neighbours=("electrostriction", "displacement_coupling"),
)
