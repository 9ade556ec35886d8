"""Pipes between tanks with turbulent flow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from phnn.effects import Effect, Placed, Scales, constant, has_tanks, kinds, positive, with_resistors
from phnn.network.elements import Resistor
from phnn.setup import Setup


def is_linear(resistor: Resistor) -> bool:
    """The flow of a pipe is proportional to the head."""
    return resistor.law == "linear"


def is_pipe(resistor: Resistor) -> bool:
    """The pipe joins two tanks."""
    return is_linear(resistor) and len(resistor.on) > 1


def is_outlet(resistor: Resistor) -> bool:
    """The pipe drains a single tank."""
    return is_linear(resistor) and len(resistor.on) == 1


def narrowed(setup: Setup, parameters: Placed, where: Callable[[Resistor], bool] = is_linear) -> Setup:
    """Every linear pipe gets an orifice: ``g Δp = Q (1 + κ |Q|/Q_t)``, for large flows ``Q ∝ √|Δp|``."""

    def narrow(resistor: Resistor) -> Resistor:
        if not where(resistor):
            return resistor
        return replace(resistor, law="turbulent", parameters=(*resistor.parameters, *parameters))

    return with_resistors(setup, narrow, parameters)


def grid(scales: Scales) -> list[dict[str, float]]:
    """A weak orifice, and one strong enough that the flow is proportional to the root of the head."""
    return [{"kappa_t": share, "Q_t": scales.voltage} for share in (1e-3, 1.0, 100.0)]


def applies(setup: Setup) -> bool:
    """Stores of constant capacity drain into each other through resistors, and at least one of these is linear."""
    return has_tanks(setup) and any(r.law == "linear" for r in setup.network.resistors)


def has_both(setup: Setup) -> bool:
    """Some linear pipes join tanks and some drain a single tank."""
    linear = setup.network.resistors
    return has_tanks(setup) and any(map(is_pipe, linear)) and any(map(is_outlet, linear))


EFFECT = (
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
            constant("Q_t", "m³/s", "reference flow of the turbulent resistance"),
        ),
        adds=narrowed,
        grid=grid,
        applies=applies,
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
