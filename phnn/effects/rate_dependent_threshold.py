"""Hysteresis whose thresholds grow with the speed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from phnn.effects.effect import Effect, Scales, has_motion, has_plain_dead_zones, no_range, with_network
from phnn.network.elements import Resistor
from phnn.parameters import as_table, positive
from phnn.setup import Setup


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """Every dead zone becomes ``d_i (1 + κ |v|)``, ``v = p/m``: the law reads the momentum."""
    network = setup.network
    (mass,) = next(s.parameters for s in network.storages if s.name == "p")

    def hastened(resistor: Resistor) -> Resistor:
        if resistor.law != "dead_zone":
            return resistor
        names = (*resistor.parameters, "kappa_v", mass)
        return replace(resistor, law="rate_dependent_dead_zone", parameters=names, modulated_by="p")

    growth = positive("kappa_v", values["kappa_v"], "s/m", "growth of the dead zones with the speed", 1e8)
    parameters = as_table((*network.parameters.values(), growth))
    resistors = tuple(hastened(r) for r in network.resistors)
    return with_network(setup, replace(network, resistors=resistors, parameters=parameters))


def grid(scales: Scales) -> list[dict[str, float]]:
    """The law is linear in its strength: one point."""
    return [{"kappa_v": 1e-3 / scales.velocity}]


def applies(setup: Setup) -> bool:
    """Some resistor has a dead zone that follows no state yet, and a mass of constant inertia moves."""
    masses = [s for s in setup.network.storages if s.name == "p" and s.law == "capacitor"]
    return has_motion(setup) and has_plain_dead_zones(setup) and bool(masses)


EFFECT = Effect(
    name="rate_dependent_threshold",
    location="hysteron",
    kind="threshold that follows the rate",
    equation=r"d_i(v) = d_i (1 + \kappa_v |v|)",
    statement="The hysteresis loop widens with the speed: the dead zones grow in proportion to it, by {kappa_v}.",
    fingerprint="The loop grows wider with frequency while its corners stay where the direction turns round.",
    separation="Triangles of one amplitude at rates over two decades: thresholds that follow the speed widen the loop "
    "in proportion to the rate, another hysteron narrows or widens it around one rate.",
    references=("Al Janaideh, Rakheja & Su 2009, Mechatronics 19 (rate-dependent play)",),
    passive=True,
    strength="kappa_v",
    one_sided=True,
    grid=grid,
    build=build,
    parameters=("kappa_v",),
    plausible=no_range("kappa_v"),
    applies=applies,
    neighbours=("extra_hysteron", "quadratic_drag"),
)
