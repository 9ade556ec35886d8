"""A tank that overflows."""

from __future__ import annotations

import numpy as np

from phnn.effects import Effect, Placed, Scales, has_tanks, kinds, positive
from phnn.effects.additions import with_rim
from phnn.setup import Setup


def overflows(setup: Setup, parameters: Placed) -> Setup:
    """``V̇ += −r max(V − V_o, 0)`` of the measured tank: a resistor that opens above a level."""
    tank = setup.network.output
    return with_rim(setup, "overflow", tank, {tank: 1.0}, parameters)


def grid(scales: Scales) -> list[dict[str, float]]:
    """A weak overflow at shares of the largest volume."""
    rate = 1e-3 * 2.0 * np.pi * scales.fastest
    return [{"r_o": rate, "V_o": share * scales.displacement} for share in (0.5, 0.7, 0.8, 0.9, 0.97)]


EFFECT = Effect(
    name="overflow",
    kind=kinds.DISSIPATIVE,
    equation=r"\dot{V} = \dots - r_o \max(V - V_o, 0)",
    statement="The tank overflows: above a volume of {V_o} the excess flows off at a rate of {r_o}.",
    fingerprint="No error below one level; above it, the level rises only until the excess inflow runs off.",
    separation="Filling at several steady flows: the level stays near the rim of a tank that overflows, and grows with "
    "the square of the flow through an orifice.",
    references=("White 2011, Fluid Mechanics, sec. 10.7 (weirs, linearised)",),
    declares=(
        positive("r_o", "1/s", "rate at which the excess above the rim flows off", 1e8, strength=True),
        positive("V_o", "m³", "volume up to the rim", 1e2),
    ),
    adds=overflows,
    grid=grid,
    applies=has_tanks,
    neighbours=("turbulent_orifice",),
)
