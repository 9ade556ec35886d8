"""Hysteresis whose thresholds grow with the speed."""

from __future__ import annotations

from phnn.effects import Effect, Placed, Scales, has_inertia, has_plain_dead_zones, inertia, kinds, positive
from phnn.effects.additions import with_following_dead_zones
from phnn.setup import Setup


def hasten(setup: Setup, parameters: Placed) -> Setup:
    """Every dead zone becomes ``d_i (1 + κ |v|)``, ``v = p/m``: the law reads the momentum."""
    names = (*parameters, inertia(setup))
    return with_following_dead_zones(setup, "rate_dependent_dead_zone", "p", names, parameters)


def grid(scales: Scales) -> list[dict[str, float]]:
    """One point: the law is linear in its strength."""
    return [{"kappa_v": 1e-3 / scales.velocity}]


def applies(setup: Setup) -> bool:
    """At least one resistor has a dead zone that follows no state yet, and a mass of constant inertia moves."""
    return has_inertia(setup) and has_plain_dead_zones(setup)


EFFECT = Effect(
    name="rate_dependent_threshold",
    kind=kinds.THRESHOLD_BY_RATE,
    equation=r"d_i(v) = d_i (1 + \kappa_v |v|)",
    statement="The hysteresis loop widens with the speed: the dead zones grow in proportion to it, by {kappa_v}.",
    fingerprint="The loop grows wider with frequency, while its corners stay at the reversals of the motion.",
    separation="Triangles of one amplitude at rates over two decades: thresholds that follow the speed widen the loop "
    "in proportion to the rate, another hysteron narrows or widens it around one rate.",
    references=("Al Janaideh, Rakheja & Su 2009, Mechatronics 19 (rate-dependent play)",),
    declares=(positive("kappa_v", "s/m", "growth of the dead zones with the speed", 1e8, strength=True),),
    adds=hasten,
    grid=grid,
    applies=applies,
    neighbours=("extra_hysteron", "quadratic_drag"),
)
