"""Pipes between tanks in which the flow becomes turbulent."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from phnn.effects.effect import Effect, Scales, has_tanks, no_range, with_network
from phnn.network.elements import Resistor
from phnn.parameters import as_table, constant, positive
from phnn.setup import Setup


def is_pipe(resistor: Resistor) -> bool:
    """It joins tanks."""
    return resistor.law == "linear" and len(resistor.on) > 1


def is_outlet(resistor: Resistor) -> bool:
    """It drains a single tank."""
    return resistor.law == "linear" and len(resistor.on) == 1


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """Every linear pipe gets an orifice: ``g Δp = Q (1 + κ |Q|/Q_t)``, for large flows ``Q ∝ √|Δp|``."""
    return _narrowed(setup, values, lambda resistor: resistor.law == "linear")


def build_outlets(setup: Setup, values: Mapping[str, float]) -> Setup:
    """The same of pipes that drain a single tank."""
    return _narrowed(setup, values, is_outlet)


def build_pipes(setup: Setup, values: Mapping[str, float]) -> Setup:
    """The same of pipes that join tanks."""
    return _narrowed(setup, values, is_pipe)


def _narrowed(setup: Setup, values: Mapping[str, float], where: Callable[[Resistor], bool]) -> Setup:
    network = setup.network

    def narrowed(resistor: Resistor) -> Resistor:
        if not where(resistor):
            return resistor
        return replace(resistor, law="turbulent", parameters=(*resistor.parameters, "kappa_t", "Q_t"))

    extra = (
        positive("kappa_t", values["kappa_t"], "1", "turbulent share of the resistance at the reference flow", 1e8),
        constant("Q_t", values["Q_t"], "m³/s", "reference flow of the turbulent resistance"),
    )
    parameters = as_table((*network.parameters.values(), *extra))
    resistors = tuple(narrowed(r) for r in network.resistors)
    return with_network(setup, replace(network, resistors=resistors, parameters=parameters))


def grid(scales: Scales) -> list[dict[str, float]]:
    """Weak, and strong enough that the flow goes with the root of the head."""
    return [{"kappa_t": share, "Q_t": scales.voltage} for share in (1e-3, 1.0, 100.0)]


def applies(setup: Setup) -> bool:
    """Stores of constant capacity drain into each other through resistors, of which at least one is linear."""
    return has_tanks(setup) and any(r.law == "linear" for r in setup.network.resistors)


def has_both(setup: Setup) -> bool:
    """Of the linear pipes some join tanks and some drain a single one."""
    linear = setup.network.resistors
    return has_tanks(setup) and any(map(is_pipe, linear)) and any(map(is_outlet, linear))


_EVERYWHERE = Effect(
    name="turbulent_orifice",
    location="mechanical",
    kind="dissipative",
    equation=r"g\,\Delta p = Q (1 + \kappa_t |Q|/Q_t)",
    statement="The pipes have orifices in which the flow is turbulent: at a flow of {Q_t} they resist by the share "
    "{kappa_t} more than in proportion, and large flows go with the root of the head.",
    fingerprint="A tank empties along a parabola to the end in finite time where a linear pipe leaves an exponential.",
    separation="Filling at several steady flows: the head grows with the square of the flow through an orifice, and "
    "stays at the rim of a tank that overflows.",
    references=("White 2011, Fluid Mechanics, sec. 6.12 (Torricelli; head loss of an orifice)",),
    passive=True,
    strength="kappa_t",
    one_sided=True,
    grid=grid,
    build=build,
    parameters=("kappa_t", "Q_t"),
    plausible=no_range("kappa_t", "Q_t"),
    applies=applies,
    neighbours=("overflow",),
)
EFFECT = replace(
    _EVERYWHERE,
    forms=(
        replace(
            _EVERYWHERE,
            statement="The outlet is an orifice in which the flow is turbulent: at a flow of {Q_t} it resists by the "
            "share {kappa_t} more than in proportion, and large flows go with the root of the head.",
            build=build_outlets,
            applies=has_both,
        ),
        replace(
            _EVERYWHERE,
            statement="Between the tanks is an orifice in which the flow is turbulent: at a flow of {Q_t} it resists "
            "by the share {kappa_t} more than in proportion, and large flows go with the root of the head.",
            build=build_pipes,
            applies=has_both,
        ),
    ),
)
