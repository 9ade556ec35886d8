"""A constant force on the moving part: gravity or a preload."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.effects.effect import Effect, Scales, has_motion, no_range, with_network
from phnn.network.elements import Coupling, Storage
from phnn.parameters import Parameter
from phnn.setup import Setup


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``F += F₀``: a storage ``H = −F₀ x_w`` with ``J[x_w, p] = 1``, a source of energy without bottom.

    Where a spring acts it has given way before the recording starts. Where none does, there is no rest to start from:
    recordings start unknown.
    """
    force = Parameter("F_0", values["F_0"], "N", typical=0.1, description="constant force")
    return with_network(
        setup,
        setup.network.extend(
            storages=(Storage("x_w", "weight", ("F_0",), "m"),),
            couplings=(Coupling("x_w", "p", 1.0),),
            parameters=(force,),
        ),
    )


def grid(scales: Scales) -> list[dict[str, float]]:
    """The law is linear in its strength: one point."""
    return [{"F_0": 1e-3 * scales.stiffness * scales.displacement}]


EFFECT = Effect(
    name="constant_load",
    location="mechanical",
    kind="constant",
    equation=r"F = F_0",
    statement="A constant force of {F_0} acts on the moving part, as gravity or a preload does.",
    fingerprint="Without a spring the motion goes further one way than the other; with a linear one the mean "
    "alone changes.",
    separation="The same recording with the actuator turned upside down: a weight changes its sign, an offset of the "
    "amplifier and a zero of the sensor do not.",
    references=("Gautier, Janot & Vandanjon 2013, IEEE Transactions on Control Systems Technology 21 (EMPS)",),
    passive=False,
    strength="F_0",
    one_sided=False,
    grid=grid,
    build=build,
    parameters=("F_0",),
    plausible=no_range("F_0"),
    applies=has_motion,
    neighbours=("amplifier_offset",),
)
