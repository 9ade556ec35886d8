"""A tank that overflows into the next one."""

from __future__ import annotations

import math

from phnn.effects import Effect, Placed, Scales, has_tanks, kinds, positive
from phnn.effects.additions import with_rim
from phnn.network.elements import Network, Resistor
from phnn.setup import Setup


def spills(setup: Setup, parameters: Placed) -> Setup:
    """``Q += r max(C Δp − V_s, 0)`` beside the pipe into the measured tank: a resistor that opens above a head."""
    found = _pipe(setup.network)
    assert found is not None
    pipe, above = found
    return with_rim(setup, "spill_over", above, pipe.on, parameters)


def _pipe(network: Network) -> tuple[Resistor, str] | None:
    """The pipe into the measured tank, and the tank at its other end; None if there is no such pipe."""
    for resistor in network.resistors:
        others = [name for name in resistor.on if name != network.output]
        if network.output in resistor.on and len(others) == 1:
            return resistor, others[0]
    return None


def grid(scales: Scales) -> list[dict[str, float]]:
    """A weak overflow at shares and multiples of the largest measured volume, as the volume of the tank above is
    unknown."""
    rate = 1e-3 * 2.0 * math.pi * scales.fastest
    return [{"r_s": rate, "V_s": share * scales.displacement} for share in (0.2, 0.5, 0.8, 1.2, 2.0)]


def applies(setup: Setup) -> bool:
    """A pipe leads from another tank into the measured one."""
    return has_tanks(setup) and _pipe(setup.network) is not None


EFFECT = Effect(
    name="spill_over",
    kind=kinds.DISSIPATIVE,
    equation=r"Q = \dots + r_s \max(C \Delta p - V_s, 0)",
    statement="The tank above overflows into the measured one: beyond a volume of {V_s} the excess runs over at "
    "a rate of {r_s}.",
    fingerprint="After a large inflow the measured level rises faster than the pipe between the tanks allows.",
    separation="Filling at several steady flows: the measured level follows the inflow at once where the tank above "
    "runs over, and late where it does not.",
    references=("White 2011, Fluid Mechanics, sec. 10.7 (weirs, linearised)",),
    declares=(
        positive("r_s", "1/s", "rate at which the excess above the rim runs over", 1e8, strength=True),
        positive("V_s", "m³", "volume of the tank above up to its rim", 1e4),
    ),
    adds=spills,
    grid=grid,
    applies=applies,
    neighbours=("overflow", "turbulent_orifice"),
)
