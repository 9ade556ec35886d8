"""Charge that leaks from the hysterons' capacitors."""

from __future__ import annotations

import math

from phnn.effects import Effect, Parts, Placed, Scales, has_dead_zones, kinds, positive
from phnn.network.elements import Resistor
from phnn.network.roles import charges
from phnn.setup import Setup


def leak(setup: Setup, parameters: Placed) -> Setup:
    """``Q̇_i = α v − h_i⁻¹(e_i) − G e_i``: a linear resistor beside every dead zone."""
    leaks = tuple(Resistor(f"leakage_{n}", "linear", {n: 1.0}, ("G",)) for n in charges(setup.network))
    return Parts(resistors=leaks)(setup, parameters)


def grid(scales: Scales) -> list[dict[str, float]]:
    """A weak leak over the whole recording, and faster relaxations, with which the charge no longer falls linearly."""
    c = scales.transducer * scales.displacement / scales.voltage
    slow, longest = 2.0 * math.pi * scales.slowest, scales.duration
    return [{"G": rate * c} for rate in (0.01 / longest, 0.3 / longest, 0.1 * slow, slow)]


EFFECT = Effect(
    name="charge_leakage",
    kind=kinds.LEAKAGE,
    equation=r"\dot{Q}_i = \alpha v - h_i^{-1}(e_i) - G e_i, \quad e_i = Q_i/C_i",
    statement="The capacitors of the hysterons leak with a conductance of {G} each, so that the charge which "
    "hysteresis holds is slowly lost.",
    fingerprint="On a hold the displacement drifts by at most what the dead zones hold, and slow loops are narrower "
    "than fast ones.",
    separation="Holds of equal length after loops of small and of large amplitude: leakage releases no more than the "
    "dead zones hold and then stops; creep goes on in proportion to the displacement.",
    references=("Goldfarb & Celanovic 1997, IEEE Control Systems 17 (electrical side of a stack)",),
    declares=(
        positive("G", "S", "leakage of the hysterons' capacitors", 1e8, strength=True).plausibly(
            0.0, 0.05, "ceramics of 10⁹ Ω m and 2·10⁻⁸ F/m discharge in 20 s, better ones more slowly", over="C_1"
        ),
    ),
    adds=leak,
    grid=grid,
    applies=has_dead_zones,
    neighbours=("creep", "extra_hysteron"),
)
