"""A learned damper: friction, viscous damping and drag, separate for each direction, with growth over the position."""

from __future__ import annotations

import numpy as np

from phnn.effects import Effect, Parts, Placed, Scales, constant, has_motion, kinds
from phnn.effects.learned.strengths import Within, sized, starts, stiffness_of, strengths
from phnn.laws.resistor import SMOOTHED
from phnn.network.elements import Resistor
from phnn.setup import Setup

# A noticeable strength, and one at which the response is still proportional to it, as shares of stiffness ×
# displacement.
_NOTICEABLE, _SMALL = 1e-2, 5e-4
# Speeds at which friction reaches half its value, as shares of the largest speed in the slowest and in any recording.
_STICKING, _SLIDING = 0.1, 0.1

# Strengths: friction, viscous damping and drag forwards and backwards; damping that follows the position.
_BY_SPEED = ("F_f1", "F_b1", "F_2", "F_f3", "F_b3", "F_f4", "F_b4")
_BY_POSITION = ("F_q", "F_qR", "F_qL")
_FORCES = strengths((*_BY_SPEED, *_BY_POSITION), "N", "learned damping force")
_CONSTANTS = (
    constant("v_D1", "m/s", "reference speed of the friction of slow motion, 100 × the speed at half the friction"),
    constant("v_D2", "m/s", "reference speed of the friction of fast motion, 100 × the speed at half the friction"),
    constant("v_D3", "m/s", "speed at which the other learned damping forces have their nominal size"),
    constant("v_Dq", "m/s", "reference speed of the damping that follows the position"),
    constant("n_D1", "1", "exponent of the speed: friction"),
    constant("n_D3", "1", "exponent of the speed: viscous damping"),
    constant("n_D4", "1", "exponent of the speed: drag"),
    constant("n_Dq", "1", "exponent of the speed in the damping that follows the position"),
    constant("q_D", "m", "displacement at which the damping that follows the position has its nominal size"),
    constant("c_DR", "1/m", "inverse of that displacement"),
    constant("c_DL", "1/m", "its mirror image"),
)
_OF_SPEED = {
    "friction": ("F_f1", "F_b1", "n_D1", "v_D1"),
    "sliding": ("F_2", "F_2", "n_D1", "v_D2"),
    "viscous": ("F_f3", "F_b3", "n_D3", "v_D3"),
    "drag": ("F_f4", "F_b4", "n_D4", "v_D3"),
}
_OF_POSITION = {
    "bowl": ("square_damper", ("F_q", "n_Dq", "v_Dq", "q_D")),
    "right": ("ramp_damper", ("F_qR", "n_Dq", "v_Dq", "c_DR")),
    "left": ("ramp_damper", ("F_qL", "n_Dq", "v_Dq", "c_DL")),
}
_RESISTORS = (
    *(Resistor(f"learned_{n}", "power_damper", {"p": 1.0}, names) for n, names in _OF_SPEED.items()),
    *(Resistor(f"learned_{n}", law, {"p": 1.0}, names, "q") for n, (law, names) in _OF_POSITION.items()),
)


def brake(setup: Setup, parameters: Placed) -> Setup:
    """``F += −σ(v, q) v``, ``σ ≥ 0``: resistors on ``p``, some of which read ``q``."""
    typical = _NOTICEABLE * stiffness_of(setup) * parameters["q_D"].value
    return Parts(resistors=_RESISTORS)(setup, sized(parameters, typical))


def grid(scales: Scales) -> list[dict[str, float]]:
    """All strengths equal; emphasis on those of the speed; on those of the position, as viscous damping and as
    friction."""
    slow = 2.0 * np.pi * scales.slowest * scales.displacement
    sticking, sliding = _STICKING * slow / SMOOTHED, _SLIDING * scales.velocity / SMOOTHED
    constants = {
        "v_D1": sticking, "v_D2": sliding, "v_D3": scales.velocity, "v_Dq": scales.velocity,
        "n_D1": 0.0, "n_D3": 1.0, "n_D4": 2.0, "n_Dq": 1.0,
        "q_D": scales.displacement, "c_DR": 1.0 / scales.displacement, "c_DL": -1.0 / scales.displacement,
    }  # fmt: skip
    force = _SMALL * scales.stiffness * scales.displacement
    points = starts(_FORCES, force, (_BY_SPEED, _BY_POSITION), constants)
    return [*points, points[-1] | {"v_Dq": sticking, "n_Dq": 0.0}]


EFFECT = Effect(
    name="learned_damper",
    kind=kinds.DISSIPATIVE,
    equation=r"F = \sigma(v, q)\,v, \quad \sigma = \sum_{ij} F_{ij} B_i(v) C_j(q) \geq 0",
    statement="A further damper acts on the moving part. Forwards it brakes with a friction of {F_f1}, a viscous force "
    "of {F_f3} and a drag of {F_f4} at {v_D3}, backwards with {F_b1}, {F_b3} and {F_b4}; with a friction of fast "
    "motion of {F_2}; and at a displacement of {q_D} with {F_q} on both sides, {F_qR} on the right and {F_qL} on the "
    "left.",
    fingerprint="A loop whose width depends on the velocity, on its direction or on the displacement, and closes at "
    "rest.",
    separation="Sines of several amplitudes and frequencies about several offsets: damping of the speed follows "
    "amplitude times frequency, damping of the position follows the offset.",
    references=("Armstrong-Hélouvry, Dupont & Canudas de Wit 1994, Automatica 30 (friction, direction, position)",),
    declares=(*_FORCES, *_CONSTANTS),
    adds=brake,
    grid=grid,
    applies=has_motion,
    neighbours=("coulomb_friction", "quadratic_drag"),
    rescale=Within(_FORCES),
    related_kinds=(kinds.DAMPING_BY_DISPLACEMENT,),
)
