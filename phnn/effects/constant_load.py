"""A constant force on the moving part: gravity or a preload."""

from __future__ import annotations

from phnn.effects import Effect, Parts, Scales, bounded, has_motion, kinds
from phnn.network.elements import Coupling, Storage

# A storage ``H = −F₀ x_w`` with ``J[x_w, p] = 1``: an energy source that is not bounded below. If a spring acts, it has
# deflected before the recording starts. Without a spring there is no rest state, and recordings start unknown.
_WEIGHT = Parts((Storage("x_w", "weight", ("F_0",), "m"),), couplings=(Coupling("x_w", "p", 1.0),))


def grid(scales: Scales) -> list[dict[str, float]]:
    """One point: the law is linear in its strength."""
    return [{"F_0": 1e-3 * scales.stiffness * scales.displacement}]


EFFECT = Effect(
    name="constant_load",
    kind=kinds.CONSTANT_FORCE,
    equation=r"F = F_0",
    statement="A constant force of {F_0} acts on the moving part, as gravity or a preload does.",
    fingerprint="Without a spring the motion is larger in one direction; with a linear spring only the mean changes.",
    separation="The same recording with the actuator turned upside down: a weight changes its sign, an offset of the "
    "amplifier and a zero of the sensor do not.",
    references=("Gautier, Janot & Vandanjon 2013, IEEE Transactions on Control Systems Technology 21 (EMPS)",),
    declares=(bounded("F_0", "N", "constant force", typical=0.1, strength=True),),
    adds=_WEIGHT,
    grid=grid,
    applies=has_motion,
    neighbours=("amplifier_offset",),
)
