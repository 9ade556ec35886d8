"""A learned transducer ratio: a parabola of the voltage."""

from __future__ import annotations

from phnn.effects import Effect, Placed, Scales, constant, has_transducer, kinds
from phnn.effects.additions import bent_port
from phnn.effects.learned.strengths import Within, each, either
from phnn.setup import Setup

_MOST, _TYPICAL, _SMALL = 3.0, 0.05, 1e-3
_CHANGES = either(dict.fromkeys(("a_P1", "a_P2"), _MOST), "1", "learned change of coupling", _TYPICAL)


def bend(setup: Setup, parameters: Placed) -> Setup:
    """The port acts through ``ψ(V) = V (1 + a₁ s/2 + a₂ s²/3)``, ``s = V/V_P``: ``α ψ'(V) = α (1 + a₁ s + a₂ s²)``."""
    return bent_port(setup, "polynomial", parameters)


def applies(setup: Setup) -> bool:
    """A parameter ``alpha`` is the ratio by which a voltage port that is linear or electrostrictive acts on ``p``."""
    laws = [p.law for p in setup.network.ports if p.name == "voltage"]
    return has_transducer(setup) and laws[0] in ("linear", "electrostriction")


def grid(scales: Scales) -> list[dict[str, float]]:
    """Each power alone: the law is linear in the strengths."""
    return each(_CHANGES, _SMALL, {"V_P": scales.voltage})


EFFECT = Effect(
    name="learned_ratio_of_voltage",
    kind=kinds.FORCE_BY_VOLTAGE,
    equation=r"F = \alpha V (1 + \frac{1}{2} a_{P1} s + \frac{1}{3} a_{P2} s^2), \quad s = V/V_P",
    statement="The transducer ratio follows the voltage: at {V_P} it changes by the shares {a_P1} (with the sign of "
    "the voltage) and {a_P2} (on both sides).",
    fingerprint="Harmonics that depend on the voltage alone, the same at every frequency and without a loop.",
    separation="Small sines about several offsets of the voltage, far below and near the resonance.",
    references=("Uchino 1997, Piezoelectric Actuators and Ultrasonic Motors",),
    declares=(*_CHANGES, constant("V_P", "V", "reference voltage of the learned coupling")),
    adds=bend,
    grid=grid,
    applies=applies,
    neighbours=("electrostriction", "displacement_coupling"),
    rescale=Within(_CHANGES),
)
