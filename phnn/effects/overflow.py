"""A tank that overflows."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from phnn.effects.effect import Effect, Scales, has_tanks, no_range, with_network
from phnn.network.elements import Resistor
from phnn.parameters import positive
from phnn.setup import Setup


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``V̇ += −r max(V − V_o, 0)`` of the measured tank: a resistor that opens above a level."""
    network = setup.network
    (capacity,) = next(s.parameters for s in network.storages if s.name == network.output)
    rim = Resistor("overflow", "overflow", {network.output: 1.0}, ("r_o", "V_o", capacity))
    return with_network(
        setup,
        network.extend(
            resistors=(rim,),
            parameters=(
                positive("r_o", values["r_o"], "1/s", "rate at which what stands above the rim flows off", 1e8),
                positive("V_o", values["V_o"], "m³", "volume up to the rim", 1e2),
            ),
        ),
    )


def grid(scales: Scales) -> list[dict[str, float]]:
    """A weak overflow at shares of the largest volume."""
    rate = 1e-3 * 2.0 * np.pi * scales.fastest
    return [{"r_o": rate, "V_o": share * scales.displacement} for share in (0.5, 0.7, 0.8, 0.9, 0.97)]


EFFECT = Effect(
    name="overflow",
    location="mechanical",
    kind="dissipative",
    equation=r"\dot{V} = \dots - r_o \max(V - V_o, 0)",
    statement="The tank overflows: above a volume of {V_o} what is too much flows off at a rate of {r_o}.",
    fingerprint="Nothing below one level, and above it the level rises no further than the inflow needs to run off.",
    separation="Filling at several steady flows: the level stays near the rim of a tank that overflows, and grows with "
    "the square of the flow through an orifice.",
    references=("White 2011, Fluid Mechanics, sec. 10.7 (weirs, linearised)",),
    passive=True,
    strength="r_o",
    one_sided=True,
    grid=grid,
    build=build,
    parameters=("r_o", "V_o"),
    plausible=no_range("r_o", "V_o"),
    applies=has_tanks,
    neighbours=("turbulent_orifice",),
)
