"""A constant force on the moving part: gravity or a preload."""

from __future__ import annotations

from phnn.effects import Effect, Parts, Scales, bounded, has_motion, kinds
from phnn.network.elements import Coupling, Storage

# A storage ``H = −F₀ x_w`` with ``J[x_w, p] = 1``: a source of energy without bottom. Where a spring acts it has given
# way before the recording starts. Where none does, there is no rest to start from: recordings start unknown.
_WEIGHT = Parts((Storage("x_w", "weight", ("F_0",), "m"),), couplings=(Coupling("x_w", "p", 1.0),))


def grid(scales: Scales) -> list[dict[str, float]]:
    """The law is linear in its strength: one point."""
    return [{"F_0": 1e-3 * scales.stiffness * scales.displacement}]


EFFECT = Effect(
    name="constant_load",
    kind=kinds.CONSTANT_FORCE,
    equation=r"F = F_0",
    statement="A constant force of {F_0} acts on the moving part, as gravity or a preload does.",
    fingerprint="Without a spring the motion goes further one way than the other; with a linear one the mean "
    "alone changes.",
    separation="The same recording with the actuator turned upside down: a weight changes its sign, an offset of the "
    "amplifier and a zero of the sensor do not.",
    references=("Gautier, Janot & Vandanjon 2013, IEEE Transactions on Control Systems Technology 21 (EMPS)",),
    declares=(bounded("F_0", "N", "constant force", typical=0.1, strength=True),),
    adds=_WEIGHT,
    grid=grid,
    applies=has_motion,
    neighbours=("amplifier_offset",),
)
