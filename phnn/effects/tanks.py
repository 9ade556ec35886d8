"""Effects in networks of tanks: overflow, into the drain or the next tank, and turbulent flow in pipes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from phnn.effects import kinds
from phnn.effects.additions import Placed, with_resistors, with_rim
from phnn.effects.declaration import constant, has_tanks, positive
from phnn.effects.effect import Effect, Points
from phnn.network.elements import Network, Resistor
from phnn.setup import Setup


def overflows(setup: Setup, parameters: Placed) -> Setup:
    """Return ``V̇ += −r max(V − V_o, 0)`` of the measured tank: a resistor that opens above a level."""
    tank = setup.network.output
    return with_rim(setup, "overflow", tank, {tank: 1.0}, parameters)


# Rate of a weak overflow.
_WEAK = (2e-3 * math.pi, "fastest")

OVERFLOW = Effect(
    name="overflow",
    kind=kinds.DISSIPATIVE,
    equation=r"\dot{V} = \dots - r_o \max(V - V_o, 0)",
    statement="The tank overflows: above {V_o} the excess flows off at a rate of {r_o}.",
    fingerprint="No error below one level; above it, the level rises only until the excess inflow runs off.",
    separation="Filling at several steady flows: the level stays near the rim of a tank that overflows, and grows with "
    "the square of the flow through an orifice.",
    references=("White 2011, Fluid Mechanics, sec. 10.7 (weirs, linearised)",),
    declares=(
        positive("r_o", "1/s", "rate at which the excess above the rim flows off", 1e8, strength=True),
        positive("V_o", "{sensed}", "level or volume up to the rim", 1e2),
    ),
    adds=overflows,
    # A weak overflow at shares of the largest volume.
    grid=Points(*({"r_o": _WEAK, "V_o": (share, "displacement")} for share in (0.5, 0.7, 0.8, 0.9, 0.97))),
    applies=has_tanks,
    neighbours=("turbulent_orifice",),
)


def spills(setup: Setup, parameters: Placed) -> Setup:
    """``Q += r max(C Δp − V_s, 0)`` beside the pipe into the measured tank: a resistor that opens above a head."""
    connection = _pipe(setup.network)
    assert connection is not None
    pipe, above = connection
    return with_rim(setup, "spill_over", above, pipe.on, parameters)


def _pipe(network: Network) -> tuple[Resistor, str] | None:
    """Return the pipe into the measured tank, and the tank at its other end; None if there is no such pipe."""
    for resistor in network.resistors:
        others = [name for name in resistor.on if name != network.output]
        if network.output in resistor.on and len(others) == 1:
            return resistor, others[0]
    return None


def has_tank_above(setup: Setup) -> bool:
    """A pipe leads from another tank into the measured one."""
    return has_tanks(setup) and _pipe(setup.network) is not None


SPILL_OVER = Effect(
    name="spill_over",
    kind=kinds.DISSIPATIVE,
    equation=r"Q = \dots + r_s \max(C \Delta p - V_s, 0)",
    statement="The tank above overflows into the measured one: beyond {V_s} the excess runs over at a rate of {r_s}.",
    fingerprint="After a large inflow the measured level rises faster than the pipe between the tanks allows.",
    separation="Filling at several steady flows: the measured level follows the inflow at once where the tank above "
    "runs over, and late where it does not.",
    references=("White 2011, Fluid Mechanics, sec. 10.7 (weirs, linearised)",),
    declares=(
        positive("r_s", "1/s", "rate at which the excess above the rim runs over", 1e8, strength=True),
        positive("V_s", "{sensed}", "level or volume of the tank above up to its rim", 1e4),
    ),
    adds=spills,
    # Shares and multiples of the largest measured volume, as the volume of the tank above is unknown.
    grid=Points(*({"r_s": _WEAK, "V_s": (share, "displacement")} for share in (0.2, 0.5, 0.8, 1.2, 2.0))),
    applies=has_tank_above,
    neighbours=("overflow", "turbulent_orifice"),
)


def is_linear(resistor: Resistor) -> bool:
    """Return whether the flow of a pipe is proportional to the head."""
    return resistor.law == "linear"


def is_pipe(resistor: Resistor) -> bool:
    """Return whether the pipe joins two tanks."""
    return is_linear(resistor) and len(resistor.on) > 1


def is_outlet(resistor: Resistor) -> bool:
    """Return whether the pipe drains a single tank."""
    return is_linear(resistor) and len(resistor.on) == 1


def narrowed(setup: Setup, parameters: Placed, where: Callable[[Resistor], bool] = is_linear) -> Setup:
    """Return every linear pipe gets an orifice: ``g Δp = Q (1 + κ |Q|/Q_t)``, for large flows ``Q ∝ √|Δp|``."""

    def narrow(resistor: Resistor) -> Resistor:
        if not where(resistor):
            return resistor
        return replace(resistor, law="turbulent", parameters=(*resistor.parameters, *parameters))

    return with_resistors(setup, narrow, parameters)


def has_linear_pipes(setup: Setup) -> bool:
    """Stores of constant capacity drain into each other through resistors, and at least one of these is linear."""
    return has_tanks(setup) and any(r.law == "linear" for r in setup.network.resistors)


def has_both(setup: Setup) -> bool:
    """Return whether some linear pipes join tanks and some drain a single tank."""
    linear = setup.network.resistors
    return has_tanks(setup) and any(map(is_pipe, linear)) and any(map(is_outlet, linear))


TURBULENT_ORIFICE = (
    Effect(
        name="turbulent_orifice",
        kind=kinds.DISSIPATIVE,
        equation=r"g\,\Delta p = Q (1 + \kappa_t |Q|/Q_t)",
        statement="The pipes have orifices in which the flow is turbulent: at a flow of {Q_t} they resist by the share "
        "{kappa_t} more than in proportion, and large flows go with the root of the head.",
        fingerprint="A tank empties along a parabola to the end in finite time where a linear pipe leaves an "
        "exponential.",
        separation="Filling at several steady flows: the head grows with the square of the flow through an orifice, "
        "and stays at the rim of a tank that overflows.",
        references=("White 2011, Fluid Mechanics, sec. 6.12 (Torricelli; head loss of an orifice)",),
        declares=(
            positive("kappa_t", "1", "turbulent share of the resistance at the reference flow", 1e8, strength=True),
            constant("Q_t", "{sensed}/s", "reference flow of the turbulent resistance"),
        ),
        adds=narrowed,
        # A weak orifice, and those strong enough that the flow is proportional to the root of the head.
        grid=Points(*({"kappa_t": share, "Q_t": "voltage"} for share in (1e-3, 1.0, 100.0))),
        applies=has_linear_pipes,
        neighbours=("overflow",),
    )
    .or_as(
        statement="The outlet is an orifice in which the flow is turbulent: at a flow of {Q_t} it resists by the "
        "share {kappa_t} more than in proportion, and large flows go with the root of the head.",
        adds=partial(narrowed, where=is_outlet),
        applies=has_both,
    )
    .or_as(
        statement="Between the tanks is an orifice in which the flow is turbulent: at a flow of {Q_t} it resists "
        "by the share {kappa_t} more than in proportion, and large flows go with the root of the head.",
        adds=partial(narrowed, where=is_pipe),
        applies=has_both,
    )
)
