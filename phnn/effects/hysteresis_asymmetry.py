"""Hysteresis whose thresholds follow the displacement."""

from __future__ import annotations

from phnn.effects import Effect, Placed, Scales, bounded, constant, has_plain_dead_zones, kinds
from phnn.effects.additions import with_following_dead_zones
from phnn.setup import Setup


def follow(setup: Setup, parameters: Placed) -> Setup:
    """Every dead zone becomes ``d_i max(0, 1 + κ q/q₀)``."""
    return with_following_dead_zones(setup, "following_dead_zone", "q", tuple(parameters), parameters)


def grid(scales: Scales) -> list[dict[str, float]]:
    """One point: the law is linear in its strength."""
    return [{"kappa_d": 1e-3, "q_d": scales.displacement}]


EFFECT = Effect(
    name="hysteresis_asymmetry",
    kind=kinds.THRESHOLD_BY_DISPLACEMENT,
    equation=r"d_i(q) = d_i \max(0, 1 + \kappa_d\, q/q_d)",
    statement="The hysteresis loop is wider on one side: the dead zones grow by the share {kappa_d} per {q_d} of "
    "displacement.",
    fingerprint="The loop is wider on one side of the displacement than on the other: even harmonics that carry "
    "dissipation.",
    separation="Small slow loops about a high and a low offset: thresholds that follow the displacement change their "
    "width, electrostriction only their slope.",
    references=("Díaz, Ramírez, Le Gorrec & Wu, sec. 2.4.3 (asymmetric actuators)",),
    declares=(
        bounded("kappa_d", "1", "asymmetry of hysteresis", -3.0, 3.0, 0.05, strength=True),
        constant("q_d", "m", "reference displacement of the asymmetry"),
    ),
    adds=follow,
    grid=grid,
    applies=has_plain_dead_zones,
    neighbours=("electrostriction",),
)
